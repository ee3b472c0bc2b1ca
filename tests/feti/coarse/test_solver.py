# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The coarse solver: inverse, factors by fronts and of groups, inertia, memory, failures."""

import contextlib

from petsc4py import PETSc

import numpy as np
import pytest
from collective import COMM, agree, equal, raises, small, whole

from dolfinx_feti.errors import SetUpError
from dolfinx_feti.feti.coarse.fronts import SharedFronts
from dolfinx_feti.feti.coarse.group import GroupFactor
from dolfinx_feti.feti.coarse.inverse import RowsOfInverse
from dolfinx_feti.feti.coarse.solver import CoarseSolver
from dolfinx_feti.feti.subdomain.factors.multifrontal import FrontFactor, Fronts
from dolfinx_feti.feti.subsolver_options import read_direct_options
from dolfinx_feti.runtime.petsc_options import inserted

SEED = 33107
PREFIX = "test_coarse_"

#: Constants that tests change.
ROWS_PER_PROCESS = "dolfinx_feti.feti.coarse.group.ROWS_PER_PROCESS"
INVERSE_ROWS = "dolfinx_feti.feti.coarse.solver.INVERSE_ROWS_PER_PROCESS"
FRONT_ENTRIES = "dolfinx_feti.feti.coarse.fronts.MAX_FRONT_ENTRIES"
WORK_SPACE = "dolfinx_feti.feti.subdomain.factors.petsc_solver.WORK_SPACE"

any_number = pytest.mark.processes(1, 2, 3, 4, 8)


class Distributed:
    """A matrix distributed by rows, and its solver."""

    def __init__(self, A, lifetime, *, local_rows=None, **arguments):
        layout = (local_rows, len(A))
        self.A = A
        self._lifetime = lifetime
        self.N = lifetime.own(PETSc.Mat().createAIJ((layout, layout), comm=COMM))
        self.N.setUp()
        for i in range(*self.N.getOwnershipRange()):
            self.N.setValues(i, range(len(A)), A[i])
        self.N.assemble()
        arguments = {"options": read_direct_options(PREFIX), "is_symmetric": True, **arguments}
        self.solver = lifetime.own(CoarseSolver(self.N, **arguments))

    def solve_random(self, seed=SEED):
        """Solve for a random solution; return the computed one and it, (N_c,)."""
        expected = np.random.default_rng(seed).standard_normal(len(self.A))
        b, x = (self._lifetime.own(vector) for vector in self.N.createVecs())
        b.array[:] = (self.A @ expected)[slice(*b.getOwnershipRange())]
        self.solver.solve(b, x)
        return whole(x.array_r), expected


@pytest.fixture
def factor_distributed(lifetime):
    """Return a function that distributes a matrix by rows and factors it."""
    return lambda A, local_rows=None, **arguments: Distributed(
        A, lifetime, local_rows=local_rows, **arguments
    )


def rows_of_process(n):
    """Return how many of n rows this process has, by PETSc's layout."""
    return n // COMM.size + (1 if COMM.rank < n % COMM.size else 0)


def random_definite(n):
    """Return a random positive definite matrix, (n, n), the same on all processes."""
    X = np.random.default_rng(SEED).standard_normal((n, n))
    return X @ X.T + n * np.eye(n)


def tridiagonal(n, *, lower=-1.0, diagonal=3.0):
    """Return a tridiagonal matrix with −1 above the diagonal, (n, n)."""
    return diagonal * np.eye(n) - np.eye(n, k=1) + lower * np.eye(n, k=-1)


@any_number
@pytest.mark.parametrize("rows", [1, 3, 4000])
@pytest.mark.parametrize("symmetric", [True, False])
def test_group_factor_solves_on_any_number_of_processes(
    rows, symmetric, factor_distributed, monkeypatch
):
    """A tridiagonal system with about ``rows`` rows on each active process."""
    monkeypatch.setattr(ROWS_PER_PROCESS, rows)
    n = 7
    A = tridiagonal(n, lower=-1.0 if symmetric else -0.3)
    system = factor_distributed(A, is_symmetric=symmetric)
    solver = system.solver
    active = min(COMM.size, -(-n // rows))
    agree(active <= solver.factor.ksp.comm.size < 2 * active)
    for seed in (1, 2):
        computed, expected = system.solve_random(seed)
        equal(computed, expected, 1e-13)
    agree(solver.inertia() == ((0, 0) if symmetric else (None, 0)))
    agree(solver.memory() >= 0.0)


@any_number
@pytest.mark.parametrize("inverse_rows", [0, 128], ids=["factor", "inverse"])
@pytest.mark.parametrize("kind", ["definite", "one block", "singular", "indefinite", "large"])
def test_factor_is_chosen_by_definiteness_and_size(
    kind, inverse_rows, factor_distributed, monkeypatch
):
    """Fronts, or MUMPS if the matrix is not definite or too large; subdomains may have no rows."""
    monkeypatch.setattr(INVERSE_ROWS, inverse_rows)
    monkeypatch.setattr(FRONT_ENTRIES, 10 if kind == "large" else 2**25)
    sizes = np.array([2, 0, 3, 1] if kind != "one block" else [0, 3])
    subdomain = np.repeat(np.arange(len(sizes) * COMM.size), np.tile(sizes, COMM.size))
    n = len(subdomain)
    A = random_definite(n)
    if kind != "one block":
        A[np.abs(subdomain[:, None] - subdomain) > 3] = 0.0  # subdomains in a row
    A += n * np.eye(n)
    if kind == "singular":
        A[1], A[:, 1] = A[0], A[:, 0]
        A[1, 1] = A[0, 0]
    if kind == "indefinite":
        A[0, 0] *= -1.0
    system = factor_distributed(A, n // COMM.size, zero_pivot=1e-8, block_widths=sizes)
    solver = system.solver
    by_fronts = kind in ("definite", "one block")
    has_inverse = by_fronts and inverse_rows > 0
    expected_class = GroupFactor
    if by_fronts:
        expected_class = RowsOfInverse if has_inverse else SharedFronts
    agree(isinstance(solver.factor, expected_class), kind)
    if has_inverse:
        own = slice(n // COMM.size * COMM.rank, n // COMM.size * (COMM.rank + 1))
        equal(solver.factor.rows, np.linalg.inv(A)[own], 1e-14)
        agree("inverse" in str(solver))
    pivots = {"singular": (0, 1), "indefinite": (1, 0)}.get(kind, (0, 0))
    agree(solver.inertia() == pivots, (kind, solver.inertia(), pivots))
    if by_fronts:
        agree(solver.memory() > 0.0)
    computed, expected = system.solve_random()
    equal(A @ computed, A @ expected, 1e-12)


def test_options_select_another_solver_than_fronts(factor_distributed):
    """Any option that names a solver switches the fronts off."""
    for option in ({"ksp_type": "cg"}, {"pc_type": "lu"}, {"pc_factor_mat_solver_type": "petsc"}):
        with inserted(PREFIX, option):
            system = factor_distributed(
                random_definite(3 * COMM.size), 3, block_widths=np.array([3])
            )
            agree(isinstance(system.solver.factor, GroupFactor))


@any_number
@pytest.mark.parametrize("nodes", [1, 2, 3])
def test_processes_of_a_node_share_a_factor_and_its_failure(nodes, factor_distributed, monkeypatch):
    """Nodes of a cluster are simulated by groups of processes, which are not consecutive."""
    monkeypatch.setattr(INVERSE_ROWS, 0)
    if nodes > 1:
        split = "dolfinx_feti.feti.coarse.fronts.processes_of_computer"
        monkeypatch.setattr(split, lambda comm: comm.Split(comm.rank % nodes, comm.rank))
    system = factor_distributed(random_definite(3 * COMM.size), 3, block_widths=np.array([1, 2]))
    solver = system.solver
    factors = COMM.allreduce(solver.factor.factor is not None)
    agree(factors == min(nodes, COMM.size), factors)
    agree(solver.memory() > 0.0 and isinstance(solver.factor, SharedFronts))
    computed, expected = system.solve_random()
    equal(computed, expected, 1e-12)
    monkeypatch.setattr(FrontFactor, "solve", lambda *_: 1 / 0)
    agree(bool(np.isnan(system.solve_random()[0]).all()))
    with contextlib.suppress(ZeroDivisionError):
        solver.factor._errors.raise_first()


@pytest.mark.parametrize(("shift", "inertia"), [(0.0, (0, 1)), (-1.5, (3, 0)), (-10.0, (7, 0))])
def test_solver_reports_inertia(shift, inertia, factor_distributed):
    """The Neumann matrix is singular, and indefinite when it is shifted."""
    A = tridiagonal(7, diagonal=2.0 + shift)
    A[0, 0] = A[-1, -1] = 1.0 + shift
    agree(np.count_nonzero(np.linalg.eigvalsh(A) < -1e-10) == inertia[0])
    pivots = factor_distributed(A).solver.inertia()
    agree(pivots == inertia, pivots)


@pytest.mark.parametrize("κ", [1e6, 1e14])
def test_inverse_is_used_only_if_it_is_accurate(κ, factor_distributed):
    """A nearly singular matrix is solved with its factor, which rounding harms less."""
    own = rows_of_process(8)
    system = factor_distributed(
        np.diag(κ ** (-np.arange(8) / 7)), own, block_widths=np.array([own])
    )
    agree(isinstance(system.solver.factor, RowsOfInverse) == (κ < 1e10))
    computed, expected = system.solve_random()
    small(np.abs(computed / expected - 1.0).max(), 1e-14)


def test_memory_is_in_mebibytes_or_unknown(factor_distributed):
    """MUMPS counts in units of 10⁶ bytes; an iterative solver does not report any."""
    A = random_definite(60)
    solver = factor_distributed(A).solver
    millions = COMM.bcast(solver.factor.ksp.getPC().getFactorMatrix().getMumpsInfog(22))
    small(solver.memory() - millions / 1.048576, 1e-9 * max(millions, 1))
    own = rows_of_process(60)
    solver = factor_distributed(A, own, block_widths=np.array([own])).solver
    stored = COMM.allreduce(solver.factor.rows.nbytes)
    agree(stored == 8 * 60**2, stored)
    small(solver.memory() - solver.factor.factor.memory() - stored / 2**20, 1e-9)
    with inserted(PREFIX, {"ksp_type": "cg", "pc_type": "jacobi"}):
        solver = factor_distributed(A).solver
    agree(solver.memory() is None and solver.inertia() == (None, None))


# ---- failures -------------------------------------------------------------------------------


@any_number
@pytest.mark.parametrize("rows", [20, 4000])
def test_more_work_space_is_allocated_if_it_is_short(rows, factor_distributed, monkeypatch):
    """The first attempt really fails, on all processes alike, and the second one succeeds."""
    monkeypatch.setattr(ROWS_PER_PROCESS, rows)
    monkeypatch.setattr(WORK_SPACE, (-99,))
    with raises(SetUpError, r"not enough memory or work space .*INFOG\(1\) = -\d+.*-test_coarse_"):
        factor_distributed(random_definite(60))
    monkeypatch.setattr(WORK_SPACE, (-99, 50))
    computed, expected = factor_distributed(random_definite(60)).solve_random()
    equal(computed, expected, 1e-12)


@any_number
@pytest.mark.parametrize("step", [(Fronts, "factor"), (FrontFactor, "solve")])
def test_memory_error_on_one_process_is_an_error_on_all(step, factor_distributed, monkeypatch):
    """All processes raise, and none waits."""
    work = getattr(*step)

    def fail(*args, **how):
        if COMM.rank == COMM.size - 1:
            raise MemoryError("no room")
        return work(*args, **how)

    monkeypatch.setattr(*step, fail)
    with raises(SetUpError, "coarse problem could not be factored .no room"):
        factor_distributed(random_definite(3 * COMM.size), 3, block_widths=np.array([3]))


@any_number
@pytest.mark.parametrize(
    "options", [{"ksp_type": "nonsense"}, {"pc_type": "no"}, {"pc_factor_mat_solver_type": "no"}]
)
def test_wrong_options_are_an_error_on_all_processes(options, factor_distributed):
    """Each group of processes has its own solver; all of them raise."""
    message = "coarse problem could not be factored .*-test_coarse_"
    with inserted(PREFIX, options), raises(SetUpError, message):
        factor_distributed(random_definite(5))


@any_number
def test_failed_solve_is_nan(factor_distributed):
    """If the coarse solver diverges, the solution is NaN on all processes."""
    with inserted(PREFIX, {"ksp_type": "cg", "pc_type": "none", "ksp_max_it": 1}):
        computed, _ = factor_distributed(random_definite(30)).solve_random()
        agree(np.isnan(computed).all())


FACTOR_MESSAGE = "coarse problem could not be factored"
ERROR_MESSAGE = "leaves a backward error"


@pytest.mark.parametrize(
    ("message", "options"),
    [
        (FACTOR_MESSAGE, {"pc_type": "no"}),
        (ERROR_MESSAGE, {"pc_type": "none", "ksp_type": "cg", "ksp_max_it": 1}),
        (ERROR_MESSAGE, {"pc_type": "none", "ksp_type": "cg", "ksp_rtol": 1e-2}),
    ],
)
def test_set_up_refuses_an_inaccurate_coarse_solver(message, options, torn_grid, create_ksp):
    """Its backward error is measured before the first iteration."""
    A = torn_grid((3, 2), (2, 2), components=2).A
    context = create_ksp(
        A, **{f"feti_coarse_{key}": o for key, o in options.items()}
    ).getPythonContext()
    agree(message in context.message and not context.singular, context.message)
