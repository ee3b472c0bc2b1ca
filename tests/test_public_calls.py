# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Every public function or class of loading, output, diagnosis and comparison is called by a test.

Functions that other tests only use indirectly are called here.
"""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import re
from pathlib import Path

import numpy as np
import pytest
import rooms
from collective import COMM, agree, small
from problems import cube, elasticity

from dolfinx_feti import LinearProblem, comparison
from dolfinx_feti.diagnosis import run
from dolfinx_feti.diagnosis.figures import collect_figures

TESTS = Path(__file__).parent


def public_names(room: str) -> dict[str, object]:
    """Return the public names of a room: those of its ``__all__``, or of those of its files."""
    folder = importlib.import_module(f"dolfinx_feti.{room}")
    if not hasattr(folder, "__all__"):
        names = [module.name for module in rooms.modules() if module.name.startswith(f"{room}.")]
        modules = [importlib.import_module(f"dolfinx_feti.{name}") for name in names]
        return {name: getattr(m, name) for m in modules for name in m.__all__}
    return {name: getattr(folder, name) for name in folder.__all__}


@pytest.mark.serial
@pytest.mark.parametrize("room", ["loading", "output", "diagnosis", "comparison"])
def test_every_public_name_is_called_by_a_test(room):
    """A call counts, wherever it is in a test."""
    tests = "".join(path.read_text(encoding="utf-8") for path in TESTS.rglob("test_*.py"))
    members = {
        name: member
        for name, member in public_names(room).items()
        if not dataclasses.is_dataclass(member)
    }
    names = [
        name
        for name, member in members.items()
        if inspect.isfunction(member) or inspect.isclass(member)
    ]
    assert names
    assert not [name for name in names if not re.search(rf"\b{name}\b\(", tests)]


def test_measurements_of_a_solver_agree_on_all_processes():
    """Its solution agrees with that of MUMPS."""
    body = elasticity(cube(3, 3))
    problem = LinearProblem(body.a, body.L, bcs=body.bcs, subdomains=6)
    A, b = problem.linear_system()
    x = b.duplicate()
    cost, ksp = comparison.timed_solve(problem.create_linear_solver, b, x)
    small(np.linalg.norm(run.residual_shares(A, b, x)) / b.norm(), 1e-7)
    context = ksp.getPythonContext()
    figures = collect_figures(context.formulation)
    agree(len(set(COMM.allgather(repr(figures)))) == 1, figures)
    agree(cost.iterations == ksp.getIterationNumber() and cost.seconds_solve > 0.0, cost)
    K, f = comparison.assembled_system(A, b)
    y = comparison.measure(lambda: comparison.create_solver(K), f)[1]
    small(comparison.relative_difference(x, y), 1e-5)  # rtol times a condition number
    for owned in (ksp, x, y, K, f):
        owned.destroy()
