# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Factors of sparse regularised blocks, by fronts and with pivots, against dense algebra."""

from __future__ import annotations

from types import SimpleNamespace

from petsc4py import PETSc

import numpy as np
import pytest
from collective import COMM, agree, equal, small

from dolfinx_feti.feti.subdomain.sparse import regularised
from dolfinx_feti.feti.subdomain.sparse.factors import BlockFactors
from dolfinx_feti.feti.subdomain.sparse.fronts import load_fronts
from dolfinx_feti.feti.subdomain.sparse.regularised import RegularisedFactors

SHAPE = (6, 5, 4)
RHO = 3.0


def spring_grid(shape, seed=11):
    """Return the stiffness of springs between the nodes of a grid, and its null vector, (n, 1)."""
    places = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1)
    places = places.reshape(-1, len(shape))
    near = np.abs(places[:, None] - places[None]).max(axis=2) == 1
    stiffness = np.random.default_rng(seed).uniform(0.5, 2.0, near.shape) * near
    stiffness = np.triu(stiffness) + np.triu(stiffness).T
    K = np.diag(stiffness.sum(axis=1)) - stiffness
    return K, np.full((len(K), 1), len(K) ** -0.5)


def elastic(shape):
    """Return three grids that do not know of each other, node by node, and their null vectors."""
    K, one = spring_grid(shape)
    return np.kron(K, np.eye(3) + 0.1), np.kron(one, np.eye(3))


@pytest.fixture
def factored():
    """Factor one block, and free it in the end; the factors with pivots are there, too."""
    made = []

    def create(K, R, rho=RHO, code=True):
        rows = np.arange(len(K), dtype=np.int32)
        M = PETSc.Mat().createAIJ(K.shape, nnz=len(K), bsize=3, comm=PETSc.COMM_SELF)
        M.setOption(PETSc.Mat.Option.IGNORE_ZERO_ENTRIES, True)
        M.setValues(rows, rows, K)
        M.assemble()
        factors = BlockFactors(M, [rows], prefix="some_", symmetric=True)
        if code:
            torn = SimpleNamespace(K=M, n=len(K))
            factors = RegularisedFactors(torn, [rows], factors, load_fronts(COMM))
        made.extend([factors, M])
        factors.update_block(0, R, rho)
        return factors

    yield create
    for owned in made:
        owned.destroy()


def by_fronts(factors):
    return factors._fronts[0] is not None and factors._fronts[0].factored


CHANGES = {
    "kernel": lambda K, R: K,
    "prestress": lambda K, R: K + 1e-3 * np.diag(np.cos(np.arange(len(K)))),
    "stiffer": lambda K, R: K + 0.1 * np.diag(K.diagonal()),
    "no modes": lambda K, R: K + np.eye(len(K)),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_is_the_inverse_of_the_regularised_block(change, factored):
    """K_ρ⁻¹ for one column and several, E = ρ K_ρ⁻¹ R and D = ρ (I − Rᵀ E)."""
    K, R = elastic(SHAPE)
    K = change(K, R)
    R = R[:, :0] if change is CHANGES["no modes"] else R
    K_ρ = K + RHO * R @ R.T
    factors = factored(K, R)
    agree(by_fronts(factors) and factors.memory() > 0.0)
    Y = np.random.default_rng(5).standard_normal((len(K), 4))
    X = factors.solve_many(0, Y)
    tolerance = 1e2 * np.finfo(float).eps * np.linalg.cond(K_ρ)
    equal(K_ρ @ X, Y, tolerance)
    x = np.zeros(len(K))
    factors.solve(Y[:, 1].copy(), x)
    equal(x, X[:, 1], tolerance)
    agree(factors.pivots(0) == (0, 0))
    if R.shape[1]:
        E, D = RHO * factors.solve_border(0)[0], -(RHO**2) * factors.solve_border(0)[1]
        expected = RHO * np.linalg.solve(K_ρ, R)
        equal(E, expected, tolerance)
        small(np.abs(D - RHO * (np.eye(3) - R.T @ expected)).max(), RHO * tolerance)


def test_small_defects_are_exact(factored):
    """D of a nearly exact kernel has all its digits."""
    K, R = elastic(SHAPE)
    tiny = 1e-9 * np.diag(1.0 + np.arange(len(K)) % 5)
    D = -(RHO**2) * factored(K + tiny, R).solve_border(0)[1]
    equal(D, R.T @ tiny @ R, 1e-6)


@pytest.mark.parametrize("sign", [-1.0, 1.0], ids=["positive", "negative"])
def test_negative_eigenvalues_are_counted(sign, factored):
    """One of K_ρ, whichever way it is factored, as dense algebra has it."""
    K, R = elastic(SHAPE)
    y = np.linalg.eigh(K + RHO * R @ R.T)[1][:, 2]
    bent = K - (1.0 + sign * 0.2) * (y @ K @ y) * np.outer(y, y)
    agree(factored(bent, R).pivots(0) == (int(sign > 0.0), 0))
    agree(factored(bent, R, code=False).pivots(0).negative == int(sign > 0.0))


def test_modes_that_weigh_more_in_the_last_front(factored):
    """K_Q is positive definite, K_ρ is not: the correction tells."""
    K = 0.01 * elastic(SHAPE)[0] + np.eye(120 * 3)
    last = factored(K, np.zeros((len(K), 0)))._fronts[0].last
    others = np.setdiff1d(np.arange(len(K)), last)[: len(last)]
    K[last, last] -= 1.5
    R = np.zeros((len(K), len(last)))
    R[last, np.arange(len(last))] = 0.2
    R[others, np.arange(len(last))] = np.sqrt(1.0 - 0.2**2)
    factors = factored(K, R)
    negative = int(np.count_nonzero(np.linalg.eigvalsh(K + RHO * R @ R.T) < 0.0))
    agree(by_fronts(factors) and factors.pivots(0) == (negative, 0) and negative > 100)


def test_modes_that_the_last_front_does_not_hold(factored):
    """As of a second part that hangs on nothing: pivots take over."""
    K, R = elastic((4, 3, 2))
    n = len(K)
    both = np.block([[K, np.zeros((n, n))], [np.zeros((n, n)), 2.0 * K]])
    modes = np.block([[R, np.zeros(R.shape)], [np.zeros(R.shape), R]])
    factors = factored(both, modes)
    agree(not by_fronts(factors))
    K_ρ = both + RHO * modes @ modes.T
    Y = np.ones((2 * n, 2))
    equal(K_ρ @ factors.solve_many(0, Y), Y, 1e-11)
    factors.update_block(0, None, shift=np.ones(2 * n))
    equal((both + np.eye(2 * n)) @ factors.solve_many(0, Y), Y, 1e-11)


@pytest.mark.parametrize("image", [[-1.0, 1.0], [np.inf, 1.0], [np.nan, 1.0]], ids=str)
def test_no_correction_of_a_singular_factor(image):
    """Λ⁻¹ + Vᵀ Z is singular, or has no numbers, with V = I and Λ = diag(1, −1)."""
    R = np.array([[1.0], [0.0]])
    fronts = SimpleNamespace(last=np.array([1]), solve=lambda V: np.diag(image))
    agree(regularised._correction(fronts, R, np.ones((1, 1)), 1.0) is None)


def test_pivots_where_a_factor_is_singular_up_to_rounding(factored, monkeypatch):
    """Cholesky's pivots may all be positive by chance: the correction tells."""
    K, R = elastic(SHAPE)
    monkeypatch.setattr(regularised, "_correction", lambda *parts: None)
    factors = factored(K, R)
    agree(not by_fronts(factors) and factors.memory() > 0.0)
    Y = np.ones((len(K), 2))
    equal((K + RHO * R @ R.T) @ factors.solve_many(0, Y), Y, 1e-11)


def test_only_one_of_the_factors_is_kept(factored):
    """Fronts where they will do, and nothing else beside them."""
    K, R = elastic(SHAPE)
    factors = factored(K, R)
    fronts = factors.memory()
    factors.update_block(0, R, RHO, shift=np.ones(len(K)))
    agree(not by_fronts(factors) and factors.memory() > 0.0)
    factors.update_block(0, R, RHO)
    agree(by_fronts(factors) and factors.memory() == fronts)


@pytest.mark.parametrize("option", ["pc_factor_mat_solver_type", "pc_type"])
def test_options_that_name_a_solver_are_followed(option, torn_grid, parts):
    options = PETSc.Options("test_feti_local_")
    options[option] = {"pc_type": "cholesky"}.get(option, "mumps")
    try:
        system = parts(torn_grid((2, 2), (4, 3)).A, interior="keep")
        agree(isinstance(system.matrices.factors, BlockFactors))
        agree(isinstance(system.preconditioner.factors, RegularisedFactors))
    finally:
        options.delValue(option)


def test_unsymmetric_matrices_and_long_indices_have_pivots(torn_grid, parts, monkeypatch):
    def skew(K, dofs):
        for k in K:
            k += 0.01 * np.triu(np.ones(k.shape), 1) * (k != 0.0)

    system = parts(torn_grid((2, 2), (4, 3), change=skew).A, interior="keep")
    agree(isinstance(system.matrices.factors, BlockFactors))
    monkeypatch.setattr(regularised, "reads_in_place", lambda: False)
    factors = regularised.create_factors(
        system.torn, system.matrices.dofs, prefix="", symmetric=True
    )
    agree(isinstance(factors, BlockFactors))
    factors.destroy()
