# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Examples in docstrings run: each below ``Example::``, with the names of a small tube.

An example imports what is not in its own module and not in the list of :func:`names_of_a_user`.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import re
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest
from collective import COMM
from wall_files import ROOT

import dolfinx
import ufl

import dolfinx_feti
import dolfinx_feti.wall
from dolfinx_feti.loading import Steps, follow_load
from dolfinx_feti.meshes.walls import create_tube_wall

pytestmark = pytest.mark.serial

PACKAGE = ROOT / "dolfinx_feti"

#: What each main class and function of the API has an example of.
SHOWN = {
    "dolfinx_feti.LinearProblem",
    "dolfinx_feti.NonlinearProblem",
    "dolfinx_feti.compare",
    "dolfinx_feti.FETI",
    "dolfinx_feti.LinearProblem.diagnose",
    "dolfinx_feti.wall.Pressure",
    "dolfinx_feti.wall.apply_conditions",
    "dolfinx_feti.wall.fibre_families",
    "dolfinx_feti.loading.follow_load",
    "dolfinx_feti.loading.Checkpoint",
    "dolfinx_feti.loading.Motion",
    "dolfinx_feti.output.FieldWriter",
    "dolfinx_feti.output.evaluate",
    "dolfinx_feti.output.recovered_field",
    "dolfinx_feti.contact.Contact",
    "dolfinx_feti.scalars.Cavity",
    "dolfinx_feti.scalars.Windkessel",
    "dolfinx_feti.scalars.ArcLength",
}

#: Examples that draw, and the package that they need.
REQUIRED = {"write_scene": "pyvista"}


def examples() -> Iterator[Any]:
    """Yield a parameter for each example: its module, the name that it belongs to, its lines."""
    for path in sorted(PACKAGE.rglob("*.py")):
        source = path.read_text(encoding="utf-8")
        if "Example::" not in source:
            continue
        module = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
                name = getattr(node, "name", path.stem)
                code = example_of(ast.get_docstring(node) or "")
                if code:
                    yield pytest.param(module, name, code, id=f"{module}.{name}")


def example_of(docstring: str) -> str:
    """Return the lines of the example of a docstring; empty if it has none."""
    _, _, below = docstring.partition("Example::\n")
    block = re.match(r"(?:\s*\n|    .*\n?)+", below)
    return textwrap.dedent(block[0]) if block else ""


@pytest.fixture
def names_of_a_user(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Return a tube of one layer under pressure, as a user has it: forms, conditions, problems."""
    monkeypatch.chdir(tmp_path)
    wall = create_tube_wall(COMM, length=1.0, size=0.6)
    mesh = wall.mesh
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    u = dolfinx.fem.Function(V, name="u")
    facets = np.concatenate([dolfinx_feti.wall.facets(wall, f"opening_{k}") for k in (1, 2)])
    clamped = dolfinx.fem.locate_dofs_topological(V, 2, facets)
    bc = dolfinx.fem.dirichletbc(np.zeros(3), clamped, V)
    pressure = dolfinx.fem.Constant(mesh, 0.0)
    F = dolfinx_feti.kinematics.deformation_gradient(u)
    C = dolfinx_feti.kinematics.right_cauchy_green(F)
    J = dolfinx_feti.kinematics.jacobian(F)
    psi = dolfinx_feti.materials.neo_hookean(C, J=J, c=20.0) + 50.0 * (J - 1.0) ** 2
    ds = dolfinx_feti.wall.surface_measure(wall)
    lumen = wall.surfaces["lumen"]
    N = ufl.FacetNormal(mesh)
    trial = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)

    def set_load(value: float) -> None:
        pressure.value = value

    return {
        "np": np,
        "ufl": ufl,
        "dolfinx": dolfinx,
        "MPI": MPI,
        "PETSc": PETSc,
        "dolfinx_feti": dolfinx_feti,
        "LinearProblem": dolfinx_feti.LinearProblem,
        "NonlinearProblem": dolfinx_feti.NonlinearProblem,
        "kinematics": dolfinx_feti.kinematics,
        "materials": dolfinx_feti.materials,
        "follow_load": follow_load,
        "Steps": Steps,
        "wall": wall,
        "mesh": mesh,
        "V": V,
        "u": u,
        "v": v,
        "bcs": [bc],
        "ds": ds,
        "lumen": lumen,
        "a": ufl.inner(ufl.grad(trial), ufl.grad(v)) * ufl.dx,
        "L": v[0] * ufl.dx,
        "psi": psi,
        "F": F,
        "J": J,
        "N": N,
        "energy": psi * ufl.dx + pressure * ufl.inner(N, u) * ds(lumen),
        "pressure": pressure,
        "set_load": set_load,
    }


@pytest.mark.parametrize(("module", "name", "code"), examples())
def test_example_runs(module, name, code, names_of_a_user):
    if name in REQUIRED:
        pytest.importorskip(REQUIRED[name])
    names = vars(importlib.import_module(module)) | names_of_a_user
    exec(compile(code, f"the example of {module}.{name}", "exec"), names)


@pytest.mark.parametrize("path", sorted(SHOWN))
def test_main_names_have_an_example(path):
    """In the docstring of the class, method or function."""
    module, _, name = path.rpartition(".")
    owner: Any
    if module.rpartition(".")[2][:1].isupper():
        module, _, class_name = module.rpartition(".")
        owner = getattr(importlib.import_module(module), class_name)
    else:
        owner = importlib.import_module(module)
    assert example_of(inspect.getdoc(getattr(owner, name)) or "")
