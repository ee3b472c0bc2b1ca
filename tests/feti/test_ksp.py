# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What PETSc and its users expect of a KSP: options, monitors, tolerances, changing matrices."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import pytest
from collective import COMM, agree, dense, equal, raises, small
from hand_torn import random_values, solve

from dolfinx_feti import FETI
from dolfinx_feti.feti.setup import Inertia
from dolfinx_feti.runtime.petsc_options import inserted

SEED = 101013
GRID = {"subdomains": (3, 2), "cells": (3, 3), "components": 2}
Reason = PETSc.KSP.ConvergedReason


# ---- a solver of PETSc ----------------------------------------------------------------------


def test_type_from_the_command_line(torn_grid):
    """-ksp_type python -ksp_python_type dolfinx_feti.FETI."""
    problem = torn_grid((2, 2), (2, 2))
    ksp = PETSc.KSP().create(COMM)
    ksp.setOptionsPrefix("mine_")
    ksp.setOperators(problem.A)
    options = {
        "ksp_type": "python",
        "ksp_python_type": "dolfinx_feti.FETI",
        "ksp_rtol": 1e-9,
        "feti_pc_type": "lumped",
    }
    with inserted("mine_", options):
        ksp.setFromOptions()
        ksp.setUp()
    values = random_values(problem)
    reason, x = solve(ksp, problem, values)
    agree(reason == Reason.CONVERGED_RTOL)
    equal(x, problem.solve(values), 1e-7)
    agree(ksp.getPythonContext().report().options.pc_type == "lumped")
    agree(ksp.getTolerances()[0] == 1e-9)
    agree(ksp.getPC().getType() == "none")
    ksp.destroy()


def test_monitor_and_history(torn_grid, feti):
    """The norm of the assembled residual at the start and after each iteration."""
    problem = torn_grid((3, 2), (3, 3), components=2)
    ksp = feti(problem.A, feti_coarse_q="identity")
    seen = []
    ksp.setMonitor(lambda ksp, its, rnorm: seen.append((its, rnorm)))
    ksp.setConvergenceHistory(length=100)
    solve(ksp, problem, random_values(problem))
    its = ksp.getIterationNumber()
    agree([k for k, _ in seen] == list(range(its + 1)), seen)
    agree(ksp.getPythonContext().iterations == its)
    equal(ksp.getConvergenceHistory(), [rnorm for _, rnorm in seen])
    small(ksp.getResidualNorm() / seen[-1][1] - 1.0, 1e-2)
    agree(seen[-1][1] < 1e-7 * seen[0][1])


def test_monitor_of_gmres_knows_the_start(torn_grid, feti):
    """GMRES estimates the assembled residual; at the start it is measured."""
    problem = torn_grid((3, 2), (3, 3), components=2)
    first = []
    for method in ("cg", "gmres"):
        ksp = feti(problem.A, feti_dual_ksp_type=method, feti_interior="keep")
        seen = []
        ksp.setMonitor(lambda ksp, its, rnorm, seen=seen: seen.append(rnorm))
        solve(ksp, problem, random_values(problem))
        agree(np.all(np.isfinite(seen)), seen)
        first.append(seen[0])
    small(first[1] / first[0] - 1.0, 1e-6)


def test_view(torn_grid, feti, tmp_path):
    problem = torn_grid((2, 2), (3, 3), components=2)
    path = tmp_path / "view"

    def text(ksp):
        viewer = PETSc.Viewer().createASCII(str(path), comm=COMM)
        ksp.view(viewer)
        viewer.destroy()
        return COMM.bcast(path.read_text() if COMM.rank == 0 else None)

    ksp = PETSc.KSP().create(COMM)
    ksp.setType(PETSc.KSP.Type.PYTHON)
    ksp.setPythonContext(feti(problem.A, feti_type="classical").getPythonContext())
    agree("python" in text(ksp))
    ksp.destroy()
    for kind, expected in (
        ("classical", ["2 of dimension 0, 2 of dimension 3", "dofs", "subdomains            4\n"]),
        ("all_floating", ["4 of dimension 3; 4 exact", "dual form", "coarse size           12,"]),
    ):
        ksp = feti(problem.A, feti_type=kind)
        solve(ksp, problem, random_values(problem))
        report = ksp.getPythonContext().report()
        expected += [kind, "dirichlet", f"{report.multipliers}", "MiB", "condition number"]
        shown = text(ksp)
        agree(all(word in shown for word in expected), shown)


def test_report(torn_grid, feti):
    problem = torn_grid((2, 2), (3, 3), components=2)
    ksp = feti(problem.A)
    solve(ksp, problem, random_values(problem))
    report = ksp.getPythonContext().report()
    agree(report.subdomains == 4 and report.dofs == 98 and report.torn_dofs == 128, report)
    agree(report.dofs_local == (32, 32) and report.kernels == (0, 0, 0, 4), report)
    agree(report.coarse_size == 12 and report.exact == 4 and report.coarse_inertia == (0, 0))
    agree(report.inertia == Inertia(0, 0, 0, 0))
    low, high = report.eigenvalues
    agree(1.0 - 1e-6 <= low < high < 10.0, report.eigenvalues)
    equal(ksp.getPythonContext().condition_number, high / low, 1e-14)


def test_log_events(torn_grid, feti):
    """-log_view counts the phases."""
    PETSc.Log.begin()
    names = ("FETIGluing", "FETIFactor", "FETICoarse", "FETISolve", "FETIIterations")
    names += ("FETISchur", "FETIModes", "FETISchurProduct", "FETILocalSolve", "FETICoarseSolve")

    def counts():
        return [PETSc.Log.Event(name).getPerfInfo()["count"] for name in names]

    before = counts()
    problem = torn_grid((2, 2), (2, 2))
    ksp = feti(problem.A)
    solve(ksp, problem, random_values(problem))
    solve(ksp, problem, random_values(problem, SEED + 4))
    problem.local.scale(2.0)
    solve(ksp, problem, random_values(problem))
    found = np.array(counts()) - before
    equal(found[:7], [3, 5, 2, 3, 3, 2, 2])
    agree(found[7:].min() > 0, found)


def test_matrix_may_change_its_values(torn_grid, feti):
    """The KSP notices it without setUp being called again, and takes another matrix as well."""
    problem = torn_grid((2, 2), (2, 2), components=2)
    values = random_values(problem)
    ksp = feti(problem.A, ksp_rtol=1e-11)
    _, x = solve(ksp, problem, values)
    problem.local.scale(4.0)
    _, y = solve(ksp, problem, np.where(problem.dirichlet, values, 4.0 * values))
    equal(y, x, 1e-9)
    for K_i in problem.K:
        K_i *= 4.0
    shift = 3.0 * np.abs(problem.K[0]).max()
    problem.local.shift(shift)
    for K_i in problem.K:
        K_i += shift * np.eye(len(K_i))
    _, y = solve(ksp, problem, values)
    equal(y, problem.solve(values), 1e-9)
    other = torn_grid((4, 1), (1, 4), components=2)  # of the same size
    ksp.setOperators(other.A)
    _, y = solve(ksp, other, values)
    equal(y, other.solve(values), 1e-9)
    agree(ksp.getPythonContext().report().torn_dofs == len(other.to_global))


def test_no_load_needs_no_iteration(torn_grid, feti):
    problem = torn_grid((2, 2), (2, 2), components=2)
    ksp = feti(problem.A)
    reason, x = solve(ksp, problem, np.zeros(len(problem.dirichlet)))
    agree(reason > 0 and ksp.getIterationNumber() == 0, (reason, ksp.getIterationNumber()))
    equal(x, np.zeros(len(x)))


def test_load_that_is_solved_by_the_prescribed_values(torn_grid, feti):
    """A rigid motion of the whole boundary is the solution, up to rounding."""
    problem = torn_grid((2, 2), (2, 2), components=2)
    motion = problem.modes @ np.array([0.5, 2.0, -0.1])
    values = np.where(problem.dirichlet, motion, 0.0)
    ksp = feti(problem.A)
    reason, x = solve(ksp, problem, values)
    agree(reason > 0, ksp.getPythonContext().message)
    equal(x, motion, 1e-8)


def test_absolute_tolerance(torn_grid, feti):
    problem = torn_grid((2, 2), (3, 3), components=2)
    values = random_values(problem)
    ksp = feti(problem.A, ksp_rtol=1e-14, ksp_atol=1e-3, feti_coarse_q="identity")
    reason, x = solve(ksp, problem, values)
    agree(reason > 0)
    K = problem.T.T @ problem.K_torn @ problem.T
    residual = np.linalg.norm((values - K @ x)[~problem.dirichlet])
    agree(1e-9 < residual <= 1e-3, residual)


@pytest.mark.parametrize("method", ["cg", "fcg", "gmres", "fgmres", "minres"])
def test_other_krylov_methods(method, torn_grid, feti):
    problem = torn_grid((3, 2), (2, 2), components=2)
    values = random_values(problem)
    ksp = feti(problem.A, feti_dual_ksp_type=method, ksp_rtol=1e-10)
    reason, x = solve(ksp, problem, values)
    agree(reason > 0, ksp.getPythonContext().message)
    equal(x, problem.solve(values), 1e-8)
    agree(ksp.getPythonContext().method == method)


@pytest.mark.parametrize(
    "options",
    [
        {"feti_coarse_pc_type": "lu"},
        {
            "feti_coarse_ksp_type": "cg",
            "feti_coarse_ksp_rtol": 1e-14,
            "feti_coarse_pc_type": "jacobi",
        },
        {"feti_dirichlet_pc_factor_mat_solver_type": "petsc"},
        {"feti_local_mat_mumps_icntl_7": 2},
        {"feti_dual_ksp_rtol": 1e-12},
    ],
    ids=lambda options: next(iter(options)),
)
def test_subsolvers_by_prefix(options, torn_grid, feti):
    problem = torn_grid((2, 2), (3, 3), components=2)
    values = random_values(problem)
    ksp = feti(problem.A, ksp_rtol=1e-10, **options)
    reason, x = solve(ksp, problem, values)
    agree(reason > 0, ksp.getPythonContext().message)
    equal(x, problem.solve(values), 1e-8)


def test_transposed_solve_is_refused(torn_grid, feti):
    problem = torn_grid((2,), (2,))
    ksp = feti(problem.A)
    b, x = problem.A.createVecLeft(), problem.A.createVecRight()
    with raises(PETSc.Error, ""):
        ksp.solveTranspose(b, x)


def test_assembled_matrix_is_refused(torn_grid):
    """The message, which PETSc prints with the traceback, says what to do."""
    problem = torn_grid((2,), (2,))
    assembled = PETSc.Mat()
    problem.A.convert("aij", assembled)
    ksp = PETSc.KSP().create(COMM)
    ksp.setOperators(assembled)
    ksp.setType(PETSc.KSP.Type.PYTHON)
    context = FETI()
    ksp.setPythonContext(context)
    with raises(TypeError, "create_torn_matrix"):
        context.setUp(ksp)
    ksp.destroy()
    assembled.destroy()


@pytest.mark.parametrize("formulation", ["dual", "primal"])
def test_monitor_of_one_process(formulation, torn_grid, feti):
    """As after ``if comm.rank == 0: ksp.setMonitor(…)``: it sees all iterations, and none waits."""
    problem = torn_grid((2, 2), (3, 3), components=2)
    ksp = feti(problem.A, feti_formulation=formulation)
    norms = []
    if COMM.rank == 0:
        ksp.setMonitor(lambda ksp, its, norm: norms.append(norm))
    solve(ksp, problem, random_values(problem))
    agree(ksp.getConvergedReason() > 0)
    agree(len(norms) == (ksp.getIterationNumber() + 1 if COMM.rank == 0 else 0), len(norms))


def test_symmetry_is_looked_at_after_a_failed_set_up(torn_grid, feti):
    """NaN, and then a matrix that is not symmetric any more."""
    problem = torn_grid((2, 2), (3, 3))
    ksp = feti(problem.A, ksp_rtol=1e-10)
    values = random_values(problem)
    solve(ksp, problem, values)
    keep = problem.local.copy()
    problem.local.scale(np.nan)
    reason, _ = solve(ksp, problem, values)
    agree(reason == Reason.DIVERGED_PCSETUP_FAILED)
    rows = problem.local.getSize()[0]
    keep.copy(problem.local, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
    weight = problem.local.createVecLeft()
    weight.array[:] = 1.0 + 0.05 * np.cos(np.arange(rows))
    problem.local.diagonalScale(weight)
    reason, x = solve(ksp, problem, values)
    agree(reason > 0, ksp.getPythonContext().message)
    agree(not ksp.getPythonContext().form.pattern.symmetric)
    whole_matrix = PETSc.Mat()
    problem.A.convert("aij", whole_matrix)
    K, free = dense(whole_matrix), ~problem.dirichlet
    equal((K @ x)[free], values[free], 1e-8)
    for owned in (keep, weight, whole_matrix):
        owned.destroy()


@pytest.mark.parametrize("formulation", ["dual", "primal"])
def test_advice_is_that_of_the_form(formulation, torn_grid, feti, cautious):
    """The remedy for an indefinite matrix has an effect on the form in force."""

    def push(K, dofs):
        K[0] -= 0.3 * np.abs(K[0]).max() * np.eye(len(K[0]))

    problem = torn_grid((2, 2), (3, 3), components=2, change=push)
    options = {"feti_dual_ksp_type": "cg"} if formulation == "dual" else {}
    ksp = feti(problem.A, feti_formulation=formulation, **options)
    reason, _ = solve(ksp, problem, random_values(problem))
    agree(reason < 0)
    advice = {"dual": "feti_dual_ksp_type gmres", "primal": "feti_formulation dual"}
    agree(advice[formulation] in ksp.getPythonContext().message, ksp.getPythonContext().message)


# ---- who decides when a solve ends ----------------------------------------------------------


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
