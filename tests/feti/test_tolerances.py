# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Who decides when a solve ends, and what it leaves when it has to give up."""

from __future__ import annotations

from petsc4py import PETSc

import pytest
from collective import COMM, agree, equal
from hand_torn import random_values, solve

from dolfinx_feti import FETI

GRID = {"subdomains": (3, 2), "cells": (3, 3), "components": 2}
Reason = PETSc.KSP.ConvergedReason


@pytest.mark.parametrize("before", [False, True])
def test_a_tolerance_set_by_hand_stays(before, torn_grid):
    """Before the type, PETSc's default 1e-5 cannot be told from the same number set by hand."""
    ksp = PETSc.KSP().create(COMM)
    ksp.setOperators(torn_grid((2,), (2,)).A)
    if before:
        ksp.setTolerances(rtol=1e-6)
    ksp.setType(PETSc.KSP.Type.PYTHON)
    ksp.setPythonContext(FETI())
    if not before:
        agree(ksp.getTolerances()[0] == 1e-8)
        ksp.setTolerances(rtol=1e-5)
    ksp.setUp()
    agree(ksp.getTolerances()[0] == (1e-6 if before else 1e-5), ksp.getTolerances())
    ksp.destroy()


def test_the_users_monitor_of_the_dual_method_stays(torn_grid, feti, tmp_path):
    """It sees every solve, also where the user's own tolerance decides."""
    problem, file = torn_grid(**GRID), tmp_path / "monitor"
    ksp = feti(problem.A, feti_dual_ksp_rtol=1e-6, feti_dual_ksp_monitor=f"ascii:{file}::append")
    counts = []
    for seed in (1, 2):
        solve(ksp, problem, random_values(problem, seed))
        COMM.Barrier()
        counts.append(file.read_text().count("KSP Residual norm"))
    agree(0 < counts[0] < counts[1], counts)


def test_the_outer_limit_of_iterations_holds_with_a_dual_tolerance(torn_grid, feti):
    problem = torn_grid(**GRID)
    ksp = feti(problem.A, feti_dual_ksp_rtol=1e-12, ksp_max_it=3, feti_coarse_q="identity")
    reason, _ = solve(ksp, problem, random_values(problem))
    agree(reason == Reason.DIVERGED_MAX_IT and ksp.getIterationNumber() == 3, reason)


@pytest.mark.parametrize("scale", [1e-8, 1.0, 1e8])
def test_minres_is_judged_by_its_own_norm(scale, torn_grid, feti):
    """It is the preconditioned one: it says nothing about whether the jump is what it should be."""
    problem = torn_grid(stiffness=lambda i: scale * 100.0 ** (i % 2), **GRID)
    counts = {}
    for method in ("cg", "minres"):
        ksp = feti(problem.A, feti_dual_ksp_type=method, feti_scaling="multiplicity")
        reason, _ = solve(ksp, problem, random_values(problem))
        agree(reason > 0, ksp.getPythonContext().message)
        counts[method] = ksp.getIterationNumber()
    agree(counts["minres"] <= counts["cg"] + 3, counts)


def test_a_matrix_that_changes_on_one_process_is_noticed_on_all(torn_grid, feti):
    """On the last process only; a process that saw no change would leave the others waiting."""
    problem = torn_grid((6, 2), (1, 1), components=2)
    values = random_values(problem)
    ksp = feti(problem.A, ksp_rtol=1e-11)
    solve(ksp, problem, values)
    if COMM.rank == COMM.size - 1:
        problem.local.scale(3.0)
    for i, K in enumerate(problem.K):
        K *= 3.0 if i * COMM.size // len(problem.K) == COMM.size - 1 else 1.0
    reason, x = solve(ksp, problem, values)
    agree(reason > 0, ksp.getPythonContext().message)
    equal(x, problem.solve(values), 1e-9)
