# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Programs of README.md, CONTRIBUTING.md and docs/, beside what is known."""

from __future__ import annotations

import importlib.util
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.optimize
from collective import COMM, agree, equal, small
from pages import programs
from problems import Problem, owned
from wall_files import ROOT

import basix.ufl
import dolfinx
import ufl

from dolfinx_feti import ConvergenceError
from dolfinx_feti.fem.elements import quadratic_with_bubbles

README = (ROOT / "README.md").read_text(encoding="utf-8")
RECIPES = "docs/mechanics_recipes.md"


def test_first_program_of_the_readme(tmp_path, monkeypatch, capfd):
    """It agrees with a direct solution, prints what README shows, and writes its picture."""
    monkeypatch.chdir(tmp_path)
    (source,) = programs(page="README.md")
    agree(len(source.strip().splitlines()) <= 35 and len(README.split()) <= 900)
    agree(README.index("docs/images/speed.png") < README.index("## Install"))
    has_pyvista = importlib.util.find_spec("pyvista") is not None
    if not has_pyvista:
        source = source.partition("pictures.draw(")[0]
    names: dict[str, Any] = {}
    exec(source.replace("size=0.13", "size=0.26"), names)  # a coarser mesh
    problem = names["problem"]
    uh = names["uh"]
    printed = COMM.bcast(capfd.readouterr().out)
    agree(re.fullmatch(r"\d\d iterations\nresidual \de-09 of the load\n", printed), printed)
    agree(problem.solver.getConvergedReason() > 0)
    agree(Path("tube.png").exists() == has_pyvista)
    form = names["shear"] + names["volume"]
    known = Problem(names["V"], form * ufl.dx, names["load"], [names["bc"]])
    equal(owned(uh), known.solve_directly(), 1e-6)


def test_the_example_of_contributing_passes():
    names: dict[str, Any] = {}
    exec(*programs(page="CONTRIBUTING.md"), names)
    (test,) = [value for name, value in names.items() if name.startswith("test_")]
    test()


def depth(x: np.ndarray) -> float:
    """Return how far the beam sinks."""
    return COMM.allreduce(float(-x[2::3].min(initial=0.0)), op=max)


def test_point_load():
    """A corner load sinks the beam further."""
    names: dict[str, Any] = {}
    (first,) = programs("A linear problem")
    exec(first.replace("10, 10, 10", "4, 4, 4"), names)
    sunk = depth(names["uh"].x.array)
    (load,) = programs("Point loads, springs, null spaces")
    exec(load, names)
    agree(depth(names["problem"].x.array_r) > 1.2 * sunk > 0.0, sunk)
    load = names["b"].array_r.reshape(-1, 3)[:, 2]
    agree(COMM.allreduce(float(load.min(initial=0.0)), op=min) < -0.5, "added once")
    small(COMM.allreduce(float(load.sum())) + 1.5, 0.3)


def test_reactions_and_points():
    """The foot carries the weight of one; a column has −ρ g (1 − z) on average."""
    names: dict[str, Any] = {}
    for block in programs(page="docs/reactions_and_points.md"):
        exec(block, names)
    equal(names["support"].force, [0.0, 0.0, 1.0], 1e-6)
    small(float(np.abs(names["support"].moment).max()), 1e-6)
    stress = names["evaluate"](names["stress_h"], [[0.5, 0.5, 0.1], [0.5, 0.5, 0.9]])
    agree(stress[0, 2, 2] < stress[1, 2, 2] < 0.0, f"σ_zz below and above: {stress[:, 2, 2]}")


def test_condensed_linear_problem():
    """The pressure is the projection of κ div u."""
    (code,) = programs("Linear elasticity", "docs/elements.md")
    mesh = dolfinx.mesh.create_unit_cube(COMM, 2, 2, 2)
    element = basix.ufl.blocked_element(quadratic_with_bubbles("tetrahedron"), shape=(3,))
    names = {
        "tetrahedra": mesh,
        "V": dolfinx.fem.functionspace(mesh, element),
        "Q": dolfinx.fem.functionspace(mesh, ("DG", 1)),
        **{"dolfinx": dolfinx, "ufl": ufl, "np": np},
    }
    exec(code, names)
    p = names["p"]
    uh = names["uh"]
    given, found = (
        COMM.allreduce(dolfinx.fem.assemble_scalar(dolfinx.fem.form(f * p * ufl.dx)))
        for f in (1e4 * ufl.div(uh), p)
    )
    agree(found > 1e-3)
    small(given / found - 1.0, 1e-5)


@pytest.fixture(scope="module")
def names() -> dict[str, Any]:
    """Variables of the first program after it has run."""
    found: dict[str, Any] = {}
    exec(*programs("Active tension", RECIPES), found)
    return found


def length(u: dolfinx.fem.Function) -> float:
    """Length along x of the block of 1 mm."""
    x = u.function_space.tabulate_dof_coordinates()[:, 0]
    return 1.0 + COMM.allreduce(u.x.array[0::3][x > 1.0 - 1e-9].max(initial=-1.0), op=max)


def test_active_tension(names):
    """The deformation is uniform: F = diag(λ, μ, μ) has the least energy of all λ, μ."""

    def energy(logarithms):
        stretches = along, across = np.exp(logarithms)
        J = along * across**2
        f, s = ((J ** (-1 / 3) * stretch) ** 2 / 2 - 0.5 for stretch in stretches)
        passive = math.expm1(8.0 * f**2 + 2.0 * 2 * s**2) + 500.0 * (J - 1) ** 2
        return passive + 6.0 / 2 * (along**2 - 1)

    found = scipy.optimize.minimize(energy, [0.0, 0.0], method="Nelder-Mead", tol=1e-10)
    small(length(names["u"]) - math.exp(found.x[0]), 1e-5)
    agree("shortens to 0.79 of its length" in (ROOT / RECIPES).read_text("utf-8"))
    small(length(names["u"]) - 0.79, 0.005)


def test_internal_variables(names):
    """The load rises and falls; a solve that fails does not change the internal variables."""
    scope = dict(names)
    (code,) = programs("Internal variables", RECIPES)
    code = code.replace("unloading=True", "unloading=True, on_step=keep")
    lengths = {}
    tried = []

    def keep(step):
        lengths.setdefault(step.load, []).append(length(names["u"]))

    exec(
        code.replace("u.x.array[:], p", "fail_once(problem)\nu.x.array[:], p"),
        scope | {"keep": keep, "fail_once": lambda problem: failing_once(problem, tried)},
    )
    up, down = lengths[1.0]
    agree(down > up * 1.01, lengths)
    agree(len(tried) > 4)
    equal(tried[2], tried[3])


def failing_once(problem: Any, tried: list[np.ndarray]) -> None:
    """Make the third solve of a problem fail; record what is cached before each."""
    solve = problem.solve

    def fail_once(**arguments):
        tried.append(problem.internal_variables[0].x.array.copy())
        if len(tried) == 3:
            raise ConvergenceError("fails on purpose")
        return solve(**arguments)

    problem.solve = fail_once


@pytest.mark.serial
def test_inertia(names):
    """The energy of the impact, ½ ρ ∫ |v|² = ½ ρ (100 mm/s)² (1 + ¼ + ¼)/3 mm³, stays."""
    for heading in ("Internal variables", "Inertia"):
        exec(*programs(heading, RECIPES), names)
    elastic = dolfinx.fem.assemble_scalar(dolfinx.fem.form(names["elastic"]))
    kinetic = names["swing"][-1].kinetic
    given = 0.5e-6 * 100.0**2 * 0.5
    agree(len(names["swing"]) == 40 and min(elastic, kinetic) > 0.0, (elastic, kinetic))
    small(elastic + kinetic - given, 1e-4 * given)
