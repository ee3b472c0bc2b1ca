# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The coarse matrix and the projection against dense formulas; the solver, and its failures."""

import contextlib

from petsc4py import PETSc

import numpy as np
import pytest
from cases import each, every_type
from collective import COMM, agree, dense, equal, matrix_of_map, raises, small, whole
from hand_torn import scaled_diagonal
from modes import modes_of, on_torn_dofs

from dolfinx_feti.errors import SetUpError
from dolfinx_feti.feti.coarse.gathered import GatheredSolver
from dolfinx_feti.feti.coarse.group import GroupFactor
from dolfinx_feti.feti.subdomain.factors.multifrontal import FrontFactor, Fronts
from dolfinx_feti.runtime.collective import raise_deferred
from dolfinx_feti.runtime.petsc_options import inserted

SEED = 33107
PREFIX = "test_coarse_"
ROWS = "dolfinx_feti.feti.coarse.group.ROWS"
WORK_SPACE = "dolfinx_feti.feti.subdomain.factors.direct.WORK_SPACE"

every_q = pytest.mark.parametrize("q", ["identity", "diagonal", "preconditioner"])
any_number = pytest.mark.processes(1, 2, 3, 4, 8)


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
@each("change", {"no prestress": None, "prestress": scaled_diagonal(1.02)})
def test_projection(kind, q, change, torn_grid, parts):
    """G = B E, N = GᵀQG + D; P² = P and GᵀP = 0 for D = 0; s₀ = N⁻¹ Eᵀf, Gᵀ Q G s₀ + D s₀ = Eᵀf."""
    problem = torn_grid((3, 2), (2, 2), components=2, change=change)
    system = parts(problem.A, type=kind, coarse_q=q)
    coarse, B, n = system.coarse, dense(system.pattern.gluing.B), system.torn.n
    E = on_torn_dofs(system, modes_of(system).E)
    G, N, D = (dense(M) for M in (coarse.G, coarse.N, coarse.D))
    QG = matrix_of_map(system.dual.weighted_jump, coarse.size)
    equal(G, B @ E, 1e-13)
    equal(QG, weight(problem, system, q) @ G, 1e-11)
    equal(N, G.T @ QG + D, 1e-12)
    equal(N, N.T, 1e-12)
    f = np.random.default_rng(SEED + COMM.rank).standard_normal(n)
    e = coarse.restrict(f)
    equal(whole(e), E.T @ whole(f), 1e-13)
    s = coarse.solve(e)
    equal(whole(coarse.prolong(s)), E @ whole(s), 1e-12)
    equal(G.T @ whole(system.dual.weighted_jump(s)) + D @ whole(s), whole(e), 1e-10)
    if change is None:
        equal(D, np.zeros_like(N))
        P = np.eye(len(G)) - QG @ np.linalg.solve(N, G.T)
        equal(P @ P, P, 1e-10)
        small(np.abs(G.T @ P).max(), 1e-10)
        agree(np.linalg.eigvalsh(N)[0] > 0.0)
    else:
        agree(np.abs(D).max() > 0.0)


def test_coarse_matrix_couples_neighbours_only(torn_grid, parts):
    """In a row of subdomains N is block tridiagonal for Q = I, wider by one for Q = M."""
    problem = torn_grid((8,), (3,))
    for q, width in (("identity", 1), ("diagonal", 1), ("preconditioner", 3)):
        N = parts(problem.A, coarse_q=q).coarse.N
        rows, columns = np.nonzero(dense(N))
        agree(np.abs(rows - columns).max() <= width, q)
        agree(N.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"] <= 8 * (2 * width + 1))


@any_number
def test_no_kernel_at_all(torn_grid, parts):
    """All subdomains touch the Dirichlet boundary: the coarse problem is empty."""
    coarse = parts(torn_grid((1, 4), (2, 2), components=2).A, type="classical").coarse
    agree(coarse.total == 0 and coarse.solve(np.zeros(0)).shape == (0,))
    agree(coarse.solver.pivots() == (0, 0))


# ---- the solver -----------------------------------------------------------------------------


@pytest.fixture
def gathered(lifetime):
    """Distribute a matrix by rows and factor it; return the solver, and a random test solve."""

    def create(A, own=None, **how):
        N = lifetime.own(PETSc.Mat().createAIJ(((own, len(A)), (own, len(A))), comm=COMM))
        N.setUp()
        for i in range(*N.getOwnershipRange()):
            N.setValues(i, range(len(A)), A[i])
        N.assemble()
        given = {"prefix": PREFIX, "symmetric": True, **how}
        solver = lifetime.own(GatheredSolver(N, **given))

        def solved(seed=SEED):
            """Return what is found of a random solution, and itself."""
            expected = np.random.default_rng(seed).standard_normal(len(A))
            b, x = map(lifetime.own, N.createVecs())
            b.array[:] = (A @ expected)[slice(*b.getOwnershipRange())]
            solver.solve(b, x)
            return whole(x.array_r), expected

        return solver, solved

    return create


def random_definite(n):
    X = np.random.default_rng(SEED).standard_normal((n, n))
    return X @ X.T + n * np.eye(n)


def tridiagonal(n, *, lower=-1.0, diagonal=3.0):
    return diagonal * np.eye(n) - np.eye(n, k=1) + lower * np.eye(n, k=-1)


@any_number
@pytest.mark.parametrize("rows", [1, 3, 4000])
@pytest.mark.parametrize("symmetric", [True, False])
def test_gathered_solver_on_any_number_of_processes(rows, symmetric, gathered, monkeypatch):
    """A distributed tridiagonal system with about ``rows`` rows on a process."""
    monkeypatch.setattr(ROWS, rows)
    n = 7
    A = tridiagonal(n, lower=-1.0 if symmetric else -0.3)
    solver, solved = gathered(A, symmetric=symmetric)
    active = min(COMM.size, -(-n // rows))
    agree(active <= solver.factor.ksp.comm.size < 2 * active)
    for seed in (1, 2):
        equal(*solved(seed), 1e-13)
    agree(solver.pivots() == ((0, 0) if symmetric else (None, 0)))
    agree(solver.memory() >= 0.0)


@any_number
@pytest.mark.parametrize("spread", [0, 128], ids=["factor", "inverse"])
@pytest.mark.parametrize("kind", ["definite", "one block", "singular", "indefinite", "large"])
def test_whole_factor_where_it_will_do(kind, spread, gathered, monkeypatch):
    """Blocks of subdomains, some of which have none; MUMPS factors what is not definite."""
    monkeypatch.setattr("dolfinx_feti.feti.coarse.gathered.SPREAD", spread)
    monkeypatch.setattr("dolfinx_feti.feti.coarse.gathered.MOST", 10 if kind == "large" else 2**25)
    sizes = np.array([2, 0, 3, 1] if kind != "one block" else [0, 3])
    subdomain = np.repeat(np.arange(len(sizes) * COMM.size), np.tile(sizes, COMM.size))
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
    solver, solved = gathered(A, n // COMM.size, zero=1e-8, counts=sizes)
    whole_one = kind in ("definite", "one block")
    agree(isinstance(solver.factor, FrontFactor) == whole_one)
    agree((solver.inverse is not None) == (whole_one and spread > 0), kind)
    if solver.inverse is not None:
        own = slice(n // COMM.size * COMM.rank, n // COMM.size * (COMM.rank + 1))
        equal(solver.inverse, np.linalg.inv(A)[own], 1e-14)
    agree("inverse" in str(solver) or solver.inverse is None)
    expected = {"singular": (0, 1), "indefinite": (1, 0)}.get(kind, (0, 0))
    agree(solver.pivots() == expected, (kind, solver.pivots(), expected))
    agree(solver.memory() > 0.0 or not whole_one)
    found, solution = solved()
    equal(A @ found, A @ solution, 1e-12)


def test_options_name_a_solver_in_place_of_the_whole_factor(gathered):
    for option in ({"ksp_type": "cg"}, {"pc_type": "lu"}, {"pc_factor_mat_solver_type": "petsc"}):
        with inserted(PREFIX, option):
            solver, _ = gathered(random_definite(3 * COMM.size), 3, counts=np.array([3]))
            agree(isinstance(solver.factor, GroupFactor))


@any_number
@pytest.mark.parametrize("nodes", [1, 2, 3])
def test_a_node_solves_with_one_factor_and_fails_with_it(nodes, gathered, monkeypatch):
    """Nodes whose processes are not consecutive; all are of the machine that runs this."""
    monkeypatch.setattr("dolfinx_feti.feti.coarse.gathered.SPREAD", 0)
    if nodes > 1:
        split = "dolfinx_feti.feti.coarse.gathered.processes_of_node"
        monkeypatch.setattr(split, lambda comm: comm.Split(comm.rank % nodes, comm.rank))
    solver, solved = gathered(random_definite(3 * COMM.size), 3, counts=np.array([1, 2]))
    factors = COMM.allreduce(len(solver.factor.values) > 0)
    agree(factors == min(nodes, COMM.size), factors)
    agree(solver.memory() > 0.0 and solver.inverse is None)
    equal(*solved(), 1e-12)
    monkeypatch.setattr(FrontFactor, "solve", lambda *_: 1 / 0)
    agree(bool(np.isnan(solved()[0]).all()))
    with contextlib.suppress(ZeroDivisionError):
        raise_deferred()


@pytest.mark.parametrize(("shift", "inertia"), [(0.0, (0, 1)), (-1.5, (3, 0)), (-10.0, (7, 0))])
def test_gathered_solver_reports_inertia(shift, inertia, gathered):
    """Neumann's tridiagonal matrix: singular, and indefinite when it is shifted."""
    A = tridiagonal(7, diagonal=2.0 + shift)
    A[0, 0] = A[-1, -1] = 1.0 + shift
    agree(np.count_nonzero(np.linalg.eigvalsh(A) < -1e-10) == inertia[0])
    solver, _ = gathered(A)
    agree(solver.pivots() == inertia, solver.pivots())


@pytest.mark.parametrize("κ", [1e6, 1e14])
def test_inverse_serves_if_it_is_accurate(κ, gathered):
    """A nearly singular matrix is solved with its factor, which rounding harms less."""
    own = 8 // COMM.size + (COMM.rank < 8 % COMM.size)
    solver, solved = gathered(np.diag(κ ** (-np.arange(8) / 7)), own, counts=np.array([own]))
    agree((solver.inverse is not None) == (κ < 1e10))
    found, expected = solved()
    small(np.abs(found / expected - 1.0).max(), 1e-14)


def test_memory_is_in_mebibytes_or_not_known(gathered):
    A = random_definite(60)
    solver, _ = gathered(A)
    millions = COMM.bcast(solver.factor.ksp.getPC().getFactorMatrix().getMumpsInfog(22))
    small(solver.memory() - millions / 1.048576, 1e-9 * max(millions, 1))
    own = 60 // COMM.size + (COMM.rank < 60 % COMM.size)
    solver, _ = gathered(A, own, counts=np.array([own]))
    stored = COMM.allreduce(solver.inverse.nbytes)
    agree(stored == 8 * 60**2, stored)
    small(solver.memory() - solver.factor.memory() - stored / 2**20, 1e-9)
    with inserted(PREFIX, {"ksp_type": "cg", "pc_type": "jacobi"}):
        solver, _ = gathered(A)
    agree(solver.memory() is None and solver.pivots() == (None, None))


# ---- failures -------------------------------------------------------------------------------


@any_number
@pytest.mark.parametrize("rows", [20, 4000])
def test_not_enough_work_space(rows, gathered, monkeypatch):
    """The first try fails for real, on all processes alike, and the second one succeeds."""
    monkeypatch.setattr(ROWS, rows)
    monkeypatch.setattr(WORK_SPACE, (-99,))
    with raises(SetUpError, r"not enough memory or work space .*INFOG\(1\) = -\d+.*-test_coarse_"):
        gathered(random_definite(60))
    monkeypatch.setattr(WORK_SPACE, (-99, 50))
    equal(*gathered(random_definite(60))[1](), 1e-12)


@any_number
@pytest.mark.parametrize("step", [(Fronts, "factor"), (FrontFactor, "solve")])
def test_no_memory_on_one_process(step, gathered, monkeypatch):
    """Each process has a factor of its own; all of them raise, and none waits."""
    work = getattr(*step)

    def fail(*args, **how):
        if COMM.rank == COMM.size - 1:
            raise MemoryError("no room")
        return work(*args, **how)

    monkeypatch.setattr(*step, fail)
    with raises(SetUpError, "coarse problem could not be factored .no room"):
        gathered(random_definite(3 * COMM.size), 3, counts=np.array([3]))


@any_number
@pytest.mark.parametrize(
    "options", [{"ksp_type": "nonsense"}, {"pc_type": "no"}, {"pc_factor_mat_solver_type": "no"}]
)
def test_wrong_options_are_an_error_on_all_processes(options, gathered):
    """Each group of processes has its own solver; all of them raise."""
    message = "coarse problem could not be factored .*-test_coarse_"
    with inserted(PREFIX, options), raises(SetUpError, message):
        gathered(random_definite(5))


@any_number
def test_failed_solve_is_no_number(gathered):
    """Where the coarse solver diverges, all processes learn it from the solution."""
    with inserted(PREFIX, {"ksp_type": "cg", "pc_type": "none", "ksp_max_it": 1}):
        _, solved = gathered(random_definite(30))
        agree(np.isnan(solved()[0]).all())


FACTOR, ERROR = "coarse problem could not be factored", "leaves a backward error"


@pytest.mark.parametrize(
    ("message", "options"),
    [
        (FACTOR, {"pc_type": "no"}),
        (ERROR, {"pc_type": "none", "ksp_type": "cg", "ksp_max_it": 1}),
        (ERROR, {"pc_type": "none", "ksp_type": "cg", "ksp_rtol": 1e-2}),
    ],
)
def test_set_up_finds_a_coarse_solver_that_does_not_solve(message, options, torn_grid, feti):
    """Too rough a solver is found out before the first iteration."""
    A = torn_grid((3, 2), (2, 2), components=2).A
    context = feti(A, **{f"feti_coarse_{key}": o for key, o in options.items()}).getPythonContext()
    agree(message in context.message and not context.singular, context.message)
