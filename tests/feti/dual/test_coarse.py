# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The coarse matrix and the projection against dense formulas."""

from __future__ import annotations

import contextlib

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest
from collective import COMM, agree, dense, equal, matrix_of_map, norm, raises, small, whole
from modes import modes_of

from dolfinx_feti.errors import SetUpError
from dolfinx_feti.feti.coarse.gathered import GatheredSolver
from dolfinx_feti.feti.coarse.whole import whole_factor
from dolfinx_feti.feti.subdomain.factors.multifrontal import FrontFactor, Fronts
from dolfinx_feti.runtime.collective import raise_deferred
from dolfinx_feti.runtime.petsc_options import inserted

SEED = 33107

CHANGES = {
    "no prestress": None,
    "prestress": lambda K, dofs: [np.fill_diagonal(k, 1.02 * k.diagonal()) for k in K],
}
every_change = pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
every_q = pytest.mark.parametrize("q", ["identity", "diagonal", "preconditioner"])
every_type = pytest.mark.parametrize("kind", ["all_floating", "classical"])


def weight(problem, system, q):
    """Q of the definition."""
    B_D = dense(system.preconditioner.B_D.matrix)
    if q == "identity":
        return np.eye(len(B_D))
    Q = np.diag(B_D**2 @ np.diag(problem.K_torn))
    if q == "diagonal":
        return Q
    M = matrix_of_map(lambda r: system.preconditioner.apply(r)[0], system.dual.m)
    return M + 0.01 * Q


@every_type
@every_q
@every_change
def test_projection(kind, q, change, torn_grid, parts):
    """G = B E, N = GᵀQG + D; for D = 0, P² = P, GᵀP = 0, and P leaves balanced λ alone."""
    problem = torn_grid((2, 2), (2, 2), components=2, change=change)
    system = parts(problem.A, type=kind, coarse_q=q)
    coarse, B = system.coarse, dense(system.pattern.gluing.B)
    E = np.zeros((system.torn.n, coarse.total))
    column = coarse.start
    for dofs, E_i in zip(system.operator.dofs, modes_of(system).E, strict=True):
        E[dofs, column : column + E_i.shape[1]] = E_i
        column += E_i.shape[1]
    G, N, D = (dense(M) for M in (coarse.G, coarse.N, coarse.D))
    QG = matrix_of_map(system.dual.weighted_jump, coarse.size)
    equal(G, B @ whole(E), 1e-13)
    equal(QG, weight(problem, system, q) @ G, 1e-11)
    equal(N, G.T @ QG + D, 1e-12)
    equal(N, N.T, 1e-12)
    if change is None:
        equal(D, np.zeros_like(N))
        P = np.eye(len(G)) - QG @ np.linalg.solve(N, G.T)
        equal(P @ P, P, 1e-10)
        small(np.abs(G.T @ P).max(), 1e-10)
        balanced = P @ np.random.default_rng(SEED).standard_normal(len(P))
        equal(P @ balanced, balanced, 1e-10)
        agree(np.linalg.eigvalsh(N)[0] > 0.0)
    else:
        agree(np.abs(D).max() > 0.0)


@every_q
@every_change
def test_start_is_balanced(q, change, torn_grid, parts):
    """Gᵀλ₀ + D s₀ = e for s₀ = N⁻¹e, λ₀ = Q G s₀, with e = Eᵀ f."""
    problem = torn_grid((3, 2), (2, 2), components=2, change=change)
    system = parts(problem.A, coarse_q=q)
    coarse = system.coarse
    f = np.random.default_rng(SEED + COMM.rank).standard_normal(system.torn.n)
    e = coarse.restrict(f)
    expected = [
        E.T @ f[dofs] for E, dofs in zip(modes_of(system).E, system.operator.dofs, strict=True)
    ]
    equal(e, np.concatenate([*expected, np.zeros(0)]), 1e-13)
    s = coarse.solve(e)
    lam = system.dual.weighted_jump(s)
    G, D = dense(coarse.G), dense(coarse.D)
    equal(G.T @ whole(lam) + D @ whole(s), whole(e), 1e-10)


def test_prolongation_is_the_transpose_of_the_restriction(torn_grid, parts):
    problem = torn_grid((2, 2), (2, 2), components=2)
    coarse = parts(problem.A, type="classical").coarse
    rng = np.random.default_rng(SEED + 1)
    s = rng.standard_normal(coarse.total)[slice(*coarse.N.getOwnershipRange())]
    f = rng.standard_normal(len(problem.to_global))
    n = COMM.scan(len(coarse.prolong(s)))
    mine = f[n - len(coarse.prolong(s)) : n]
    left = COMM.allreduce(float(coarse.prolong(s) @ mine))
    right = COMM.allreduce(float(coarse.restrict(mine) @ s))
    agree(abs(left - right) < 1e-12 * norm(mine) * norm(s), (left, right))


def test_coarse_matrix_couples_neighbours_only(torn_grid, parts):
    """In a row of subdomains N is block tridiagonal for Q = I, wider by one for Q = M."""
    problem = torn_grid((8,), (3,))
    for q, width in (("identity", 1), ("diagonal", 1), ("preconditioner", 3)):
        N = parts(problem.A, coarse_q=q).coarse.N
        rows, columns = np.nonzero(dense(N))
        agree(np.abs(rows - columns).max() <= width, q)
        agree(N.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"] <= 8 * (2 * width + 1))


@pytest.mark.processes(1, 2, 3, 4, 8)
@pytest.mark.parametrize("rows", [1, 3, 4000])
@pytest.mark.parametrize("symmetric", [True, False])
def test_gathered_solver_on_any_number_of_processes(rows, symmetric, distributed, monkeypatch):
    """A distributed tridiagonal system with about ``rows`` rows on a process."""
    monkeypatch.setattr("dolfinx_feti.feti.coarse.group.ROWS", rows)
    n = 7
    A = 3.0 * np.eye(n) - np.eye(n, k=1) - (1.0 if symmetric else 0.3) * np.eye(n, k=-1)
    N = distributed(A)
    solver = GatheredSolver(N, prefix="test_coarse_", symmetric=symmetric)
    active = min(COMM.size, -(-n // rows))
    agree(active <= solver.factor.ksp.comm.size < 2 * active)
    for seed in (1, 2):
        found, expected = solved(solver, N, A, seed)
        equal(found, expected, 1e-13)
    agree(solver.pivots() == ((0, 0) if symmetric else (None, 0)))
    agree(solver.memory() >= 0.0)
    solver.destroy()


@pytest.mark.processes(1, 2, 3, 4, 8)
@pytest.mark.parametrize("spread", [0, 128], ids=["factor", "inverse"])
@pytest.mark.parametrize("kind", ["definite", "one block", "singular", "indefinite", "large"])
def test_whole_factor_where_it_will_do(kind, spread, distributed, monkeypatch):
    """Blocks of subdomains, some of which have none; MUMPS factors what is not definite."""
    monkeypatch.setattr("dolfinx_feti.feti.coarse.gathered.SPREAD", spread)
    monkeypatch.setattr("dolfinx_feti.feti.coarse.whole.MOST", 10 if kind == "large" else 2**25)
    sizes = [np.array([2, 0, 3, 1]) if kind != "one block" else np.array([0, 3])] * COMM.size
    subdomain = np.repeat(np.arange(len(np.concatenate(sizes))), np.concatenate(sizes))
    n = len(subdomain)
    A = random_definite(n)
    if kind != "one block":
        A[np.abs(subdomain[:, None] - subdomain) > 3] = 0.0  # of a strip
    A += n * np.eye(n)
    if kind == "singular":
        A[1], A[:, 1] = A[0], A[:, 0]
        A[1, 1] = A[0, 0]
    if kind == "indefinite":
        A[0, 0] *= -1.0
    N = distributed(A, len(subdomain) // COMM.size)
    how = {"prefix": "test_coarse_", "symmetric": True, "zero": 1e-8}
    solver = GatheredSolver(N, counts=sizes[COMM.rank], **how)
    whole_one = kind in ("definite", "one block")
    agree(isinstance(solver.factor, FrontFactor) == whole_one)
    agree((solver.inverse is not None) == (whole_one and spread > 0), kind)
    if solver.inverse is not None:
        equal(solver.inverse, np.linalg.inv(A)[slice(*N.getOwnershipRange())], 1e-14)
    agree("inverse" in str(solver) or solver.inverse is None)
    expected = {"singular": (0, 1), "indefinite": (1, 0)}.get(kind, (0, 0))
    agree(solver.pivots() == expected, (kind, solver.pivots(), expected))
    agree(solver.memory() > 0.0 or not whole_one)
    found, solution = solved(solver, N, A)
    equal(A @ found, A @ solution, 1e-12)
    solver.destroy()


def test_options_name_a_solver_in_place_of_the_whole_factor(distributed):
    N = distributed(random_definite(3 * COMM.size), 3)
    for option in ({"ksp_type": "cg"}, {"pc_type": "lu"}, {"pc_factor_mat_solver_type": "petsc"}):
        with inserted("test_coarse_", option):
            how = {"prefix": "test_coarse_", "zero": None}
            agree(whole_factor(N, np.array([3]), MPI.COMM_SELF, **how) is None)


@pytest.mark.processes(1, 2, 3, 4, 8)
@pytest.mark.parametrize("nodes", [1, 2, 3])
def test_a_node_solves_with_one_factor_and_fails_with_it(nodes, distributed, monkeypatch):
    """Nodes whose processes are not consecutive; all are of the machine that runs this."""
    monkeypatch.setattr("dolfinx_feti.feti.coarse.gathered.SPREAD", 0)
    if nodes > 1:
        split = "dolfinx_feti.feti.coarse.gathered.processes_of_node"
        monkeypatch.setattr(split, lambda comm: comm.Split(comm.rank % nodes, comm.rank))
    A = random_definite(3 * COMM.size)
    N = distributed(A, 3)
    solver = GatheredSolver(N, prefix="test_coarse_", symmetric=True, counts=np.array([1, 2]))
    factors = COMM.allreduce(len(solver.factor.values) > 0)
    agree(factors == min(nodes, COMM.size), factors)
    agree(solver.memory() > 0.0 and solver.inverse is None)
    found, expected = solved(solver, N, A)
    equal(found, expected, 1e-12)
    monkeypatch.setattr(FrontFactor, "solve", lambda *_: 1 / 0)
    agree(bool(np.isnan(solved(solver, N, A)[0]).all()))
    with contextlib.suppress(ZeroDivisionError):
        raise_deferred()
    solver.destroy()


@pytest.mark.parametrize(("shift", "inertia"), [(0.0, (0, 1)), (-1.5, (3, 0)), (-10.0, (7, 0))])
def test_gathered_solver_reports_inertia(shift, inertia, distributed):
    """Neumann's tridiagonal matrix: singular, and indefinite when it is shifted."""
    n = 7
    A = 2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1) + shift * np.eye(n)
    A[0, 0] = A[-1, -1] = 1.0 + shift
    negative = np.count_nonzero(np.linalg.eigvalsh(A) < -1e-10)
    agree(negative == inertia[0])
    solver = GatheredSolver(distributed(A), prefix="test_coarse_", symmetric=True)
    agree(solver.pivots() == inertia, solver.pivots())
    solver.destroy()


@pytest.mark.parametrize("κ", [1e6, 1e14])
def test_inverse_serves_if_it_is_accurate(κ, distributed):
    """A nearly singular matrix is solved with its factor, which rounding harms less."""
    A = np.diag(κ ** (-np.arange(8) / 7))
    N = distributed(A)
    own = np.array([N.getLocalSize()[0]])
    solver = GatheredSolver(N, prefix="test_coarse_", symmetric=True, counts=own)
    agree((solver.inverse is not None) == (κ < 1e10))
    found, expected = solved(solver, N, A)
    small(np.abs(found / expected - 1.0).max(), 1e-14)
    solver.destroy()


@pytest.mark.processes(1, 2, 3, 4, 8)
def test_no_kernel_at_all(torn_grid, parts):
    """All subdomains touch the Dirichlet boundary: the coarse problem is empty."""
    problem = torn_grid((1, 4), (2, 2), components=2)
    system = parts(problem.A, type="classical")
    agree(system.coarse.total == 0)
    agree(system.coarse.solve(np.zeros(0)).shape == (0,))
    agree(system.coarse.solver.pivots() == (0, 0))


# ---- failures -------------------------------------------------------------------------------


@pytest.fixture
def distributed():
    """Distribute a dense matrix by rows."""
    made = []

    def create(A, own=None):
        N = PETSc.Mat().createAIJ(((own, len(A)), (own, len(A))), comm=COMM)
        N.setUp()
        for i in range(*N.getOwnershipRange()):
            N.setValues(i, range(len(A)), A[i])
        N.assemble()
        made.append(N)
        return N

    yield create
    for N in made:
        N.destroy()


def solved(solver, N, A, seed=SEED):
    """Solve for a random solution; return what is found of it, and itself."""
    expected = np.random.default_rng(seed).standard_normal(len(A))
    b, x = N.createVecs()
    b.array[:] = (A @ expected)[slice(*b.getOwnershipRange())]
    solver.solve(b, x)
    found = whole(x.array_r)
    b.destroy()
    x.destroy()
    return found, expected


def random_definite(n):
    X = np.random.default_rng(SEED).standard_normal((n, n))
    return X @ X.T + n * np.eye(n)


@pytest.mark.processes(1, 2, 3, 4, 8)
@pytest.mark.parametrize("rows", [20, 4000])
def test_not_enough_work_space(rows, distributed, monkeypatch):
    """The first try fails for real, on all processes alike, and the second one succeeds."""
    monkeypatch.setattr("dolfinx_feti.feti.coarse.group.ROWS", rows)
    monkeypatch.setattr("dolfinx_feti.feti.subdomain.factors.direct.WORK_SPACE", (-99,))
    A = random_definite(60)
    N = distributed(A)
    with raises(SetUpError, r"not enough memory or work space .*INFOG\(1\) = -\d+.*-test_coarse_"):
        GatheredSolver(N, prefix="test_coarse_", symmetric=True)
    monkeypatch.setattr("dolfinx_feti.feti.subdomain.factors.direct.WORK_SPACE", (-99, 50))
    solver = GatheredSolver(N, prefix="test_coarse_", symmetric=True)
    found, expected = solved(solver, N, A)
    equal(found, expected, 1e-12)
    solver.destroy()


@pytest.mark.processes(1, 2, 3, 4, 8)
@pytest.mark.parametrize("step", [(Fronts, "factor"), (FrontFactor, "solve")])
def test_no_memory_on_one_process(step, distributed, monkeypatch):
    """Each process has a factor of its own; all of them raise, and none waits."""
    work = getattr(*step)

    def fail(*args, **how):
        if COMM.rank == COMM.size - 1:
            raise MemoryError("no room")
        return work(*args, **how)

    monkeypatch.setattr(*step, fail)
    N = distributed(random_definite(3 * COMM.size), 3)
    with raises(SetUpError, "coarse problem could not be factored .no room"):
        GatheredSolver(N, prefix="test_coarse_", symmetric=True, counts=np.array([3]))


@pytest.mark.processes(1, 2, 3, 4, 8)
@pytest.mark.parametrize(
    "options", [{"ksp_type": "nonsense"}, {"pc_type": "no"}, {"pc_factor_mat_solver_type": "no"}]
)
def test_wrong_options_are_an_error_on_all_processes(options, distributed):
    """Each group of processes has its own solver; all of them raise."""
    with (
        inserted("test_coarse_", options),
        raises(SetUpError, "coarse problem could not be factored .*-test_coarse_"),
    ):
        GatheredSolver(distributed(random_definite(5)), prefix="test_coarse_", symmetric=True)


@pytest.mark.parametrize("options", [{"ksp_type": "nonsense"}, {"pc_type": "no"}])
def test_wrong_options_of_the_coarse_solver(options, torn_grid, feti):
    ksp = feti(
        torn_grid((3, 2), (2, 2), components=2).A,
        **{f"feti_coarse_{key}": value for key, value in options.items()},
    )
    context = ksp.getPythonContext()
    agree("coarse problem could not be factored" in context.message, context.message)


@pytest.mark.processes(1, 2, 3, 4, 8)
def test_failed_solve_is_no_number(distributed):
    """Where the coarse solver diverges, all processes learn it from the solution."""
    with inserted("test_coarse_", {"ksp_type": "cg", "pc_type": "none", "ksp_max_it": 1}):
        A = random_definite(30)
        N = distributed(A)
        solver = GatheredSolver(N, prefix="test_coarse_", symmetric=True)
        agree(np.isnan(solved(solver, N, A)[0]).all())
    solver.destroy()


def test_coarse_solver_that_does_not_solve(torn_grid, feti):
    """Too rough a solver is found out before the first iteration."""
    problem = torn_grid((3, 2), (2, 2), components=2)
    for options in ({"ksp_max_it": 1}, {"ksp_rtol": 1e-2}):
        choice = {"ksp_type": "cg", "pc_type": "none", **options}
        ksp = feti(problem.A, **{f"feti_coarse_{key}": value for key, value in choice.items()})
        context = ksp.getPythonContext()
        agree("coarse solver leaves a backward error" in context.message, context.message)
        agree(not context.singular)


def test_memory_is_in_mebibytes_or_not_known(distributed):
    N = distributed(random_definite(60))
    solver = GatheredSolver(N, prefix="test_coarse_", symmetric=True)
    millions = COMM.bcast(solver.factor.ksp.getPC().getFactorMatrix().getMumpsInfog(22))
    small(solver.memory() - millions / 1.048576, 1e-9 * max(millions, 1))
    solver.destroy()
    own = np.array([60 // COMM.size + (COMM.rank < 60 % COMM.size)])
    solver = GatheredSolver(N, prefix="test_coarse_", symmetric=True, counts=own)
    stored = COMM.allreduce(solver.inverse.nbytes)
    agree(stored == 8 * 60**2, stored)
    small(solver.memory() - solver.factor.memory() - stored / 2**20, 1e-9)
    solver.destroy()
    with inserted("test_coarse_", {"ksp_type": "cg", "pc_type": "jacobi"}):
        solver = GatheredSolver(N, prefix="test_coarse_", symmetric=True)
    agree(solver.memory() is None and solver.pivots() == (None, None))
    solver.destroy()
