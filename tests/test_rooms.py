# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The rooms of the package, its folders, import each other in one order only."""

from __future__ import annotations

import ast
import importlib
import sys
from pathlib import Path

import pytest
import rooms
from wall_files import ROOT

pytestmark = pytest.mark.serial

MODULES = {module.name: module for module in rooms.modules()}


def python_files(*folders: str) -> list[Path]:
    """Return the Python files below some folders of the repository, sorted."""
    return [path for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))]


def syntax_tree(path: Path) -> ast.Module:
    """Return the syntax tree of a Python file."""
    return ast.parse(path.read_text(encoding="utf-8"))


def imports(path: Path) -> set[str]:
    """Return the full names that a file imports, at any place in it."""
    names = set()
    for node in ast.walk(syntax_tree(path)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} has a relative import"
            assert node.module is not None
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def imported_modules(path: Path) -> set[str]:
    """Return the modules of the package that a file imports."""
    imported = set()
    for name in imports(path):
        if name.startswith("dolfinx_feti."):
            inside = name.removeprefix("dolfinx_feti.")
            known = {n for n in MODULES if inside == n or inside.startswith(f"{n}.")}
            assert known, (
                f"{path} imports {name}: no module of this name is in the order of the data in the "
                "__init__.py of its folder; or the import is past the module that defines it"
            )
            imported |= known
    return imported


def imported_packages(path: Path) -> set[str]:
    """Return the names of the other packages that a file imports."""
    return {name.split(".")[0] for name in imports(path)} - {"dolfinx_feti"}


def with_indirect_imports(names: set[str]) -> set[str]:
    """Return some modules of the package, and all that they import directly or indirectly."""
    known: set[str] = set()
    while names - known:
        known |= names
        names = set().union(*(imported_modules(MODULES[name].path) for name in known))
    return known


def test_every_module_is_in_the_import_order():
    """The docstring of a room's __init__.py lists its modules in that order."""
    existing = {path for path in python_files("dolfinx_feti") if path.name != "__init__.py"}
    in_order = {module.path for module in MODULES.values()}
    assert not existing - in_order, (
        f"the __init__.py of its folder has to name {existing - in_order}"
    )
    assert not in_order - existing, (
        f"an __init__.py names {in_order - existing}, which does not exist"
    )


def test_modules_import_only_earlier_ones():
    """So there is no circular import."""
    place = {name: i for i, name in enumerate(MODULES)}
    for name, module in MODULES.items():
        later = {other for other in imported_modules(module.path) if place[other] >= place[name]}
        assert not later, f"{name} imports {later}"


#: What a room imports, directly or indirectly: other rooms, and packages other than Python's own.
#: The solver imports no finite elements; its input is the torn matrix. Mechanics imports no solver.
ALLOWED_IMPORTS = {
    "feti": ("errors runtime torn", "cffi mpi4py numpy petsc4py scipy"),
    "fem": ("errors runtime torn", "basix cffi dolfinx ffcx mpi4py numpy petsc4py scipy ufl"),
    "mechanics": ("runtime", "basix dolfinx mpi4py numpy scipy ufl"),
    "workshop": (
        "errors mechanics runtime text_tables",
        "basix dolfinx matplotlib mpi4py numpy scipy ufl",
    ),
}


@pytest.mark.parametrize("room", ALLOWED_IMPORTS)
def test_rooms_import_only_allowed_rooms_and_packages(room):
    """The solver is independent of finite elements, and mechanics of the solver."""
    inside = {name for name in MODULES if name.startswith(f"{room}.")}
    below = with_indirect_imports(inside)
    used = {name: imported_packages(MODULES[name].path) for name in below}
    others, packages = (words.split() for words in ALLOWED_IMPORTS[room])
    assert inside and {name.split(".")[0] for name in below} <= {room, *others}
    assert set().union(*used.values()) <= {*packages, *sys.stdlib_module_names}
    if room == "mechanics":  # dolfinx assembles trial displacements; dashpots have a Constant
        with_dolfinx = sorted(name for name in inside if "dolfinx" in used[name])
        expected = ["mechanics.loads", "mechanics.supports", "mechanics.trial_displacements"]
        assert with_dolfinx == expected


def test_generated_pages_are_up_to_date(monkeypatch, capsys):
    """``--check`` also finds a page that is out of date."""
    assert rooms.main(["--check"]) == 0, "run python3 scripts/rooms.py"
    monkeypatch.setattr(rooms, "equations_page", lambda: "another table")
    assert rooms.main(["--check"]) == 1
    assert "equations.md is out of date" in capsys.readouterr().out


def test_overview_has_every_module_once():
    """The summary is the first line of its docstring."""
    overview = rooms.overview()
    for module in MODULES.values():
        assert overview.count(f"`{module.path.name}` | {module.summary} |") == 1


def files_in_order(folder: Path) -> list[Path]:
    """Return the files below a folder, in the order that the docstrings of folders give."""
    named = [folder / name for name in rooms.order(folder)]
    files = [
        p for n in named for p in (files_in_order(n) if n.is_dir() else [n.with_suffix(".py")])
    ]
    assert all(path.is_file() for path in files), files
    return files


def imported_files(path: Path, folder: str) -> set[Path]:
    """Return the files of a folder next to the package that a file imports."""
    dotted = (name.split(".") for name in imports(path) if name.startswith(f"{folder}."))
    places = (ROOT.joinpath(*names[:n]) for names in dotted for n in range(2, len(names) + 1))
    return {p.with_suffix(".py") for p in places if p.with_suffix(".py").is_file()}


@pytest.mark.parametrize("folder", ["meshes", "benchmarks"])
def test_modules_beside_the_package_import_only_earlier_ones(folder):
    """``__main__`` is not in the order: it may import all others."""
    order = files_in_order(ROOT / folder)
    commands = sorted((ROOT / folder).rglob("__main__.py"))
    named = {path for path in python_files(folder) if path.name != "__init__.py"}
    assert set(order) == named - set(commands)
    for place, path in enumerate(order):
        assert imported_files(path, folder) <= set(order[:place]), path


def test_studies_have_a_page_and_are_imported_by_no_module():
    """A study that writes records has a template in its folder."""
    folder = ROOT / "benchmarks"
    studies = set(folder.glob("[a-z]*.py"))
    assert {path.with_suffix(".py") for path in folder.glob("*.md")} <= studies
    for path in python_files("benchmarks"):
        assert not imported_files(path, "benchmarks") & studies, path


@pytest.mark.parametrize(
    ("folder", "users"),
    [
        ("dolfinx_feti", {"benchmarks", "demos", "meshes", "tests"}),
        ("meshes", {"benchmarks", "demos", "tests"}),
        ("demos", {"benchmarks", "tests"}),
        ("benchmarks", set()),
    ],
)
def test_folders_do_not_import_their_users(folder, users):
    """``sys.path`` is not changed either: ``scripts/with-fenicsx`` or an installation does it."""
    for path in python_files(folder):
        assert not imported_packages(path) & users, path
        assert "sys.path" not in path.read_text(), path


def test_every_file_has_licence_and_docstring():
    """The docstring says what the module is for, and rooms.py collects its first line."""
    for path in python_files("dolfinx_feti"):
        lines = path.read_text(encoding="utf-8").splitlines()
        assert lines[0].startswith("# Copyright (C)") and "LGPL-3.0-or-later" in lines[2], path
        assert rooms.docstring(path), path


#: Rooms that users do not import from. There a name without underscore is used by other files.
INTERNAL_ROOMS = ("feti.", "fem.", "problems.", "runtime.", "torn.")


@pytest.mark.parametrize("name", [name for name in MODULES if not name.startswith(INTERNAL_ROOMS)])
def test_public_names_are_declared_and_exist(name):
    """``__all__`` of a module that users import is complete and correct."""
    namespace = importlib.import_module(f"dolfinx_feti.{name}")
    assert "__all__" in vars(namespace), "no __all__"
    assert all(hasattr(namespace, public) for public in namespace.__all__)


def test_versions_and_comm_world_are_used_in_one_place():
    """Other modules use the communicator of their mesh or matrix."""
    for name in set(MODULES) - {"runtime.compat", "meshes.arguments"}:
        nodes = ast.walk(syntax_tree(MODULES[name].path))
        used = {node.attr for node in nodes if isinstance(node, ast.Attribute)}
        assert not used & {"__version__", "version_info", "COMM_WORLD"}, name
