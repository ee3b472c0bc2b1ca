# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Ritz vectors of the primal form: their algebra, the iterations they save, negative curvature."""

from dataclasses import replace
from functools import partial

from petsc4py import PETSc

import numpy as np
import primal_form
import pytest
from cases import case, each, every_interior
from collective import COMM, agree, equal, matrix_of_map, random_part, small, whole
from hand_torn import softened

from dolfinx_feti.feti.coarse.solver import CoarseSolver
from dolfinx_feti.feti.interface import copies
from dolfinx_feti.feti.primal import deflation, ritz_vectors
from dolfinx_feti.feti.primal.deflation import create_deflation_space
from dolfinx_feti.feti.primal.krylov.conjugate_gradients import conjugate_gradients
from dolfinx_feti.feti.primal.ritz_vectors import MAX_RITZ_VALUE, recycled_vectors
from dolfinx_feti.feti.primal.soft_fields import soft_fields
from dolfinx_feti.feti.primal.stopping import StoppingTest
from dolfinx_feti.feti.solve_info import DeflationVectors
from dolfinx_feti.runtime import collective

N_SMALL_EIGENVALUES = 4

#: The last residuals are orthogonal to V up to eps κ(A₀) of the first one, 1e7 times as large.
ORTHOGONALITY_TOLERANCE = 1e-3

GRID = case((4, 3), (3, 3), 2)
Reason = PETSc.KSP.ConvergedReason
SOFTENED = softened(0.0004)
every_change = each("change", {"no prestress": None, "compression": SOFTENED})


@pytest.fixture
def create_primal(create_primal):
    """Make the primal form of a problem without soft modes."""
    return partial(create_primal, coarse_modes=0)


def random_assembled(primal, columns):
    """Return random columns of the assembled interface, by copies, (n_Γ, columns)."""
    block = random_part(primal.system.copies.size, columns)
    return np.column_stack([primal.system.copies.average(t) for t in block.T])


def with_small_eigenvalues(primal):
    """Return a system with N_SMALL_EIGENVALUES small eigenvalues; its preconditioner is weak."""
    system = primal.system
    copies = primal.system.copies
    f = random_part(copies.size, N_SMALL_EIGENVALUES).T
    r = [system.residual(t, system.deflation.initial_guess(copies.sum(t))) for t in f]  # balanced
    X = copies.delta[:, None] * np.column_stack(r)
    C = np.linalg.cholesky(COMM.allreduce(X.T @ X))
    X = np.linalg.solve(C, X.T).T  # XᵀX = I

    def weaken(t):
        return t - 0.95 * X @ COMM.allreduce(X.T @ t)

    return replace(system, solve_local=lambda t: weaken(system.solve_local(weaken(t))))


def solve_cg(system, f, *, rtol=1e-10, max_it=200, stored=200):
    """Solve by conjugate gradients.

    Args:
        system: System on the assembled interface.
        f: Right-hand side, not summed over copies, (n_Γ,).
        rtol: Tolerance of the residual relative to the norm of the right-hand side.
        max_it: Most iterations.
        stored: Most iterations whose vectors are stored in the basis.

    Returns:
        Solution, (n_Γ,), how the method ended, and the basis.
    """
    stopping = StoppingTest(rtol * system.norm(system.copies.sum(f)), max_it)
    return conjugate_gradients(
        system,
        f,
        stopping,
        monitor=lambda its, norm: None,
        stored_iterations=stored,
        allow_indefinite=False,
    )


def with_ritz_vectors(primal, system, vectors):
    """Return the deflation space with these Ritz vectors, and the system with it."""
    space = create_deflation_space(primal.coarse, primal.operator, vectors)
    return space, replace(system, deflation=space)


def count_calls(monkeypatch, place, name, calls):
    """Append the name of a function to a list at each of its calls."""
    original = getattr(place, name)

    def counted(*arguments, **keywords):
        calls.append(name)
        return original(*arguments, **keywords)

    monkeypatch.setattr(place, name, counted)


@pytest.mark.parametrize("count", [0, 5])
def test_iteration_has_three_reductions(count, monkeypatch, torn_grid, create_primal):
    """One is in the coarse problem and two are scalar products, with Ritz vectors or without."""
    primal = create_primal(torn_grid(**GRID))
    W = random_assembled(primal, 5)[:, :count]
    _, system = with_ritz_vectors(primal, primal.system, DeflationVectors(W, W))
    f = random_part(primal.system.copies.size, seed=7)
    calls = []
    for module in (copies, deflation, ritz_vectors, collective):
        count_calls(monkeypatch, module, "total_of", calls)
    count_calls(monkeypatch, CoarseSolver, "solve", calls)
    counts = []
    for iterations in (2, 6):
        calls.clear()
        agree(len(solve_cg(system, f, rtol=1e-300, max_it=iterations)[2].R) == iterations)
        counts.append(len(calls))
    agree(counts[1] - counts[0] == 4 * 3, counts)


@every_change
@every_interior
def test_residuals_are_orthogonal_to_deflated_vectors(change, interior, torn_grid, create_primal):
    """This holds from the start on; directions are A-orthogonal to V and W."""
    primal = create_primal(torn_grid(change=change, **GRID), interior=interior)
    W = random_assembled(primal, 5)
    space, system = with_ritz_vectors(primal, primal.system, DeflationVectors(W, W))
    agree(space.count == 5)
    δ = system.copies.delta
    f = random_part(system.copies.size, seed=7)
    b = system.copies.sum(f)
    zero = np.zeros(system.copies.size)
    r = system.residual(f, space.initial_guess(b))
    small(np.abs(COMM.allreduce(W.T @ (δ * r))).max(), 1e-9 * system.norm(b))
    z, _ = space.correct(random_assembled(primal, 6)[:, 5], zero)
    Az = -system.residual(np.zeros_like(z), z)
    small(np.abs(COMM.allreduce(W.T @ (δ * Az))).max(), 1e-9 * system.norm(Az) * np.abs(W).max())
    equal(whole(space.correct(z, zero)[0]), whole(z), 1e-9)


@every_change
@pytest.mark.parametrize("first", [200, 7], ids=["all-iterations", "a-few"])
def test_ritz_vectors_diagonalise_the_operator(change, first, torn_grid, create_primal):
    """W = Π_V M Q with Wᵀ Q = I and diagonal Wᵀ A W, also if an earlier W was deflated."""
    primal = create_primal(torn_grid(change=change, **GRID), interior="eliminate")
    slow_system = with_small_eigenvalues(primal)
    f = random_part(primal.system.copies.size, seed=7)
    small_eigenvalues = np.linalg.eigvals(
        matrix_of_map(
            lambda x: slow_system.precondition(-slow_system.residual(0.0 * x, x))[0], len(f)
        )
    ).real
    small_eigenvalues = np.sort(
        small_eigenvalues[(1e-8 < small_eigenvalues) & (small_eigenvalues < MAX_RITZ_VALUE)]
    )
    agree(len(small_eigenvalues) >= N_SMALL_EIGENVALUES, small_eigenvalues)
    vectors = None
    system = slow_system
    δ = primal.system.copies.delta
    for max_count, stored in ((200 if first == 200 else 2, first), (200, 200)):
        space, system = with_ritz_vectors(primal, slow_system, vectors)
        basis = solve_cg(system, f, stored=stored, rtol=1e-7)[2]
        vectors = recycled_vectors(space, basis, max_count=max_count)
        W = vectors.W
        Q = vectors.M_inverse_W
        equal(COMM.allreduce(W.T @ (δ[:, None] * Q)), np.eye(W.shape[1]), ORTHOGONALITY_TOLERANCE)
        for w, q in zip(W.T, Q.T, strict=True):
            equal(whole(slow_system.precondition(q)[0]), whole(w), ORTHOGONALITY_TOLERANCE)
        AW = np.column_stack([-slow_system.residual(0.0 * w, w) for w in W.T])
        θ = COMM.allreduce(W.T @ (δ[:, None] * AW))
        equal(θ, np.diag(np.diag(θ)), ORTHOGONALITY_TOLERANCE)
        agree(np.all(np.diag(θ) < MAX_RITZ_VALUE))
    agree(
        W.shape[1] == len(small_eigenvalues) and np.all(np.diag(θ) > 0.99 * small_eigenvalues),
        (np.diag(θ), small_eigenvalues),
    )


def test_solve_without_iterations_keeps_the_ritz_vectors(torn_grid, create_primal):
    """So does a solve that ends in NaN."""
    primal = create_primal(torn_grid(**GRID), interior="eliminate")
    W = random_assembled(primal, 3)
    n = primal.system.copies.size
    for vectors in (None, DeflationVectors(W, W)):
        space, system = with_ritz_vectors(primal, primal.system, vectors)
        for f in (np.zeros(n), np.full(n, np.nan)):
            recycled = recycled_vectors(space, solve_cg(system, f)[2], max_count=20)
            agree(recycled.W.shape == recycled.M_inverse_W.shape == (n, space.count))


def test_dependent_vectors_are_dropped(torn_grid, create_primal):
    """Vectors that repeat others, or lie in V, change neither solution nor definiteness."""
    primal = create_primal(torn_grid(change=SOFTENED, **GRID), interior="eliminate")
    w = random_assembled(primal, 1)[:, 0]
    f = random_part(primal.system.copies.size, seed=7)
    v = primal.coarse.initial_guess(primal.system.copies.sum(f))  # in V
    W = np.column_stack([w, -2.0 * w, v, np.zeros_like(w)])
    space, system = with_ritz_vectors(primal, primal.system, DeflationVectors(W, W))
    agree(not space.is_indefinite)
    (x, outcome, _) = solve_cg(system, f)
    (expected, plain, _) = solve_cg(primal.system, f)
    agree(outcome.reason > 0 and outcome.iterations <= plain.iterations + 2)
    equal(whole(x), whole(expected), 1e-8)


def test_negative_curvature_of_ritz_vectors_ends_a_solve(torn_grid, create_primal):
    """If W proves that the matrix is indefinite, there is no iteration."""
    problem = torn_grid((2, 2), (4, 4), components=2, change=softened(0.002))
    primal = create_primal(problem, interior="eliminate")
    agree(primal.coarse.negative_eigenvalues == 0)
    f = random_part(primal.system.copies.size)
    exact = primal_form.reference(problem, primal)
    last = COMM.scan(primal.system.copies.size)
    p = (exact.T @ np.linalg.eigh(exact.A)[1][:, 0])[last - primal.system.copies.size : last]
    W = np.column_stack([p, random_assembled(primal, 3)])
    space, system = with_ritz_vectors(primal, primal.system, DeflationVectors(W, W))
    _, outcome, basis = solve_cg(system, f)
    agree(outcome.reason == Reason.DIVERGED_INDEFINITE_MAT and outcome.iterations == 0)
    agree(recycled_vectors(space, basis, max_count=20).W.shape == W.shape)


@every_interior
def test_soft_fields_raise_the_lowest_eigenvalue(interior, torn_grid, create_primal):
    """W = M Q with Q in the range of A V and Wᵀ Q = I; iterations do not grow."""
    primal = create_primal(torn_grid(**GRID, change=SOFTENED), interior=interior)
    S = primal.operator
    copies = primal.system.copies
    system = primal.system
    inverse = primal.preconditioner.inverse
    soft = soft_fields(primal.coarse, S, inverse, count=N_SMALL_EIGENVALUES)
    agree(soft.W.shape == (copies.size, N_SMALL_EIGENVALUES))
    equal(
        COMM.allreduce(soft.W.T @ (copies.delta[:, None] * soft.M_inverse_W)),
        np.eye(N_SMALL_EIGENVALUES),
        1e-8,
    )
    for w, q in zip(soft.W.T, soft.M_inverse_W.T, strict=True):
        difference = np.abs(w - copies.average(system.solve_local(copies.delta * q))).max(
            initial=0.0
        )
        small(difference, 1e-8 * np.abs(whole(w)).max())
        balanced = system.residual(q * copies.delta, primal.coarse.initial_guess(q))  # q − A V …
        small(system.norm(balanced), 1e-6 * system.norm(q))
    f = random_part(copies.size)
    before, after = (solve_cg(with_ritz_vectors(primal, system, v)[1], f)[1] for v in (None, soft))
    agree(after.iterations <= before.iterations)
    agree(after.ritz_values[0] >= before.ritz_values[0] * (1.0 - 1e-6))
