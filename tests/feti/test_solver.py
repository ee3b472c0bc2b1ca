# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The KSP: a dense reference, prestress, and what PETSc expects of a solver."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import pytest
import reference
from collective import COMM, agree, dense, equal, raises, small, whole

from dolfinx_feti import FETI
from dolfinx_feti.feti.inertia import Inertia
from dolfinx_feti.feti.krylov.method import solve as krylov_solve
from dolfinx_feti.feti.recovery import balanced_start, load, recover
from dolfinx_feti.petsc_options import inserted

SEED = 101013

GRIDS = {
    "Laplace in 1-D": {"subdomains": (5,), "cells": (3,)},
    "Laplace in 2-D": {"subdomains": (3, 2), "cells": (2, 3)},
    "Laplace in 3-D": {"subdomains": (2, 2, 2), "cells": (2, 2, 1)},
    "elasticity in 2-D": {"subdomains": (2, 3), "cells": (3, 2), "components": 2},
    "elasticity in 3-D": {"subdomains": (2, 2, 1), "cells": (1, 2, 2), "components": 3},
    "jumping stiffness": {
        "subdomains": (3, 2),
        "cells": (2, 2),
        "components": 2,
        "stiffness": lambda i: 20.0 ** (i % 2),
    },
    "component-wise conditions": {
        "subdomains": (2, 2),
        "cells": (2, 2),
        "components": 2,
        "fixed": lambda x: x == 0.0,
    },
    "held in single nodes": {
        "subdomains": (2, 2),
        "cells": (2, 2),
        "components": 2,
        "fixed": lambda x: np.isin(np.arange(len(x)), (0, len(x) - 1)),
    },
}
every_grid = pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS)
every_type = pytest.mark.parametrize("kind", ["all_floating", "classical"])


def random_values(problem, seed=SEED):
    """Loads and prescribed values."""
    return np.random.default_rng(seed).standard_normal(len(problem.dirichlet))


def solve(ksp, problem, values):
    """Solve; return the reason and all of x."""
    x = problem.A.createVecRight()
    ksp.solve(problem.vector(values), x)
    return ksp.getConvergedReason(), whole(x.array_r)


def shifted(size):
    """Add ±X to the two sides of each interface: the assembled matrix stays as it is."""

    def change(K, dofs):
        rng = np.random.default_rng(SEED + 1)
        for i in range(len(K)):
            for j in range(i):
                common = np.intersect1d(dofs[i], dofs[j])
                if len(common) < 4:
                    continue
                half = rng.standard_normal((len(common), len(common)))
                X = size * np.abs(K[i]).max() * (half + half.T) / np.sqrt(len(common))
                for k, sign in ((i, 1.0), (j, -1.0)):
                    rows = np.searchsorted(dofs[k], common)
                    K[k][np.ix_(rows, rows)] += sign * X

    return change


# ---- the dense reference --------------------------------------------------------------------


@every_grid
@every_type
def test_multipliers_and_displacements_are_those_of_the_dense_reference(
    grid, kind, torn_grid, parts
):
    """Bᵀλ, which is unique, and u; B u = c and Gᵀλ = e."""
    problem = torn_grid(**grid)
    system = parts(problem.A, type=kind)
    torn, gluing = system.torn, system.gluing
    b = problem.vector(random_values(problem))
    u_D = np.where(torn.dirichlet, torn.tear(b), 0.0)
    f, c = load(system, b, u_D), gluing.gap(u_D)
    pair, rest = balanced_start(system, f, c)
    target = 1e-12 * b.norm()
    pair += krylov_solve(
        system.dual, rest, system.method, target=target, max_it=500, monitor=lambda *_: None
    ).x
    lam = whole(system.dual.split(pair)[0])
    u = whole(recover(system, pair, f, u_D))

    B, G = dense(gluing.B), dense(system.coarse.G)
    held = problem.dirichlet[problem.to_global]
    free = ~whole(system.inverse.fixed)
    u_ref, lam_ref = reference.feti(
        problem.K_torn[np.ix_(free, free)], whole(f)[free], B[:, free], whole(c)
    )
    equal(B[:, free].T @ lam, B[:, free].T @ lam_ref, 1e-8)
    equal(u[free], u_ref, 1e-8)
    equal(u[held], (problem.T @ whole(b.array_r))[held], 1e-8)
    small(np.abs(B @ u - whole(c)).max(), 1e-8 * np.abs(u).max())
    equal(G.T @ lam, whole(system.coarse.restrict(f)), 1e-8)


@every_grid
@every_type
def test_solution_is_that_of_the_assembled_problem(grid, kind, torn_grid, feti):
    problem = torn_grid(**grid)
    ksp = feti(problem.A, feti_type=kind, ksp_rtol=1e-10)
    values = random_values(problem)
    reason, x = solve(ksp, problem, values)
    agree(reason > 0, ksp.getPythonContext().message)
    equal(x, problem.solve(values), 1e-8)
    K = problem.T.T @ problem.K_torn @ problem.T
    lifted = np.where(problem.dirichlet, values, 0.0)
    free = ~problem.dirichlet
    scale = np.linalg.norm((values - K @ lifted)[free])
    residual = np.linalg.norm((values - K @ x)[free]) / scale
    small(residual, 1e-10)
    equal(ksp.getPythonContext().residual, residual, 1e-2 + 1e-14 / residual)


# ---- prestress ------------------------------------------------------------------------------


@every_type
@pytest.mark.parametrize("size", [1e-7, 1e-3, 0.1, 0.5])
@pytest.mark.parametrize("options", [{}, {"feti_indefinite": "gmres"}], ids=["enrich", "gmres"])
def test_prestress_is_solved_exactly(size, kind, options, torn_grid, feti):
    """The modes leave the kernels, K_ρ turns indefinite, the assembled matrix does not notice."""
    grid = {"subdomains": (2, 2), "cells": (3, 3), "components": 2}
    plain, problem = torn_grid(**grid), torn_grid(**grid, change=shifted(size))
    values = random_values(problem)
    expected = plain.solve(values)
    equal(problem.solve(values), expected, 1e-10)
    ksp = feti(problem.A, feti_type=kind, ksp_rtol=1e-11, **options)
    reason, x = solve(ksp, problem, values)
    agree(reason > 0, ksp.getPythonContext().message)
    equal(x, expected, 1e-8)
    report = ksp.getPythonContext().report()
    agree(report.exact < 4, report)
    if size == 0.5:
        agree(report.inertia.dual > 0)
        agree(ksp.getPythonContext().method == "gmres")


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("size", [1e-8, 1e-2])
def test_interior_prestress_of_either_sign(sign, size, torn_grid, feti):
    """K symmetric with K R ≠ 0 in some subdomains: D ≠ 0, and the assembled problem is solved."""

    def change(K, dofs):
        rng = np.random.default_rng(SEED + 2)
        interior = slice(8, 10)  # the middle node of a 2 × 2 brick
        for i in (0, 2):
            half = rng.standard_normal((2, 2))
            K[i][interior, interior] += sign * size * np.abs(K[i]).max() * (half @ half.T)

    problem = torn_grid((2, 2), (2, 2), components=2, change=change)
    ksp = feti(problem.A, ksp_rtol=1e-11)
    values = random_values(problem)
    reason, x = solve(ksp, problem, values)
    agree(reason > 0, ksp.getPythonContext().message)
    equal(x, problem.solve(values), 1e-8)
    report = ksp.getPythonContext().report()
    agree(report.exact == 2, report.exact)
    agree((report.inertia.defect > 0) == (sign < 0), report.inertia)
    agree(ksp.getPythonContext().method == ("cg" if sign > 0 else "gmres"))


@every_type
def test_unsymmetric_matrix_is_solved_by_gmres(kind, torn_grid, feti):
    def change(K, dofs):
        rng = np.random.default_rng(SEED + 3)
        for K_i in K:
            K_i += 0.05 * np.abs(K_i).max() * rng.standard_normal(K_i.shape) * (K_i != 0.0)

    problem = torn_grid((2, 2), (3, 2), components=2, change=change)
    values = random_values(problem)
    expected = problem.solve(values)
    for q in ("preconditioner", "diagonal", "identity"):
        ksp = feti(problem.A, feti_type=kind, feti_coarse_q=q, ksp_rtol=1e-11)
        reason, x = solve(ksp, problem, values)
        agree(reason > 0, ksp.getPythonContext().message)
        agree(ksp.getPythonContext().method == "gmres")
        equal(x, expected, 1e-8)


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
    agree(reason == PETSc.KSP.ConvergedReason.CONVERGED_RTOL)
    equal(x, problem.solve(values), 1e-7)
    agree(ksp.getPythonContext().report().options.pc_type == "lumped")
    agree(ksp.getTolerances()[0] == 1e-9)
    agree(ksp.getPC().getType() == "none")
    ksp.destroy()


def test_default_tolerance_is_stricter_than_that_of_petsc(torn_grid, feti):
    ksp = feti(torn_grid((2,), (2,)).A)
    agree(ksp.getTolerances()[0] == 1e-8)


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
        (
            "all_floating",
            ["4 of dimension 3; 4 exact", "full gluing", "coarse size           12\n"],
        ),
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

    def counts():
        return [PETSc.Log.Event(name).getPerfInfo()["count"] for name in names]

    before = counts()
    problem = torn_grid((2, 2), (2, 2))
    ksp = feti(problem.A)
    solve(ksp, problem, random_values(problem))
    solve(ksp, problem, random_values(problem, SEED + 4))
    problem.local.scale(2.0)
    solve(ksp, problem, random_values(problem))
    equal(np.array(counts()) - before, [1, 2, 2, 3, 3])


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


def test_several_loads_with_one_set_up(torn_grid, feti):
    problem = torn_grid((2, 2), (2, 2), components=2)
    ksp = feti(problem.A, ksp_rtol=1e-10)
    for seed in range(SEED, SEED + 3):
        values = random_values(problem, seed)
        _, x = solve(ksp, problem, values)
        equal(x, problem.solve(values), 1e-8)


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
