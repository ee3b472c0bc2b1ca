# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Comparison of solvers on a user's problem, and the parts that it is made of."""

from __future__ import annotations

import json
import math
import mmap
import re
import time
from dataclasses import replace

from petsc4py import PETSc

import numpy as np
import pytest
from collective import COMM, agree, dense, equal, raises, small, whole
from problems import cube, elasticity, poisson
from walls import beam, tube, wall

import ufl

import dolfinx_feti
from dolfinx_feti import compare
from dolfinx_feti.comparison import (
    PeakMemory,
    assembled_system,
    create_solver,
    measure,
    relative_difference,
    relative_residual,
    run,
    solvers,
    timed_solve,
)
from dolfinx_feti.runtime import cost
from dolfinx_feti.runtime.petsc_options import inserted

RTOL = 1e-9
#: What is lost between residual and error on these small bodies.
CONDITION = 1e4
KEYS = {
    "solver",
    "dofs",
    "subdomains",
    "processes",
    "rtol",
    "converged",
    "seconds_setup",
    "seconds_solve",
    "peak_mib",
    "iterations",
    "converged_reason",
    "relative_residual",
    "error_estimate",
    "difference_to_direct",
    "note",
}


def linear(body, subdomains=6):
    return dolfinx_feti.LinearProblem(
        body.a, body.L, bcs=body.bcs, subdomains=subdomains, petsc_options={"ksp_rtol": RTOL}
    )


def all_agree(found, names):
    """Require that each solver has solved the same system."""
    agree([s.solver for s in found.results] == list(names), found)
    agree(all(s.converged and not s.note for s in found.results), found)
    for solved in found.results:
        small(solved.relative_residual, 1.01 * RTOL)
        small(solved.difference_to_direct, CONDITION * RTOL)
        agree(solved.cost.seconds_setup > 0.0 and solved.cost.seconds_solve > 0.0)
        agree(all(solved.cost.iterations >= 0 for solved in found.results))


def test_solvers_agree_on_a_linear_problem():
    """With nonzero prescribed values all solvers agree, and records and table are complete."""
    names = ("feti", "mumps", "gamg", "bddc")
    problem = linear(elasticity(cube(3, 4), stretched=True))
    found = compare(problem)
    all_agree(found, names)
    agree(found.rtol == RTOL and found.processes == COMM.size and not found.left_out)
    agree(found.subdomains == COMM.allreduce(problem.decomposition.count))
    agree(found.dofs == 3 * 5**3)
    agree(all(set(record) == KEYS for record in found.records), found.records)
    agree(json.loads(json.dumps(found.records, allow_nan=False)) == found.records)
    agree(all(name in str(found) for name in names) and "375 dofs" in str(found))
    agree(all(other == str(found) for other in COMM.allgather(str(found))))
    reference = found.results[1]
    agree(reference.solver == "mumps" and reference.difference_to_direct == 0.0)


@pytest.mark.parametrize("create", [poisson, elasticity])
def test_solvers_agree_in_the_complement_of_a_null_space(create):
    """With a null space all solvers agree, MUMPS with its zero pivots included."""
    problem = linear(create(cube(2, 8), clamped=None))
    A, b = problem.linear_system()
    b.destroy()
    A.setNullSpace(A.getNearNullSpace())
    A.setTransposeNullSpace(A.getNearNullSpace())
    all_agree(compare(problem, solvers=("feti", "mumps", "gamg")), ("feti", "mumps", "gamg"))


def test_problem_goes_on_after_a_comparison(solve_linear):
    """The comparison changes neither the solver of the problem nor its solution."""
    problem = solve_linear(elasticity(cube(3, 3)), 4, {"ksp_rtol": RTOL})
    before = problem.u.x.array.copy()
    compare(problem, ["gamg"])
    equal(problem.u.x.array, before)
    problem.solve()
    equal(problem.u.x.array, before, 1e-12)


def test_without_a_direct_solver_there_is_no_difference():
    """Without a direct solver the difference to it is None."""
    record = compare(linear(poisson(cube(2, 4)), 3), ["feti"]).records[0]
    agree(record["difference_to_direct"] is None and record["converged"])


def test_user_options_take_precedence():
    """The user's options take precedence, also on multigrid levels created at set-up."""
    problem = linear(elasticity(cube(3, 6)))
    A, b = problem.linear_system()
    K, f = assembled_system(A, b)
    for users, kind in (({}, "sor"), ({"mg_levels_pc_type": "jacobi"}, "jacobi")):
        with inserted("my_amg_", users):
            own = {"pc_type": "gamg", "mg_levels_pc_type": "sor"}
            ksp = create_solver(K, "my-amg", own, rtol=RTOL)
        agree(ksp.getPC().getMGSmoother(1).getPC().getType() == kind)
        ksp.destroy()
    for made in (K, f, b):
        made.destroy()


def test_differences_and_residuals_are_relative():
    """‖3 y − y‖/‖y‖ = 2, and ‖f − 3 K x‖/‖f‖ = 2 for f = K x."""
    problem = linear(poisson(cube(2, 4)), 3)
    A, b = problem.linear_system()
    K, x = assembled_system(A, b)
    x.set(1e6)
    f = K * x
    multiple = 3.0 * x
    small(relative_difference(multiple, x) - 2.0, 1e-12)
    small(relative_residual(K, f, multiple) - 2.0, 1e-12)
    for made in (K, f, x, multiple, b):
        made.destroy()


def test_solvers_of_ones_own():
    """A dict gives solvers their PETSc options, known solvers included."""
    own = {
        "feti": {},
        "mumps": None,
        "jacobi": {"pc_type": "jacobi"},
        "mumps-blr": {
            "pc_type": "cholesky",
            "pc_factor_mat_solver_type": "mumps",
            "mat_mumps_icntl_35": 2,
            "mat_mumps_cntl_7": 1e-6,
        },
        "bddc-deluxe": {"pc_type": "bddc", "pc_bddc_use_deluxe_scaling": True},
    }
    all_agree(compare(linear(elasticity(cube(3, 3)), 4), own), own)


def test_feti_with_other_options():
    """Options for FETI replace those of the problem, and other solvers keep theirs."""
    forms = ("primal", "dual")
    own = {"mumps": {}} | {form: {"feti_formulation": form} for form in forms}
    problem = linear(elasticity(cube(3, 3)), 4)
    all_agree(compare(problem, own), own)
    for form in forms:
        ksp = problem.create_linear_solver({"feti_formulation": form, "ksp_rtol": 0.1 * RTOL})
        ksp.setUp()
        context = ksp.getPythonContext()
        agree(context.report().formulation == form, context.report().formulation)
        small(ksp.getTolerances()[0] - 0.1 * RTOL, 1e-6 * RTOL)
        ksp.destroy()


MUMPS = "not enough memory or work space.*-mumps_mat_mumps_icntl_"


@pytest.mark.parametrize(
    ("solver", "option", "value", "note"),
    [
        ("gamg", "ksp_max_it", 1, "^failed: DIVERGED_MAX_IT$"),
        ("mumps", "mat_mumps_icntl_14", 10**8, f"{MUMPS}22 1"),  # more than any machine has
        ("mumps", "mat_mumps_icntl_23", 1, f"{MUMPS}23"),  # too low a limit
    ],
)
def test_solver_that_fails_has_a_note(solver, option, value, note):
    """A solver that fails has a note with the reason."""
    with inserted(f"{solver}_", {option: value}):
        found = compare(linear(elasticity(cube(3, 8))), [solver, "bddc"])
    failed, other = found.results
    agree(not failed.converged and re.search(note, failed.note) and other.converged, found)
    agree(np.isnan(failed.relative_residual) and found.records[0]["converged"] is False)
    agree(failed.note in str(found), str(found))


def test_options_of_feti_mixed_with_others_are_refused():
    """Another solver would run under the name of FETI."""
    own = {"tight": {"feti_pc_type": "lumped", "ksp_rtol": 1e-12}}
    with raises(ValueError, r"'tight' mixes options of FETI with others \(ksp_rtol\)"):
        compare(linear(elasticity(cube(3, 3)), 4), own)


def test_feti_that_fails_says_why():
    """If FETI fails, its note has the reason."""
    body = elasticity(cube(3, 3), clamped=None)
    found = compare(linear(body), ["feti"])
    agree(not found.results[0].converged and "singular" in found.results[0].note, found)


def test_error_of_petsc_becomes_a_note(monkeypatch):
    """An error of PETSc becomes a note of its solver, and the other solvers run."""

    def refuse(*_, **_options):
        raise PETSc.Error(56)

    monkeypatch.setattr(run, "create_solver", refuse)
    found = compare(linear(elasticity(cube(3, 3))), ["mumps", "feti"])
    mumps, feti = found.results
    agree(mumps.cost is None and mumps.note.startswith("failed: ") and feti.converged, found)
    agree("seconds_setup" not in found.records[0] and "mumps" in str(found))


def test_solver_that_petsc_lacks_is_named(monkeypatch):
    """A solver that PETSc was built without is named."""

    def lacks(solver):
        factors = solver.options.get("pc_factor_mat_solver_type")
        return "mumps" if factors == "mumps" else ""

    monkeypatch.setattr(solvers.Solver, "missing_package", lacks)
    found = compare(linear(elasticity(cube(3, 3))), ["mumps", "gamg"])
    agree([solved.solver for solved in found.results] == ["gamg"])
    agree("left out: mumps, this PETSc was built without mumps" in str(found))
    agree(found.records[1]["note"] == "left out: this PETSc was built without mumps")


def test_unsymmetric_matrix():
    """For an unsymmetric matrix FETI and GAMG use GMRES, and MUMPS uses LU."""
    body = poisson(cube(2, 6))
    u = ufl.TrialFunction(body.V)
    v = ufl.TestFunction(body.V)
    body = replace(body, a=body.a + 5.0 * u.dx(0) * v * ufl.dx)
    names = ("feti", "mumps", "gamg", "bddc")
    all_agree(compare(linear(body, 4), names), names)


@pytest.mark.parametrize("kappa", [1e2, 1e3, 1e4, 1e5])
def test_small_skew_part_beside_a_large_bulk_modulus(kappa):
    """A skew part that is small relative to ‖K‖ is detected for large κ too."""
    body = beam(tangent="full", kappa=kappa)
    body.load.value = 0.0005
    problem = body.problem(4, {"ksp_rtol": 1e-6})
    found = compare(problem, ["feti", "mumps"])
    feti, mumps = found.results
    agree(not mumps.note and mumps.relative_residual < run.REFERENCE_RTOL, found)
    agree(feti.converged and feti.relative_residual <= 1.01e-6, found)
    small(feti.difference_to_direct, 1e-4)


@pytest.mark.parametrize(
    ("limit", "note"),
    [
        (run.REFERENCE_RTOL, "by LU, as Cholesky leaves a residual of"),
        (0.0, "; no reference: the residual is above"),
    ],
)
def test_reference_is_held_to_its_residual(monkeypatch, limit, note):
    """If Cholesky's residual is too large LU is tried, or else there is no reference."""
    monkeypatch.setattr(solvers, "is_symmetric", lambda _A: True)
    monkeypatch.setattr(run, "REFERENCE_RTOL", limit)
    body = beam(tangent="full", kappa=1e4)
    body.load.value = 0.0005
    found = compare(body.problem(4, {"ksp_rtol": 1e-6}), ["feti", "mumps"])
    feti, mumps = found.results
    agree(note in mumps.note and note in str(found), found)
    small(mumps.relative_residual, 1e-6)
    agree(np.isfinite(feti.difference_to_direct) == (limit > 0.0), found)


@pytest.mark.parametrize(
    ("names", "kind", "match"),
    [
        (["feti", "umfpack"], ValueError, "solvers has 'umfpack': choose from feti, mumps, gamg, "),
        ({"feti": {}, "mine": {}}, ValueError, "solvers has 'mine': .* give a dict of names"),
        ([], ValueError, "solvers is empty: choose from"),
        ("mumps", TypeError, "solvers is 'mumps': give Sequence"),
        (None, ValueError, "give the same on all"),
    ],
)
def test_wrong_solvers(names, kind, match):
    """Unknown solvers, and solvers that differ between processes, are refused."""
    if names is None:
        names = ["feti"] if COMM.rank == 0 else ["feti", "mumps"]
        if COMM.size == 1:
            pytest.skip("one process agrees with itself")
    with raises(kind, match):
        compare(linear(poisson(cube(2, 4)), 3), names)


def test_problems_of_other_types_are_refused():
    """Problems of other types, and with zero load, are refused."""
    with raises(TypeError, "problem is .*: give .*LinearProblem"):
        compare(poisson(cube(2, 4)))
    with raises(ValueError, "right-hand side of the problem is zero"):
        compare(wall(tube(around=6, along=1), degree=1).problem(3, {}))


# -- what compare is made of: the assembled system, a direct solver, time and memory

SEED = 8363
MIB = 2**20
#: What a process may allocate beside what is asked for [MiB].
NOISE = 4.0


def skew(K, _dofs):
    """Make the local matrices unsymmetric."""
    for K_i in K:
        n = len(K_i) // 2
        K_i[:n, n:] *= 1.1
        K_i[n:, :n] *= 0.9


@pytest.mark.parametrize("held", [True, False])
@pytest.mark.parametrize("components", [1, 2])
def test_assembled_system_has_unit_rows_on_dirichlet_dofs(torn_grid, components, held):
    """Dirichlet dofs have unit rows and columns, with values moved to the right; A is unchanged."""
    free = {} if held else {"fixed": lambda x: np.zeros(len(x), dtype=bool)}
    problem = torn_grid((2, 2), (2, 3), components=components, **free)
    b = np.random.default_rng(SEED).standard_normal(len(problem.dirichlet))
    vector = problem.vector(b)
    K, f = assembled_system(problem.A, vector)
    fixed = problem.dirichlet
    A = problem.T.T @ problem.K_torn @ problem.T
    expected = np.where(fixed[:, None] | fixed[None, :], np.eye(len(b)), A)
    equal(dense(K), expected, 1e-13)
    equal(dense(problem.A.convert("aij", PETSc.Mat())), A, 1e-13)
    equal(whole(f.array_r), np.where(fixed, b, b - A[:, fixed] @ b[fixed]), 1e-13)
    equal(whole(vector.array_r), b)
    x = problem.solve(b) if held else np.zeros(len(b))
    small(relative_residual(K, f, problem.vector(x)) - (0.0 if held else 1.0), 1e-11)
    agree(K.isSymmetricKnown() == (True, True) and K.getBlockSize() == components)
    modes, kept = (M.getNearNullSpace().getVecs() for M in (problem.A, K))
    agree(len(kept) == len(modes) == (1 if components == 1 else 3))
    for mode, same in zip(modes, kept, strict=True):
        equal(same.array_r, mode.array_r)
    for made in (K, f, vector):
        made.destroy()


@pytest.mark.parametrize("symmetric", [True, False])
def test_mumps_uses_cholesky_or_lu_by_symmetry(torn_grid, symmetric):
    """MUMPS uses Cholesky or LU by the detected symmetry, and receives its options."""
    problem = torn_grid((2, 2), (2, 2), components=2, change=None if symmetric else skew)
    b = np.random.default_rng(SEED + 1).standard_normal(len(problem.dirichlet))
    K, f = assembled_system(problem.A, problem.vector(b))
    with inserted("mumps_", {"mat_mumps_icntl_7": 5, "mat_mumps_icntl_14": 77}):
        ksp = create_solver(K)
    agree(ksp.getPC().getType() == ("cholesky" if symmetric else "lu"))
    factor = ksp.getPC().getFactorMatrix()
    agree((factor.getMumpsIcntl(7), factor.getMumpsIcntl(14)) == (5, 77))
    x = f.duplicate()
    ksp.solve(f, x)
    equal(whole(x.array_r), problem.solve(b), 1e-10)
    for made in (ksp, K, f, x):
        made.destroy()


def test_measure_tells_set_up_from_solution(torn_grid):
    """Set-up and solution are timed apart on all processes, and the solver is freed."""

    class Slow:
        def setUp(self, pc):
            time.sleep(0.2)

        def apply(self, pc, b, x):
            time.sleep(0.05)
            b.copy(x)

    problem = torn_grid((2, 2), (2, 2))
    made = []

    def create():
        ksp = PETSc.KSP().create(COMM)
        ksp.setOperators(K)
        ksp.setType("cg")
        ksp.setTolerances(rtol=1e-30, atol=1e-300, max_it=3)
        ksp.getPC().setType("python")
        ksp.getPC().setPythonContext(Slow())
        made.append(ksp)
        return ksp

    b = problem.vector(np.ones(len(problem.dirichlet)))
    K, f = assembled_system(problem.A, b)
    taken, x = measure(create, f)
    agree(0.2 <= taken.seconds_setup < 10 and 0.15 <= taken.seconds_solve < 10, taken)
    too_many = PETSc.KSP.ConvergedReason.DIVERGED_MAX_IT
    agree((taken.iterations, taken.converged_reason) == (3, too_many), taken)
    agree(not made[0].handle)
    for owned_here in (K, f, b, x):
        owned_here.destroy()


def test_timed_solver_is_kept(torn_grid):
    """A timed solver is the caller's, and a second solve reuses its factor."""
    problem = torn_grid((3, 2), (2, 2))
    K, f = assembled_system(problem.A, problem.vector(np.ones(len(problem.dirichlet))))
    x = f.duplicate()
    first, ksp = timed_solve(lambda: create_solver(K), f, x)
    small(relative_residual(K, f, x), 1e-12)
    factor = ksp.getPC().getFactorMatrix().handle
    x.set(0.0)
    second, same = timed_solve(lambda: ksp, f, x)
    agree(same is ksp and ksp.getPC().getFactorMatrix().handle == factor)
    agree(first.iterations == second.iterations == 1 and second.converged_reason > 0)
    small(relative_residual(K, f, x), 1e-12)
    for owned_here in (ksp, K, f, x):
        owned_here.destroy()


def test_peak_counts_what_was_given_back():
    """Peak memory includes freed memory, is summed over processes, and restarts each time."""
    if not all(COMM.allgather(math.isfinite(PeakMemory().mib_above_start(COMM)))):
        pytest.skip("/proc/self has no peak")
    everybody = range(COMM.size)
    last = [COMM.size - 1]
    for mib, ranks in ((48, everybody), (24, last), (0, [])):
        peak = PeakMemory()
        if COMM.rank in ranks:
            with mmap.mmap(-1, mib * MIB) as block:  # free() may keep what it is given
                block[:: mmap.PAGESIZE] = b"1" * (len(block) // mmap.PAGESIZE)
        small(peak.mib_above_start(COMM) - mib * len(ranks), NOISE * COMM.size)
        agree(peak.mib(COMM) > mib * len(ranks) + 10 * COMM.size, "so much takes an interpreter")


@pytest.mark.parametrize("is_known", [False, True])
def test_peak_where_the_mark_stays(monkeypatch, tmp_path, is_known):
    """If the peak cannot be reset, only that of the whole run may be known."""
    if COMM.rank == 0 and is_known:
        (tmp_path / "clear_refs").mkdir()
        (tmp_path / "status").write_text("Name:\tpython3\nVmHWM:\t 2048 kB\nVmRSS:\t 1024 kB\n")
    COMM.Barrier()
    monkeypatch.setattr(cost, "PROC", tmp_path)
    peak = PeakMemory()
    if is_known:
        agree(peak.mib(COMM) == 2.0 * COMM.size)
    else:
        agree(math.isnan(peak.mib(COMM)))
    agree(math.isnan(peak.mib_above_start(COMM)))
