# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Krylov methods of the dual form: the norms that they monitor, the memory that they take."""

import resource
from pathlib import Path

from petsc4py import PETSc

import numpy as np
import pytest
from cases import case, each
from collective import agree, raises, small
from hand_torn import random_values, solve, solve_and_check

from dolfinx_feti.feti.option_checks import DUAL_METHODS
from dolfinx_feti.feti.options import read_options
from dolfinx_feti.runtime.petsc_options import inserted

GRID = case((3, 2), (3, 3), 2)
RTOL = 1e-10

#: Units of the stiffness. With stiff and soft subdomains whose copies are weighed alike, a solve
#: starts where the norms of the methods and that of the assembled residual are far apart.
every_scale = pytest.mark.parametrize("scale", [1e-8, 1.0, 1e8])
every_method = pytest.mark.parametrize("method", DUAL_METHODS)


def grid_with_jumps(torn_grid, scale):
    """Tear a grid of stiff and soft subdomains in a chequered pattern."""
    return torn_grid(stiffness=lambda i: scale * 100.0 ** (i % 2), **GRID)


@every_method
@every_scale
def test_every_method_monitors_the_assembled_residual(method, scale, torn_grid, create_ksp):
    """The first norm is measured; the last one, which ends the solve, is close to the true one."""
    problem = grid_with_jumps(torn_grid, scale)
    ksp = create_ksp(
        problem.A,
        feti_formulation="dual",
        feti_dual_ksp_type=method,
        feti_scaling="multiplicity",
        ksp_rtol=RTOL,
    )
    ksp.setConvergenceHistory(length=1000)
    values = random_values(problem)
    reason, x = solve(ksp, problem, values)
    norms = ksp.getConvergenceHistory()
    agree(reason > 0, ksp.getPythonContext().message)
    reference = create_ksp(
        problem.A, feti_formulation="dual", feti_scaling="multiplicity", ksp_rtol=RTOL
    )
    reference.setConvergenceHistory(length=1000)
    solve(reference, problem, values)
    small(norms[0] / reference.getConvergenceHistory()[0] - 1.0, 1e-6)
    shown_over_true = norms[-1] / ksp.getResidualNorm()
    agree(1 / 5 < shown_over_true < 5, f"shown norm over true norm: {shown_over_true}")
    expected = problem.solve(values)
    small(np.abs(x - expected).max() / np.abs(expected).max(), 1e-8)


def chained_message(error):
    """Return the message of an error and of those that have led to it."""
    before = error.__cause__ or error.__context__
    return str(error) if before is None else f"{error}\n{chained_message(before)}"


@every_method
@pytest.mark.parametrize("norm", ["unpreconditioned", "natural", "preconditioned"])
def test_every_supported_norm_solves(method, norm, torn_grid, create_ksp):
    """PETSc refuses some pairs of method and norm by name; all others give the solution."""
    problem = grid_with_jumps(torn_grid, 1.0)
    options = {"feti_dual_ksp_type": method, "feti_dual_ksp_norm_type": norm, "ksp_rtol": RTOL}
    try:
        context = solve_and_check(
            create_ksp(problem.A, feti_formulation="dual", **options), problem
        )
    except PETSc.Error as error:
        agree("does not support norm type" in chained_message(error), chained_message(error))
    else:
        agree(context.method == method)


@pytest.mark.parametrize(
    "method",
    ["bicg", "cgne", "chebyshev", "fbcgs", "lsqr", "none", "pipecr", "preonly", "richardson"],
)
def test_unsupported_krylov_methods_are_refused(method):
    """The error lists those that are supported."""
    with (
        inserted("o_", {"feti_dual_ksp_type": method}),
        raises(ValueError, f"-o_feti_dual_ksp_type is '{method}'; it takes one of: cg, fcg"),
    ):
        read_options("o_")


def test_krylov_method_without_a_norm_is_refused():
    """Without a norm a solve cannot end by its residual."""
    with (
        inserted("o_", {"feti_dual_ksp_norm_type": "none"}),
        raises(ValueError, "-o_feti_dual_ksp_norm_type is 'none'; it takes a norm"),
    ):
        read_options("o_")


@pytest.fixture
def little_memory():
    """Limit the memory of the process to 512 MiB more than it has."""
    old = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + 2**29, old[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, old)


HUGE_LIMITS = {
    "cg": {"ksp_max_it": "unlimited"},
    "cg, a number": {"ksp_max_it": 2**31 - 1},
    "cg, its own tolerance": {"ksp_max_it": "unlimited", "feti_dual_ksp_rtol": 1e-12},
    "cg, its own limit": {"feti_dual_ksp_max_it": "unlimited", "feti_dual_ksp_rtol": 1e-12},
    "fcg": {"ksp_max_it": "unlimited", "feti_dual_ksp_type": "fcg"},
    "fcg, directions": {"feti_dual_ksp_fcg_mmax": 2**31 - 1, "feti_dual_ksp_type": "fcg"},
    "gmres": {"ksp_max_it": "unlimited", "feti_dual_ksp_type": "gmres"},
    "gmres, restart": {"feti_dual_ksp_gmres_restart": 2**31 - 1, "feti_dual_ksp_type": "gmres"},
    "fgmres, restart": {"feti_dual_ksp_gmres_restart": 10**6, "feti_dual_ksp_type": "fgmres"},
    "minres": {"ksp_max_it": "unlimited", "feti_dual_ksp_type": "minres"},
    "primal": {"ksp_max_it": "unlimited", "feti_formulation": "primal"},
}


@each("options", HUGE_LIMITS)
def test_no_memory_is_reserved_for_iterations_that_are_not_taken(
    options, little_memory, torn_grid, create_ksp
):
    """Unlimited iterations, restarts or directions need at most 512 MiB, as few as are taken."""
    problem = torn_grid(**GRID)
    solve_and_check(
        create_ksp(problem.A, **{"feti_formulation": "dual", "ksp_rtol": RTOL, **options}), problem
    )


def test_iterations_may_exceed_those_of_one_run(torn_grid, create_ksp, monkeypatch):
    """A fresh start follows each run of PETSc's method, and the user's limit holds."""
    monkeypatch.setattr("dolfinx_feti.feti.dual.krylov.MAX_ITERATIONS_OF_RUN", 8)
    problem = grid_with_jumps(torn_grid, 1.0)
    options = {"feti_formulation": "dual", "feti_scaling": "multiplicity", "ksp_rtol": 1e-8}
    context = solve_and_check(create_ksp(problem.A, **options), problem, 1e-6)
    agree(context.iterations > 8)
    limited = create_ksp(problem.A, ksp_max_it=12, **options)
    reason, _ = solve(limited, problem, random_values(problem))
    agree(reason == PETSc.KSP.ConvergedReason.DIVERGED_MAX_IT)
    agree(limited.getIterationNumber() == 12)
