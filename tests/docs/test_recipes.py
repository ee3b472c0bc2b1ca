# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The programs of docs/mechanics_recipes.md in their order, beside what is known by hand."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.optimize
from collective import COMM, agree, small

import dolfinx

from dolfinx_feti import ConvergenceError

PAGE = Path(__file__).parents[2] / "docs/mechanics_recipes.md"


def program(heading: str) -> str:
    """Return the block of Python below a heading."""
    section = PAGE.read_text(encoding="utf-8").partition(f"\n## {heading}\n")[2]
    (code,) = re.findall(r"^```python\n(.*?)^```", section.partition("\n## ")[0], re.M | re.S)
    return code


@pytest.fixture(scope="module")
def names() -> dict[str, Any]:
    """What the first program leaves."""
    found: dict[str, Any] = {}
    exec(program("Active tension"), found)
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
    agree("shortens to 0.79 of its length" in PAGE.read_text(encoding="utf-8"))
    small(length(names["u"]) - 0.79, 0.005)


def test_internal_variables(names):
    """Up and down through the same load; the third solve fails, and has remembered nothing."""
    scope = dict(names)
    code = program("Internal variables").replace("unloading=True", "unloading=True, on_step=keep")
    lengths, tried = {}, []

    def keep(step):
        lengths.setdefault(step.load, []).append(length(names["u"]))

    exec(code.replace("u.x.array[:], p", "fail_once(problem)\nu.x.array[:], p"), scope | {
        "keep": keep, "fail_once": lambda problem: failing_once(problem, tried),
    })  # fmt: skip
    up, down = lengths[1.0]
    agree(down > up * 1.01, lengths)
    agree(len(tried) > 4 and np.array_equal(tried[2], tried[3]))


def failing_once(problem: Any, tried: list[np.ndarray]) -> None:
    """Let the third solve of a problem fail, and note what is remembered before each."""
    solve = problem.solve

    def fail_once(**arguments):
        tried.append(problem.internal_variables[0].x.array.copy())
        if len(tried) == 3:
            raise ConvergenceError("told to fail")
        return solve(**arguments)

    problem.solve = fail_once


@pytest.mark.serial
def test_inertia(names):
    """The energy of the impact, ½ ρ ∫ |v|² = ½ ρ (100 mm/s)² (1 + ¼ + ¼)/3 mm³, stays."""
    exec(program("Internal variables"), names)
    exec(program("Inertia"), names)
    elastic = dolfinx.fem.assemble_scalar(dolfinx.fem.form(names["elastic"]))
    kinetic, given = names["swing"][-1].kinetic, 0.5e-6 * 100.0**2 * 0.5
    agree(len(names["swing"]) == 40 and min(elastic, kinetic) > 0.0, (elastic, kinetic))
    small(elastic + kinetic - given, 1e-4 * given)
