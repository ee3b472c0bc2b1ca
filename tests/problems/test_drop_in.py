# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The scripts in ``drop_in/`` run with the two documented changes, their options included."""

from __future__ import annotations

import logging
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from petsc4py import PETSc

import numpy as np
import pytest
from bodies import block, yeoh
from collective import COMM, agree, equal, norm, raises, small
from mixed import by_place
from problems import Problem, cube, elasticity, owned, torn

import dolfinx
import dolfinx.fem.petsc
import ufl

import dolfinx_feti
from dolfinx_feti import ConvergenceError
from dolfinx_feti.runtime.petsc_options import inserted

SCRIPTS = Path(__file__).parent / "drop_in"

#: From 0.10, dolfinx's NonlinearProblem has a solver, and its LinearProblem takes a prefix.
RECENT = hasattr(dolfinx.fem.petsc, "NewtonSolverNonlinearProblem")


def run(text: str) -> SimpleNamespace:
    """Run a script and return its names; remove the options that dolfinx leaves behind."""
    names: dict[str, Any] = {"__name__": "script"}
    before = PETSc.Options().getAll()
    exec(compile(text, "script", "exec"), names)
    for key in PETSc.Options().getAll().keys() - before.keys():
        PETSc.Options().delValue(key)
    return SimpleNamespace(**names)


def original(name: str) -> str:
    """Return a script for the installed dolfinx; 0.9 takes no prefix."""
    text = (SCRIPTS / f"{name}.py").read_text(encoding="utf-8")
    return text if RECENT else re.sub(r" *petsc_options_prefix=.*\n", "", text)


def changed(name: str) -> str:
    """Return a script with the two documented changes, one line each."""
    text = (SCRIPTS / f"{name}.py").read_text(encoding="utf-8")
    text, imports = re.subn("from dolfinx.fem.petsc import", "from dolfinx_feti import", text)
    text, calls = re.subn(r"( *)(petsc_options_prefix=)", r"\1subdomains=8, \2", text)
    agree(imports == calls == 1)
    return text


def difference(u: dolfinx.fem.Function, v: dolfinx.fem.Function) -> float:
    """Return ‖u − v‖/‖v‖ of functions on equal meshes that are distributed differently."""
    here = by_place(u)
    there = by_place(v)
    return float(np.linalg.norm(here - there) / np.linalg.norm(there))


def test_linear_script(caplog):
    """The elasticity script has dolfinx's solution after its import and call are changed."""
    expected = run(original("elasticity")).uh
    found = run(changed("elasticity"))
    small(difference(found.uh, expected), 1e-6)
    agree(isinstance(found.problem, dolfinx_feti.LinearProblem))
    texts = [record.message for record in caplog.records]
    agree(
        len(texts) == (1 if COMM.rank == 0 else 0) and all("Without effect: -" in t for t in texts),
        texts,
    )


def test_nonlinear_script():
    """The cantilever script has dolfinx's solution after its import and call are changed."""
    found = run(changed("tutorial"))
    u = found.u
    F = found.residual
    bcs = found.bcs
    held = u.x.array.copy()
    for bc in bcs:
        bc.set(held)
    equal(u.x.array, held, 1e-10)
    newton = Problem(u.function_space, ufl.derivative(F, u), -F, bcs).solve_directly()
    small(norm(newton) / norm(owned(u)), 1e-7)
    agree(isinstance(found.problem, dolfinx_feti.NonlinearProblem))
    if RECENT:
        small(difference(found.uh, run(original("tutorial")).uh), 1e-6)


DIRECT = {"ksp_type": "preonly", "pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}
SNES = {"snes_type": "newtonls", "snes_linesearch_type": "none"}

#: Sums over processes come in any order: eps times the condition number, some 1e4.
ROUNDING = 1e-11


def linear(options):
    """Create Poisson's problem with PETSc options."""
    return torn(elasticity(cube(2, 4)), prefix="old_", **options)


def logged(caplog):
    """Return the logged warnings, and clear the log."""
    texts = [record.message for record in caplog.records if record.levelno == logging.WARNING]
    caplog.clear()
    agree(len(texts) <= 1, texts)
    return "".join(COMM.bcast(texts))


@pytest.mark.parametrize("by", ["argument", "command line"])
def test_options_of_a_linear_problem(by, caplog):
    """Options of a direct solver have no effect but one warning that lists them."""
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


def test_options_of_a_nonlinear_problem(caplog):
    """Options of SNES and of a direct solver have no effect but a warning that lists them."""
    body = block(yeoh, (0.3, 0.1))
    other = block(yeoh, (0.3, 0.1))
    body.problem().solve()
    problem = other.problem(DIRECT | SNES)
    text = logged(caplog)
    agree(all(name in text for name in DIRECT | SNES), text)
    problem.solve()
    equal(owned(other.u), owned(body.u), ROUNDING)
    agree(problem.solver.getType() == problem.solver.getKSP().getType() == "python")


@pytest.mark.parametrize("name", ["ksp_error_if_not_converged", "snes_error_if_not_converged"])
def test_error_if_not_converged(name):
    """With ``error_if_not_converged`` a failed solve raises the package's error, not PETSc's."""
    with raises(ConvergenceError, "ksp_max_it"):
        block(yeoh, (0.3, 0.1)).problem({name: True, "ksp_max_it": 1}).solve()
    with raises(ConvergenceError, "FETI did not converge: .*old_ksp_max_it"):
        linear({"ksp_error_if_not_converged": True, "ksp_max_it": 1}).solve()


def test_error_if_not_converged_by_a_call():
    """``setErrorIfNotConverged`` acts as the option does, also if repeated before each solve."""
    nonlinear = block(yeoh, (0.3, 0.1)).problem({"snes_max_it": 1})
    for solver in (nonlinear.solver, nonlinear.solver.getKSP()):
        solver.setErrorIfNotConverged(True)
    with raises(ConvergenceError, "snes_max_it"):
        nonlinear.solve()
    agree(nonlinear.solver.getErrorIfNotConverged())
    agree(nonlinear.solver.getKSP().getErrorIfNotConverged())
    problem = linear({"ksp_max_it": 1})
    problem.solver.setErrorIfNotConverged(True)
    with raises(ConvergenceError, "FETI did not converge: .*old_ksp_max_it"):
        problem.solve()
    agree(problem.solver.getErrorIfNotConverged())


def test_options_without_a_log(caplog):
    """A FETI that is created by options records its iterations, and logs no warning."""
    with inserted("", {"pc_type": "lu"}):
        problem = linear({"ksp_type": "python", "ksp_python_type": "dolfinx_feti.FETI"})
        problem.solve()
    agree(problem.solver.getPythonContext().iterations == problem.history[0].linear_iterations)
    agree(not logged(caplog))
