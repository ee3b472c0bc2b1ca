# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The arrows between the modules, read off their imports."""

from __future__ import annotations

import ast
import graphlib
from pathlib import Path

import pytest

import dolfinx_feti

FOLDER = Path(dolfinx_feti.__file__).parent
MODULES = sorted(path.stem for path in FOLDER.glob("*.py"))

DUAL = {
    "coarse",
    "dense",
    "dual",
    "events",
    "factors",
    "feti",
    "gathered",
    "gluing",
    "interior",
    "kernel",
    "krylov",
    "options",
    "parts",
    "preconditioner",
    "pseudoinverse",
    "recovery",
    "recycling",
    "report",
    "schur",
    "stability",
    "torn",
}
MECHANICS = {"kinematics", "loads", "materials"}
FINITE_ELEMENTS = {"basix", "dolfinx", "ffcx", "ufl"}


def tree(module: str) -> ast.Module:
    return ast.parse((FOLDER / f"{module}.py").read_text(encoding="utf-8"))


def imports(module: str) -> set[str]:
    """Full names that a module imports anywhere, ``dolfinx_feti.torn`` for one of our own."""
    names = set()
    for node in ast.walk(tree(module)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module} has a relative import"
            assert node.module is not None
            names.add(node.module)
            if node.module == "dolfinx_feti":
                names |= {f"dolfinx_feti.{alias.name}" for alias in node.names}
    return names


def own(module: str) -> set[str]:
    """Modules of the package that a module imports."""
    names = {name.removeprefix("dolfinx_feti.") for name in imports(module)}
    return names & set(MODULES)


def foreign(module: str) -> set[str]:
    """Packages that a module imports."""
    return {name.split(".")[0] for name in imports(module)} - {"dolfinx_feti"}


def everything_below(modules: set[str]) -> set[str]:
    """Modules that these import, directly or not, and themselves."""
    known: set[str] = set()
    while modules - known:
        known |= modules
        modules = set().union(*map(own, known))
    return known


def test_modules_are_there():
    assert DUAL | MECHANICS <= set(MODULES)


def test_dual_strand_knows_no_finite_elements():
    """Nor does anything that it imports."""
    for module in everything_below(DUAL):
        assert not foreign(module) & FINITE_ELEMENTS, module
        assert foreign(module) <= {
            "mpi4py", "petsc4py", "numpy", "scipy", "__future__", "abc", "collections", "ctypes",
            "contextlib", "dataclasses", "difflib", "functools", "itertools", "logging", "typing",
        }, module  # fmt: skip


def test_mechanics_knows_no_feti():
    """It is UFL, and would serve without any solver."""
    for module in everything_below(MECHANICS):
        assert module in MECHANICS, module
        assert not foreign(module) & {"dolfinx", "petsc4py", "mpi4py"}, module


def test_imports_have_no_cycle():
    graph = {module: own(module) - {"__init__"} for module in MODULES}
    assert len(list(graphlib.TopologicalSorter(graph).static_order())) == len(MODULES)


def test_every_import_exists():
    for module in MODULES:
        wanted = {name for name in imports(module) if name.startswith("dolfinx_feti.")}
        heads = {name.split(".")[1] for name in wanted}
        assert heads <= set(MODULES) | set(dolfinx_feti.__all__), module


@pytest.mark.parametrize("module", MODULES)
def test_module_does_not_print(module):
    calls = [node.func for node in ast.walk(tree(module)) if isinstance(node, ast.Call)]
    assert not [f for f in calls if isinstance(f, ast.Name) and f.id in ("print", "input")]


@pytest.mark.parametrize("module", MODULES)
def test_module_has_licence_and_docstring(module):
    lines = (FOLDER / f"{module}.py").read_text(encoding="utf-8").splitlines()
    assert lines[0].startswith("# Copyright (C)") and "LGPL-3.0-or-later" in lines[2]
    assert ast.get_docstring(tree(module))


@pytest.mark.parametrize("module", sorted(set(MODULES) - {"__init__"}))
def test_public_names_are_declared_and_exist(module):
    declared = [
        ast.literal_eval(node.value)
        for node in tree(module).body
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "__all__"
    ]
    assert len(declared) == 1, "no __all__"
    namespace = __import__(f"dolfinx_feti.{module}", fromlist=["*"])
    assert all(hasattr(namespace, name) for name in declared[0])


def test_versions_are_told_apart_in_one_place():
    for module in set(MODULES) - {"_compat", "__init__"}:
        names = [node.attr for node in ast.walk(tree(module)) if isinstance(node, ast.Attribute)]
        assert "__version__" not in names and "version_info" not in names, module


def test_no_communicator_but_that_of_mesh_or_matrix():
    for module in set(MODULES) - {"_compat"}:
        names = [node.attr for node in ast.walk(tree(module)) if isinstance(node, ast.Attribute)]
        assert "COMM_WORLD" not in names, module
