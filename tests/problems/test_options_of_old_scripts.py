# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Options that a script has set for another solver: without effect, and logged once."""

from __future__ import annotations

import logging

from petsc4py import PETSc

import pytest
from bodies import block, yeoh
from collective import COMM, agree, equal, raises
from problems import cube, elasticity, owned, torn

from dolfinx_feti import ConvergenceError, LinearProblem
from dolfinx_feti.runtime.petsc_options import inserted

DIRECT = {"ksp_type": "preonly", "pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}
SNES = {"snes_type": "newtonls", "snes_linesearch_type": "none"}

#: Sums over processes come in any order: eps times the condition number, some 1e4.
ROUNDING = 1e-11


def linear(options: dict[str, object]) -> LinearProblem:
    return torn(elasticity(cube(2, 4)), prefix="old_", **options)


def logged(caplog: pytest.LogCaptureFixture) -> str:
    """Return the warnings, and forget them."""
    texts = [record.message for record in caplog.records if record.levelno == logging.WARNING]
    caplog.clear()
    agree(len(texts) <= 1, texts)
    return "".join(COMM.bcast(texts))


@pytest.mark.parametrize("by", ["argument", "command line"])
def test_linear_problem(by, caplog):
    expected = linear({})
    expected.solve()
    agree(not logged(caplog))
    before = PETSc.Options().getAll()
    with inserted("old_", DIRECT if by == "command line" else {}):
        problem = linear(DIRECT if by == "argument" else {})
        text = logged(caplog)
        problem.solve()
        agree(not logged(caplog), "once is enough")
    equal(owned(problem.u), owned(expected.u), ROUNDING)
    agree(problem.solver.getType() == "python" and problem.solver.getPC().getType() == "none")
    agree(PETSc.Options().getAll() == before)
    for part in ("-old_ksp_type preonly", "-old_pc_type lu", "type mumps", "-old_feti_…"):
        agree(part in text, text)


def test_nonlinear_problem(caplog):
    body, other = block(yeoh, (0.3, 0.1)), block(yeoh, (0.3, 0.1))
    body.problem().solve()
    problem = other.problem(DIRECT | SNES)
    text = logged(caplog)
    agree(all(name in text for name in DIRECT | SNES), text)
    problem.solve()
    equal(owned(other.u), owned(body.u), ROUNDING)
    agree(problem.solver.getType() == problem.solver.getKSP().getType() == "python")


@pytest.mark.parametrize("name", ["ksp_error_if_not_converged", "snes_error_if_not_converged"])
def test_error_if_not_converged(name):
    """The package's own error says it better than a number of PETSc's."""
    with raises(ConvergenceError, "ksp_max_it"):
        block(yeoh, (0.3, 0.1)).problem({name: True, "ksp_max_it": 2}).solve()
    with raises(ConvergenceError, "FETI did not converge: .*old_ksp_max_it"):
        linear({"ksp_error_if_not_converged": True, "ksp_max_it": 1}).solve()


def test_options_without_a_log(caplog):
    """Of FETI itself, whose context stays the one of the problem, and without the prefix."""
    with inserted("", {"pc_type": "lu"}):
        problem = linear({"ksp_type": "python", "ksp_python_type": "dolfinx_feti.FETI"})
        problem.solve()
    agree(problem.solver.getPythonContext().iterations == problem.history[0].linear_iterations)
    agree(not logged(caplog))
