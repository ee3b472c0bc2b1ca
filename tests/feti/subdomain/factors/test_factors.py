# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Factors of dense and sparse blocks against dense algebra, and the null vectors they find."""

from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from cases import each
from collective import COMM, agree, equal, small
from hand_torn import block_matrix, unsymmetric

from dolfinx_feti.errors import FactorError
from dolfinx_feti.feti.setup import set_up_operator
from dolfinx_feti.feti.subdomain import analysis, nullspace
from dolfinx_feti.feti.subdomain.factors.dense import SINGLE, DenseFactor, PackedMatrix, pack
from dolfinx_feti.feti.subdomain.factors.direct import Choice
from dolfinx_feti.feti.subdomain.factors.multifrontal import FrontFactor, create_fronts, load_fronts
from dolfinx_feti.feti.subdomain.factors.pivoted import PivotedFactor
from dolfinx_feti.feti.subdomain.factors.regularised import factor_by_fronts
from dolfinx_feti.feti.subdomain.nullspace import factor_tells_singular, growth, null_space
from dolfinx_feti.runtime.connectivity import block_graph
from dolfinx_feti.runtime.petsc_library import rows_of
from dolfinx_feti.runtime.petsc_options import inserted

RHO, SEED = 3.0, 60221


def packed(S):
    """The matrix in packed format, with work space of its own."""
    return PackedMatrix(pack(np.asfortranarray(S)), len(S), np.empty(len(S) ** 2))


def block(n, least, scale=1.0):
    """Return S, packed and dense, with eigenvalues from ``least`` to 1 times a scale, and R."""
    rng = np.random.default_rng(n)
    Q = np.linalg.qr(rng.standard_normal((n, n)))[0]
    S = scale * (Q * np.geomspace(least, 1.0, n)) @ Q.T
    R = np.linalg.qr(rng.standard_normal((n, min(n, 3))))[0]
    return packed(S), S, R


@pytest.fixture
def factored(lifetime):
    """Factor K + ρ R Rᵀ + diag(shift), where K is one block, in one of four ways."""

    def create(K, R=None, rho=RHO, shift=None, *, kind="fronts", bs=1):
        rows, R = np.arange(len(K), dtype=np.int32), K[:, :0] if R is None else R
        if kind == "dense":
            return DenseFactor(packed(K), R, rho, shift)
        if kind == "single":
            return DenseFactor.roughly(packed(K), R, rho)
        M = lifetime.own(block_matrix([(K, K)], bs))
        if kind == "pivots":
            return lifetime.own(PivotedFactor(M, rows, Choice("some_", True, 8), R, rho, shift))
        with rows_of(M) as of_M:
            fronts = create_fronts(
                load_fronts(COMM), block_graph(of_M, bs), rows, rows, bs, rows[:0]
            )
            return factor_by_fronts(fronts, of_M, np.empty(fronts.work), R, rho)

    return create


@pytest.mark.parametrize("shift", [40.0, 3.0], ids=["definite", "indefinite"])
def test_factor(shift):
    """S, and the factor of S_ρ with its inertia; the block survives its factors."""
    n, rng = 23, np.random.default_rng(31)
    A = rng.standard_normal((n, n))
    S = A + A.T + shift * np.eye(n)
    R, matrix = np.linalg.qr(rng.standard_normal((n, 3)))[0], packed(S)
    for columns in (R[:, :1], R, R[:, :0]):
        factor, S_ρ = DenseFactor(matrix, columns, RHO), S + RHO * columns @ columns.T
        for Y in (rng.standard_normal(n), *(rng.standard_normal((n, k)) for k in (4, 9))):
            equal(S_ρ @ factor.solve(Y), Y, 1e-12)
            multiply = matrix.multiply if Y.ndim == 1 else matrix.multiply_many
            equal(multiply(Y), S @ Y, 1e-14)
        negative = np.count_nonzero(np.linalg.eigvalsh(S_ρ) < 0)
        assert (negative > 0) == (shift < 10.0)
        assert factor.pivots == (negative, 0)
        assert matrix.memory() == n * (n + 1) / 2 * 8 / 2**20
        assert factor.memory() == (n * n if negative else n * (n + 1) / 2) * 8 / 2**20


def test_empty_singular_and_nan():
    empty = packed(np.zeros((0, 0)))
    factor = DenseFactor(empty)
    assert factor.pivots == (0, 0) and factor.solve(np.zeros(0)).shape == (0,)
    assert factor.solve(np.zeros((0, 3))).shape == (0, 3)
    assert not factor_tells_singular(factor, np.zeros(0))
    assert DenseFactor.roughly(empty, np.zeros((0, 0)), 1.0) is None
    indefinite, _, R = block(20, 1e-3)
    indefinite.values[0] = -1.0
    assert DenseFactor.roughly(indefinite, R, RHO).pivots == (1, 0)
    with pytest.raises(FactorError, match="a zero pivot"):
        DenseFactor(packed(np.diag([1.0, 2.0, 0.0, 3.0, 0.0])))
    with pytest.raises(FactorError, match="NaN or Inf"):
        packed(np.full((2, 2), np.nan))


@pytest.mark.parametrize("scale", [1.0, 1e-60, 1e60])
@pytest.mark.parametrize("n", [1, 2, 40])
def test_inverse_up_to_rounding_in_single_precision(n, scale):
    """Columns and a vector, whatever the units; S stays as it is; half the memory."""
    packed, S, R = block(n, 1e-3, scale)
    before = packed.values.copy()
    rho = RHO * scale
    factor, double = DenseFactor.roughly(packed, R, rho), DenseFactor(packed, R, rho)
    S_ρ = S + rho * R @ R.T
    exact = np.linalg.inv(S_ρ)
    Y = np.random.default_rng(1).standard_normal((n, 5)) / scale
    bound = 10.0 * SINGLE * np.linalg.cond(S_ρ)
    for y, solved in (
        (Y, factor.solver()(Y)),
        (Y, factor.solve(Y)),
        (Y[:, 0], factor.solve(Y[:, 0])),
    ):
        assert solved.dtype == np.float64
        assert np.linalg.norm(solved - exact @ y) <= bound * np.linalg.norm(exact @ y)
    assert not factor.solve(0.0 * Y).any()
    assert np.array_equal(packed.values, before)
    assert factor.pivots == (0, 0)
    assert factor.memory() == 0.5 * double.memory()
    factor.destroy()
    assert factor.memory() == 0.0


@pytest.mark.parametrize("kind", ["single", "dense", "indefinite", "pivots"])
def test_destroyed_factor_raises(kind, factored):
    """A vector, columns of either number, and none; memory that is free is not read."""
    S = np.diag(np.r_[-1.0 if kind == "indefinite" else 1.0, np.ones(39)])
    factor = factored(S, kind="dense" if kind == "indefinite" else kind)
    shapes = [(40,), (40, 3), (40, 9), (40, 0)]
    for shape in shapes:
        assert np.isfinite(factor.solve(np.ones(shape))).all()
    factor.destroy()
    factor.destroy()
    for shape in shapes:
        with pytest.raises(RuntimeError, match="has been destroyed"):
            factor.solve(np.ones(shape))


@pytest.mark.parametrize("least", [1e-1, 1e-3, 1e-5])
def test_error_is_that_of_the_growth(least):
    """A solve is off by about ε times the growth of random vectors, which is found with it."""
    packed, S, R = block(60, least)
    factor, double = DenseFactor.roughly(packed, R, RHO), DenseFactor(packed, R, RHO)
    y = np.random.default_rng(2).standard_normal(60)
    error = np.linalg.norm(factor.solve(y) - double.solve(y)) / np.linalg.norm(double.solve(y))
    stiffest = np.linalg.norm(S + RHO * R @ R.T, 2) / S.diagonal().mean()
    assert error <= SINGLE * stiffest * growth(factor, S.diagonal())


# ---- sparse regularised blocks, by fronts and with pivots ------------------------------------

SHAPE = (6, 5, 4)


def elastic(shape, seed=11):
    """Return three grids of springs that do not know of each other, and their null vectors."""
    places = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1)
    places = places.reshape(-1, len(shape))
    near = np.abs(places[:, None] - places[None]).max(axis=2) == 1
    stiffness = np.random.default_rng(seed).uniform(0.5, 2.0, near.shape) * near
    stiffness = np.triu(stiffness) + np.triu(stiffness).T
    K = np.diag(stiffness.sum(axis=1)) - stiffness
    one = np.full((len(K), 1), len(K) ** -0.5)
    return np.kron(K, np.eye(3) + 0.1), np.kron(one, np.eye(3))


CHANGES = {
    "kernel": lambda K, R: K,
    "prestress": lambda K, R: K + 1e-3 * np.diag(np.cos(np.arange(len(K)))),
    "stiffer": lambda K, R: K + 0.1 * np.diag(K.diagonal()),
    "no modes": lambda K, R: K + np.eye(len(K)),
}


@each("change", CHANGES)
@pytest.mark.parametrize("kind", ["dense", "fronts", "pivots"])
def test_is_the_inverse_of_the_regularised_block(change, kind, factored):
    """K_ρ⁻¹ for one column and several."""
    K, R = elastic(SHAPE)
    K = change(K, R)
    R = R[:, :0] if change is CHANGES["no modes"] else R
    K_ρ = K + RHO * R @ R.T
    tolerance = 1e2 * np.finfo(float).eps * np.linalg.cond(K_ρ)
    Y = np.random.default_rng(5).standard_normal((len(K), 4))
    factor = factored(K, R, kind=kind, bs=3)
    agree(factor.memory() > 0.0 and factor.pivots == (0, 0))
    X = factor.solve(Y)
    equal(K_ρ @ X, Y, tolerance)
    equal(factor.solve(Y[:, 1].copy()), X[:, 1], tolerance)


def test_modes_that_weigh_more_in_the_last_front(factored):
    """K_Q is positive definite, K_ρ is not: the correction tells."""
    K = 0.01 * elastic(SHAPE)[0] + np.eye(120 * 3)
    last = factored(K, bs=3).last
    others = np.setdiff1d(np.arange(len(K)), last)[: len(last)]
    K[last, last] -= 1.5
    R = np.zeros((len(K), len(last)))
    R[last, np.arange(len(last))] = 0.2
    R[others, np.arange(len(last))] = np.sqrt(1.0 - 0.2**2)
    factor = factored(K, R, bs=3)
    negative = int(np.count_nonzero(np.linalg.eigvalsh(K + RHO * R @ R.T) < 0.0))
    agree(factor.pivots == (negative, 0) and negative > 100)


def test_modes_that_the_last_front_does_not_hold(factored):
    """As of a second part that hangs on nothing: pivots take over."""
    K, R = elastic((4, 3, 2))
    n = len(K)
    both = np.block([[K, np.zeros((n, n))], [np.zeros((n, n)), 2.0 * K]])
    modes = np.block([[R, np.zeros(R.shape)], [np.zeros(R.shape), R]])
    agree(factored(both, modes, bs=3) is None)
    factor = factored(both, modes, kind="pivots", bs=3)
    Y = np.ones((2 * n, 2))
    equal((both + RHO * modes @ modes.T) @ factor.solve(Y), Y, 1e-11)


@pytest.mark.parametrize("image", [[-1.0, 1.0], [np.inf, 1.0], [np.nan, 1.0]], ids=str)
def test_no_correction_of_a_singular_factor(image):
    """Λ⁻¹ + Vᵀ Z is singular, or has no numbers, with V = I and Λ = diag(1, −1)."""
    R = np.array([[1.0], [1.0]]) * np.sqrt(0.5)
    front = SimpleNamespace(solve=lambda V: np.linalg.solve(V.T, np.diag(image)))
    fronts = SimpleNamespace(last=np.array([1]), factor=lambda *_: (front, None))
    agree(factor_by_fronts(fronts, None, None, R, 1.0) is None)


@pytest.mark.parametrize("option", ["pc_factor_mat_solver_type", "pc_type"])
def test_options_that_name_a_solver_are_followed(option, torn_grid, parts):
    with inserted("test_feti_local_", {option: {"pc_type": "cholesky"}.get(option, "mumps")}):
        system = parts(torn_grid((2, 2), (4, 3)).A, interior="keep")
    agree(all(isinstance(factor, PivotedFactor) for factor in system.inverse.factors))
    agree(all(isinstance(factor, FrontFactor) for factor in system.operator.interior_factors))


def test_unsymmetric_matrices_and_long_indices_have_pivots(
    torn_grid, pattern, parts, lifetime, monkeypatch
):
    read = pattern(torn_grid((2, 2), (4, 3), change=unsymmetric(0.01)).A)
    S = set_up_operator(read, lifetime)
    agree(all(isinstance(factor, PivotedFactor) for factor in S.interior_factors))
    monkeypatch.setattr(analysis, "reads_in_place", lambda: False)
    system = parts(torn_grid((2, 2), (4, 3)).A, interior="keep")
    agree(all(isinstance(factor, PivotedFactor) for factor in system.inverse.factors))


# ---- null vectors of random matrices --------------------------------------------------------

every_size = pytest.mark.parametrize("dense", [1000, 10], ids=["all vectors", "inverse iteration"])
every_kind = pytest.mark.parametrize("kind", ["pivots", "fronts", "dense"])


def singular(n, nullity, spread, *, softest=1e-6):
    """A positive semi-definite matrix, and its null vectors; scales far apart."""
    rng = np.random.default_rng(SEED + n)
    root = 10.0 ** (spread * (rng.random(n) - 0.5))
    Q = np.linalg.qr(rng.standard_normal((n, n)))[0]
    values = np.concatenate([np.zeros(nullity), np.geomspace(softest, 1.0, n - nullity)])
    K = root[:, None] * ((Q * values) @ Q.T) * root
    return 0.5 * (K + K.T), Q[:, :nullity] / root[:, None]


@pytest.fixture
def null_vectors(factored):
    """Find null vectors beside R, and whether a factor of K + ρ R Rᵀ tells that there are some."""

    def find(K, kind, R=None):
        d, way = np.abs(K.diagonal()), "dense" if kind == "dense" else "pivots"
        again = partial(factored, K, rho=1.0, kind=way)
        Y = null_space(lambda X: K @ X, lambda known, shift: again(known, shift=shift), d, R)
        rho = float(d.mean())
        factor = factored(K, R, rho, kind=kind) or factored(K, R, rho, kind="pivots")
        return Y, factor_tells_singular(factor, d)

    return find


@every_size
@every_kind
@pytest.mark.parametrize("spread", [0.0, 3.0])
@pytest.mark.parametrize(("known", "unknown"), [(0, 0), (3, 0), (0, 2), (3, 3), (1, 14)])
def test_null_vectors_are_found(dense, kind, spread, known, unknown, null_vectors, monkeypatch):
    """All of them but those that are known, whatever the scales."""
    monkeypatch.setattr(nullspace, "ALL_VECTORS", dense)
    K, null = singular(50, known + unknown, spread)
    R = np.linalg.qr(null[:, :known])[0]
    Y, told = null_vectors(K, kind, R)
    agree(Y.shape == (50, unknown) and told == (unknown > 0), Y.shape)
    root = np.sqrt(np.abs(K.diagonal()))[:, None]
    both = np.linalg.qr(root * np.hstack([R, Y]))[0]
    expected = np.linalg.qr(root * null)[0]
    small(np.linalg.norm(expected - both @ (both.T @ expected)), 1e-6)


@every_kind
@pytest.mark.parametrize("softest", [1e-9, -1e-9])
def test_soft_and_buckling_modes_are_no_null_vectors(kind, softest, null_vectors):
    K, _ = singular(40, 0, 2.0, softest=abs(softest))
    if softest < 0.0:
        values, Q = np.linalg.eigh(K)
        K = K - 2.0 * values[0] * np.outer(Q[:, 0], Q[:, 0])
    Y, told = null_vectors(K, kind)
    agree(Y.shape[1] == 0 and not told)


def test_right_null_vectors_of_an_unsymmetric_matrix():
    rng = np.random.default_rng(SEED)
    K = rng.standard_normal((30, 28)) @ rng.standard_normal((28, 30))
    Y = null_space(lambda X: K @ X, None, np.abs(K.diagonal()))
    agree(Y.shape == (30, 2))
    small(np.abs(K @ Y).max(), 1e-10 * np.abs(K).max() * np.abs(Y).max())
