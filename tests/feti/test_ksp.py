# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""FETI behaves as any KSP of PETSc: options, monitors, tolerances, views and errors."""

import re
from pathlib import Path

from petsc4py import PETSc

import numpy as np
import pytest
from cases import every_formulation
from collective import COMM, agree, equal, raises, small, whole
from hand_torn import random_values, solve, solve_and_check
from mixed import solve_assembled
from problems import cube, dirichlet, elasticity, left, poisson

import dolfinx
import ufl

from dolfinx_feti import FETI, LinearProblem
from dolfinx_feti.feti.setup import Inertia
from dolfinx_feti.runtime.petsc_errors import python_errors
from dolfinx_feti.runtime.petsc_options import inserted

SEED = 101013
GRID = {"subdomains": (3, 2), "cells": (3, 3), "components": 2}
Reason = PETSc.KSP.ConvergedReason


# ---- a solver of PETSc ----------------------------------------------------------------------


def test_solver_is_selected_by_petsc_options(torn_grid, lifetime):
    """-ksp_type python -ksp_python_type dolfinx_feti.FETI creates the solver."""
    problem = torn_grid((2, 2), (2, 2))
    ksp = lifetime.own(PETSc.KSP().create(COMM))
    ksp.setOptionsPrefix("mine_")
    ksp.setOperators(problem.A)
    types = {"ksp_type": "python", "ksp_python_type": "dolfinx_feti.FETI"}
    with inserted("mine_", {**types, "ksp_rtol": 1e-9, "feti_pc_type": "lumped"}):
        ksp.setFromOptions()
        ksp.setUp()
    context = solve_and_check(ksp, problem, 1e-7)
    agree(ksp.getConvergedReason() == Reason.CONVERGED_RTOL)
    agree(context.report().options.pc_type == "lumped")
    agree(ksp.getTolerances()[0] == 1e-9 and ksp.getPC().getType() == "none")


@every_formulation
@pytest.mark.parametrize("everywhere", [True, False])
def test_monitor_gets_the_assembled_residual_of_each_iteration(
    everywhere, formulation, torn_grid, create_ksp
):
    """Monitor and history have its norm at the start and after each iteration.

    One process alone may set the monitor, as after ``if comm.rank == 0: ksp.setMonitor(…)``: it is
    called for all iterations, and no process waits.
    """
    problem = torn_grid(**GRID)
    monitored = []
    ksp = create_ksp(problem.A, feti_coarse_q="identity", feti_formulation=formulation)
    if everywhere or COMM.rank == 0:
        ksp.setMonitor(lambda ksp, its, rnorm: monitored.append((its, rnorm)))
    ksp.setConvergenceHistory(length=100)
    reason, _ = solve(ksp, problem, random_values(problem))
    its = ksp.getIterationNumber()
    norms = ksp.getConvergenceHistory()
    agree(reason > 0 and ksp.getPythonContext().iterations == its and len(norms) == its + 1)
    expected = list(enumerate(norms)) if everywhere or COMM.rank == 0 else []
    agree(monitored == expected, (monitored, norms))
    small(ksp.getResidualNorm() / norms[-1] - 1.0, 1e-2)
    agree(norms[-1] < 1e-7 * norms[0])


@pytest.mark.parametrize("everywhere", [True, False])
def test_convergence_test_is_refused(everywhere, torn_grid, create_ksp, lifetime):
    """FETI would never call it; all processes raise, even if one alone has set it."""
    problem = torn_grid((2,), (2,))
    ksp = create_ksp(problem.A)
    if everywhere or COMM.rank == 0:
        ksp.setConvergenceTest(lambda ksp, its, rnorm: 1)
    x, b = map(lifetime.own, problem.A.createVecs())
    with raises(ValueError, "setConvergenceTest has no effect: .*ksp_rtol"), python_errors():
        ksp.solve(b, x)


def test_error_for_an_assembled_matrix_is_also_logged(caplog, lifetime):
    """The error names both ways to a torn matrix; callers in C or C++ only see the log."""
    A = lifetime.own(PETSc.Mat().createAIJ((4, 4), comm=COMM))
    first, last = A.getOwnershipRange()
    for i in range(first, last):
        A.setValue(i, i, 1.0)
    A.assemble()
    ksp = lifetime.own(PETSc.KSP().create(COMM))
    ksp.setOperators(A)
    ksp.setType("python")
    ksp.setPythonContext(FETI())
    x, b = map(lifetime.own, A.createVecs())
    ways = r"type .*aij.*LinearProblem\(a, L, bcs=bcs\).*linear_system\(\).*create_torn_matrix"
    with raises(TypeError, ways), python_errors():
        ksp.solve(b, x)
    logged = [record.getMessage() for record in caplog.records if record.levelname == "ERROR"]
    agree(len(logged) == (1 if COMM.rank == 0 else 0), logged)
    agree(all(re.search(ways, text) for text in logged), logged)


def test_first_norm_of_gmres_is_measured(torn_grid, create_ksp):
    """GMRES estimates the assembled residual later on; at the start it is that of CG."""
    problem = torn_grid(**GRID)
    histories = {}
    for method in ("cg", "gmres"):
        ksp = create_ksp(problem.A, feti_dual_ksp_type=method, feti_interior="keep")
        ksp.setConvergenceHistory()
        solve(ksp, problem, random_values(problem))
        histories[method] = ksp.getConvergenceHistory()
    agree(all(np.isfinite(norms).all() for norms in histories.values()), histories)
    small(histories["gmres"][0] / histories["cg"][0] - 1.0, 1e-6)


def test_view_prints_the_report(torn_grid, create_ksp, lifetime, tmp_path):
    """ksp.view lists options, sizes, kernels and the condition number of the report."""
    problem = torn_grid((2, 2), (3, 3), components=2)
    path = tmp_path / "view"

    def text(ksp):
        viewer = PETSc.Viewer().createASCII(str(path), comm=COMM)
        ksp.view(viewer)
        viewer.destroy()
        return COMM.bcast(path.read_text() if COMM.rank == 0 else None)

    ksp = lifetime.own(PETSc.KSP().create(COMM))
    ksp.setType(PETSc.KSP.Type.PYTHON)
    ksp.setPythonContext(create_ksp(problem.A, feti_type="classical").getPythonContext())
    agree("python" in text(ksp))
    size = "coarse size           12,"
    for kind, formulation, expected in (
        ("classical", "dual", ["2 of dimension 0, 2 of dimension 3", "subdomains            4\n"]),
        ("all_floating", "primal", ["4 of dimension 3; 4 exact", "primal form", "primal system"]),
        ("all_floating", "dual", ["4 of dimension 3; 4 exact", "dual form", "dual system", size]),
    ):
        ksp = create_ksp(problem.A, feti_type=kind, feti_formulation=formulation)
        solve(ksp, problem, random_values(problem))
        report = ksp.getPythonContext().report()
        expected += [kind, "dirichlet", f"{report.multipliers}", "MiB", "condition number"]
        printed = text(ksp)
        agree(all(word in printed for word in expected), printed)
    # of the last solver, all-floating and dual
    agree(report.subdomains == 4 and report.dofs == 98 and report.torn_dofs == 128, report)
    agree(report.dofs_local == (32, 32) and report.kernels == (0, 0, 0, 4), report)
    agree(report.coarse_size == 12 and report.exact == 4 and report.coarse_inertia == (0, 0))
    agree(report.inertia == Inertia(0, 0, 0, 0))
    low, high = report.eigenvalues
    agree(1.0 - 1e-6 <= low < high < 10.0, report.eigenvalues)
    equal(ksp.getPythonContext().condition_number, high / low, 1e-14)


@pytest.mark.parametrize(
    ("formulation", "expected"),
    [("dual", [3, 5, 2, 3, 3, 2, 2]), ("primal", [3, 5, 4, 3, 3, 2, 2])],
)
def test_log_view_counts_each_phase(formulation, expected, torn_grid, create_ksp):
    """There are three solves with two matrices, and all of the set-up is done for each matrix.

    Gluing and factorisation are also counted once for the pattern, and the factors of K_II and K_ρ
    for each matrix. The primal form counts its columns and the coarse matrix separately, since the
    columns may outlast the matrix.
    """
    PETSc.Log.begin()
    names = ("FETIGluing", "FETIFactor", "FETICoarse", "FETISolve", "FETIIterations")
    names += ("FETISchur", "FETIModes", "FETISchurProduct", "FETILocalSolve", "FETICoarseSolve")

    def counts():
        return np.array([PETSc.Log.Event(name).getPerfInfo()["count"] for name in names])

    before = counts()
    problem = torn_grid((2, 2), (2, 2))
    ksp = create_ksp(problem.A, feti_formulation=formulation)
    solve(ksp, problem, random_values(problem))
    solve(ksp, problem, random_values(problem, SEED + 4))
    problem.local.scale(2.0)
    solve(ksp, problem, random_values(problem))
    added = counts() - before
    equal(added[:7], expected)
    agree(added[7:].min() > 0, added)


def test_zero_load_needs_no_iteration(torn_grid, create_ksp):
    """A rigid motion prescribed on the whole boundary is solved, too."""
    problem = torn_grid((2, 2), (2, 2), components=2)
    ksp = create_ksp(problem.A)
    context = solve_and_check(ksp, problem, 0.0, values=np.zeros(len(problem.dirichlet)))
    agree(context.iterations == 0 == ksp.getIterationNumber())
    motion = problem.modes @ np.array([0.5, 2.0, -0.1])
    solve_and_check(ksp, problem, values=np.where(problem.dirichlet, motion, 0.0))


def test_absolute_tolerance_ends_a_solve(torn_grid, create_ksp):
    """-ksp_atol bounds the residual on the free dofs."""
    problem = torn_grid((2, 2), (3, 3), components=2)
    values = random_values(problem)
    ksp = create_ksp(problem.A, ksp_rtol=1e-14, ksp_atol=1e-3, feti_coarse_q="identity")
    reason, x = solve(ksp, problem, values)
    residual = np.linalg.norm((values - problem.matrix @ x)[~problem.dirichlet])
    agree(reason > 0 and 1e-9 < residual <= 1e-3, residual)


OPTIONS = [
    *({"feti_dual_ksp_type": name} for name in ("cg", "fcg", "gmres", "fgmres", "minres")),
    {"feti_coarse_pc_type": "lu"},
    {"feti_coarse_ksp_type": "cg", "feti_coarse_ksp_rtol": 1e-14, "feti_coarse_pc_type": "jacobi"},
    {"feti_dirichlet_pc_factor_mat_solver_type": "petsc"},
    {"feti_local_mat_mumps_icntl_7": 2},
    {"feti_dual_ksp_rtol": 1e-12},
]


@pytest.mark.parametrize("options", OPTIONS)
def test_options_reach_krylov_methods_and_subsolvers_by_prefix(options, torn_grid, create_ksp):
    """Each choice of the Krylov method, coarse solver or factorisation gives the solution."""
    problem = torn_grid((3, 2), (3, 3), components=2)
    context = solve_and_check(create_ksp(problem.A, ksp_rtol=1e-10, **options), problem)
    agree(context.method == options.get("feti_dual_ksp_type", "cg"))


TRANSPOSED = [
    {},
    {"feti_type": "classical"},
    {"feti_formulation": "dual"},
    {"feti_formulation": "primal"},
]


@pytest.mark.parametrize("options", TRANSPOSED)
def test_transposed_solve_of_a_symmetric_matrix_is_a_solve(
    options, torn_grid, create_ksp, lifetime
):
    """It may be the first one, follow a solve, or follow a change of the matrix."""
    problem = torn_grid((3, 2), (3, 3))
    b, x, y = (lifetime.own(problem.A.createVecRight()) for _ in range(3))
    b.array[:] = np.arange(1.0, len(b.array_r) + 1.0)
    ksp = create_ksp(problem.A, ksp_rtol=1e-10, **options)
    ksp.solveTranspose(b, x)
    agree(ksp.getConvergedReason() > 0)
    ksp.solve(b, y)
    equal(x.array_r, y.array_r, 1e-8)
    problem.local.scale(2.0)
    ksp.solveTranspose(b, x)
    ksp.solve(b, y)
    equal(x.array_r, y.array_r, 1e-8)


@pytest.mark.parametrize("way", ["KSP", "problem"])
def test_transposed_solve_of_an_unsymmetric_matrix_is_refused(way):
    """The error names the adjoint form, which solves Aᵀ y = c: c·A⁻¹ b = y·b."""
    mesh = cube(2, 6)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1))
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + 5.0 * u.dx(0) * v) * ufl.dx
    x = ufl.SpatialCoordinate(mesh)
    load = (1 + x[1]) * v * ufl.dx
    goal = x[0] * v * ufl.dx
    common = {"bcs": [dirichlet(V, left)], "subdomains": 4, "petsc_options": {"ksp_rtol": 1e-11}}
    primal = LinearProblem(a, load, **common)
    uh = primal.solve()
    with raises(NotImplementedError, r"LinearProblem\(ufl\.adjoint\(a\)"), python_errors():
        if way == "KSP":
            A, b = primal.linear_system()
            primal.create_linear_solver().solveTranspose(b, A.createVecRight())
        else:
            primal.solver.solveTranspose(primal.b, primal.x.duplicate())
    yh = LinearProblem(ufl.adjoint(a), goal, **common).solve()
    values = []
    for form, w in ((goal, uh), (load, yh)):
        functional = dolfinx.fem.form(ufl.action(form, w))
        values.append(COMM.allreduce(dolfinx.fem.assemble_scalar(functional)))
    small(values[0] / values[1] - 1.0, 1e-8)


def test_set_up_refuses_an_assembled_matrix(torn_grid, lifetime):
    """The error, which PETSc prints with the traceback, says how to create a torn one."""
    problem = torn_grid((2,), (2,))
    assembled = lifetime.own(PETSc.Mat())
    problem.A.convert("aij", assembled)
    ksp = lifetime.own(PETSc.KSP().create(COMM))
    context = FETI()
    ksp.setOperators(assembled)
    ksp.setType(PETSc.KSP.Type.PYTHON)
    ksp.setPythonContext(context)
    with raises(TypeError, "create_torn_matrix"):
        context.setUp(ksp)


def test_symmetry_is_detected_again_after_a_failed_set_up(torn_grid, create_ksp, lifetime):
    """The first set-up fails for NaN; the next matrix is not symmetric."""
    problem = torn_grid((2, 2), (3, 3))
    ksp = create_ksp(problem.A, ksp_rtol=1e-10)
    values = random_values(problem)
    solve(ksp, problem, values)
    original = lifetime.own(problem.local.copy())
    problem.local.scale(np.nan)
    reason, _ = solve(ksp, problem, values)
    agree(reason == Reason.DIVERGED_PCSETUP_FAILED)
    original.copy(problem.local, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
    weight = lifetime.own(problem.local.createVecLeft())
    weight.array[:] = 1.0 + 0.05 * np.cos(np.arange(weight.getSize()))
    problem.local.diagonalScale(weight)
    reason, x = solve(ksp, problem, values)
    agree(reason > 0, ksp.getPythonContext().message)
    agree(not ksp.getPythonContext().formulation.pattern.is_symmetric)
    equal(x, whole(solve_assembled(problem.A, problem.vector(values))), 1e-8)


# ---- who decides when a solve ends ----------------------------------------------------------


@pytest.mark.parametrize("before", [False, True])
def test_tolerance_set_by_the_user_is_kept(before, torn_grid, lifetime):
    """Setting the type replaces PETSc's default by FETI's, and no other tolerance."""
    ksp = lifetime.own(PETSc.KSP().create(COMM))
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


def test_monitor_of_the_dual_method_sees_every_solve(torn_grid, create_ksp, tmp_path):
    """This includes solves that end by the user's tolerance of the dual method."""
    problem = torn_grid(**GRID)
    file = tmp_path / "monitor"
    ksp = create_ksp(
        problem.A, feti_dual_ksp_rtol=1e-6, feti_dual_ksp_monitor=f"ascii:{file}::append"
    )
    counts = []
    for seed in (1, 2):
        solve(ksp, problem, random_values(problem, seed))
        COMM.Barrier()
        counts.append(file.read_text().count("KSP Residual norm"))
    agree(0 < counts[0] < counts[1], counts)


def test_iteration_limit_holds_with_a_dual_tolerance(torn_grid, create_ksp):
    """-ksp_max_it counts, although the dual method has a tolerance from the user."""
    problem = torn_grid(**GRID)
    ksp = create_ksp(problem.A, feti_dual_ksp_rtol=1e-12, ksp_max_it=3, feti_coarse_q="identity")
    reason, _ = solve(ksp, problem, random_values(problem))
    agree(reason == Reason.DIVERGED_MAX_IT and ksp.getIterationNumber() == 3, reason)


@pytest.mark.parametrize("scale", [1e-8, 1.0, 1e8])
def test_minres_takes_about_the_iterations_of_cg(scale, torn_grid, create_ksp):
    """MINRES ends by its preconditioned norm, which does not bound the jump."""
    problem = torn_grid(stiffness=lambda i: scale * 100.0 ** (i % 2), **GRID)
    counts = {}
    for method in ("cg", "minres"):
        ksp = create_ksp(problem.A, feti_dual_ksp_type=method, feti_scaling="multiplicity")
        reason, _ = solve(ksp, problem, random_values(problem))
        agree(reason > 0, ksp.getPythonContext().message)
        counts[method] = ksp.getIterationNumber()
    agree(counts["minres"] <= counts["cg"] + 3, counts)


# ---- what -ksp_view prints: one table, of the shape that docs/reading.md shows --------------

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture
def read_output(capfd):
    """Return a function that returns what PETSc has printed since its last call."""

    def read():
        return COMM.bcast(capfd.readouterr().out)

    read()
    return read


@pytest.mark.parametrize("value", [None, "ascii", True])
@every_formulation
def test_ksp_view_prints_one_table_for_each_solver(value, formulation, solve_linear, read_output):
    """It is printed at the first solve and fits on a screen."""
    problem = elasticity(cube(2, 6))
    linear = solve_linear(problem, 4, {"ksp_view": value, "feti_formulation": formulation})
    first = read_output()
    agree(first.count("KSP Object") == 1 and first.count("\n") <= 24, first)  # a screen
    agree(f"{formulation} form" in first and f" {COMM.size} MPI process" in first, first)
    linear.solve()
    agree(read_output() == "", "a second table")
    linear.diagnose()
    agree(read_output().count("KSP Object") == 1, "another solver")


def test_requested_views_are_printed_each_time(solve_linear, read_output):
    """A format of the user's prints at each solve, and ksp.view() at each call."""
    problem = poisson(cube(2, 6))
    linear = solve_linear(problem, 4, {"ksp_view": "::ascii_info_detail"})
    linear.solve()
    output = read_output()
    agree(output.count("type: python") == 2 and output.count("multipliers") == 2, output)
    agree(output.count("Mat Object") >= 2, output)
    linear = solve_linear(problem, 4)
    agree(read_output() == "")
    for _ in range(2):
        linear.solver.view()
        agree("multipliers" in read_output())


LINE = r"^(?:KSP Object|  [a-z]).*"  # of a table


def code_blocks(page, heading, language):
    """Return the blocks of code in a language below a heading of a page of the documentation."""
    section = (DOCS / page).read_text(encoding="utf-8").partition(f"\n## {heading}\n")[2]
    return re.findall(rf"^```{language}\n(.*?)^```", section.partition("\n## ")[0], re.M | re.S)


@pytest.mark.serial
@pytest.mark.parametrize(
    ("page", "prefix", "sample"), [("usage.md", "beam_", 0), ("nonlinear.md", "wall_", 1)]
)
def test_view_has_the_lines_that_the_documentation_shows(page, prefix, sample, read_output):
    """The programs of the pages print the table of reading.md, up to its numbers."""
    heading = {"usage.md": "A linear problem", "nonlinear.md": "A nonlinear problem"}[page]
    program = max(code_blocks(page, heading, "python"), key=len)
    with inserted(prefix, {"ksp_view": None}):
        exec(compile(program, page, "exec"), {})
    output = read_output()
    agree(output.count("KSP Object") == 1, output)
    shapes = [
        [re.sub(r"-?\d+(\.\d+)?(e-?\d+)?", "0", line) for line in re.findall(LINE, text, re.M)]
        for text in (code_blocks("reading.md", "Reading `-ksp_view`", "")[sample], output)
    ]
    agree(shapes[0] == shapes[1] and len(shapes[1]) >= 10, (shapes, output))
