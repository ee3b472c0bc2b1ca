# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Factors of blocks, and null vectors computed with them, agree with dense algebra."""

from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from cases import each
from collective import COMM, agree, equal, small
from hand_torn import block_matrix, unsymmetric
from modes import factors_of

from dolfinx_feti.errors import FactorError
from dolfinx_feti.feti.setup import set_up_operator
from dolfinx_feti.feti.subdomain.factors import create
from dolfinx_feti.feti.subdomain.factors.cholesky import SINGLE_ROUNDING
from dolfinx_feti.feti.subdomain.factors.create import factor_dense, factor_dense_for_preconditioner
from dolfinx_feti.feti.subdomain.factors.multifrontal import FrontFactor, create_fronts, load_fronts
from dolfinx_feti.feti.subdomain.factors.packed import PackedMatrix
from dolfinx_feti.feti.subdomain.factors.petsc_factor import PetscFactor, factor_by_petsc
from dolfinx_feti.feti.subdomain.factors.petsc_solver import FactorOptions
from dolfinx_feti.feti.subdomain.factors.woodbury import factor_by_woodbury
from dolfinx_feti.feti.subdomain.factors.work_space import WorkSpace, pack
from dolfinx_feti.feti.subdomain.null_vectors import growth, is_numerically_singular
from dolfinx_feti.feti.subdomain.null_vectors import null_vectors as compute_null_vectors
from dolfinx_feti.feti.subsolver_options import DirectOptions
from dolfinx_feti.runtime.petsc_library import csr_of
from dolfinx_feti.runtime.petsc_options import inserted
from dolfinx_feti.torn.connectivity import block_graph

RHO = 3.0
SEED = 60221


def create_packed(S):
    """Return a matrix in packed format, with its own work space."""
    return PackedMatrix(pack(np.asfortranarray(S)), len(S), WorkSpace())


def block(n, smallest, scale=1.0):
    """Return a matrix and modes to regularise it with.

    Args:
        n: Order of the matrix.
        smallest: Its smallest eigenvalue, relative to the largest one.
        scale: Its largest eigenvalue.

    Returns:
        S in packed format, S as an array, (n, n), and orthonormal columns R, (n, k) with k ≤ 3.
    """
    rng = np.random.default_rng(n)
    Q = np.linalg.qr(rng.standard_normal((n, n)))[0]
    S = scale * (Q * np.geomspace(smallest, 1.0, n)) @ Q.T
    R = np.linalg.qr(rng.standard_normal((n, min(n, 3))))[0]
    return create_packed(S), S, R


@pytest.fixture
def factor_block(lifetime):
    """Return a function that factors K + ρ R Rᵀ + diag(shift) by one of the factorisations."""

    def create(K, R=None, rho=RHO, shift=None, *, kind="fronts", bs=1):
        rows = np.arange(len(K), dtype=np.int32)
        R = K[:, :0] if R is None else R
        if kind == "dense":
            return factor_dense(create_packed(K), R, rho, shift)
        if kind == "single":
            return factor_dense_for_preconditioner(create_packed(K), R, rho)
        M = lifetime.own(block_matrix([(K, K)], bs))
        if kind == "pivots":
            return lifetime.own(
                factor_by_petsc(
                    M, rows, FactorOptions(DirectOptions("some_"), True, 8), R, rho, shift
                )
            )
        with csr_of(M) as of_M:
            fronts = create_fronts(
                load_fronts(COMM), block_graph(of_M, bs), rows, rows, bs, rows[:0]
            )
            return factor_by_woodbury(fronts, of_M, R, rho, WorkSpace())

    return create


@pytest.mark.parametrize("shift", [40.0, 3.0], ids=["definite", "indefinite"])
def test_dense_factor_solves_and_counts_inertia(shift):
    """S_ρ S_ρ⁻¹ Y = Y; factors do not change S, and their memory is known."""
    n = 23
    rng = np.random.default_rng(31)
    A = rng.standard_normal((n, n))
    S = A + A.T + shift * np.eye(n)
    R = np.linalg.qr(rng.standard_normal((n, 3)))[0]
    matrix = create_packed(S)
    for columns in (R[:, :1], R, R[:, :0]):
        factor = factor_dense(matrix, columns, RHO)
        S_ρ = S + RHO * columns @ columns.T
        for Y in (rng.standard_normal(n), *(rng.standard_normal((n, k)) for k in (4, 9))):
            equal(S_ρ @ factor.solve(Y), Y, 1e-12)
            multiply = matrix.multiply if Y.ndim == 1 else matrix.multiply_many
            equal(multiply(Y), S @ Y, 1e-14)
        negative = np.count_nonzero(np.linalg.eigvalsh(S_ρ) < 0)
        assert (negative > 0) == (shift < 10.0)
        assert factor.inertia == (negative, 0)
        assert matrix.memory() == n * (n + 1) / 2 * 8 / 2**20
        assert factor.memory() == (n * n if negative else n * (n + 1) / 2) * 8 / 2**20


def test_empty_blocks_are_factored_and_singular_ones_refused():
    """Entries that are not finite are refused when a matrix is packed."""
    empty = create_packed(np.zeros((0, 0)))
    factor = factor_dense(empty, np.zeros((0, 0)), 1.0)
    assert factor.inertia == (0, 0) and factor.solve(np.zeros(0)).shape == (0,)
    assert factor.solve(np.zeros((0, 3))).shape == (0, 3)
    assert not is_numerically_singular(factor, np.zeros(0))
    assert factor_dense_for_preconditioner(empty, np.zeros((0, 0)), 1.0).inertia == (0, 0)
    indefinite, _, R = block(20, 1e-3)
    indefinite.values[0] = -1.0
    assert factor_dense_for_preconditioner(indefinite, R, RHO).inertia == (1, 0)
    with pytest.raises(FactorError, match="a zero pivot"):
        factor_dense(create_packed(np.diag([1.0, 2.0, 0.0, 3.0, 0.0])), np.zeros((5, 0)), 1.0)
    with pytest.raises(FactorError, match="NaN or Inf"):
        create_packed(np.full((2, 2), np.nan))


@pytest.mark.parametrize("scale", [1.0, 1e-60, 1e60])
@pytest.mark.parametrize("n", [1, 2, 40])
def test_single_precision_factor_is_accurate_to_its_rounding(n, scale):
    """The error is at most about ε cond(S_ρ), in any units, with half the memory."""
    matrix, S, R = block(n, 1e-3, scale)
    before = matrix.values.copy()
    rho = RHO * scale
    factor = factor_dense_for_preconditioner(matrix, R, rho)
    double = factor_dense(matrix, R, rho)
    S_ρ = S + rho * R @ R.T
    exact = np.linalg.inv(S_ρ)
    Y = np.random.default_rng(1).standard_normal((n, 5)) / scale
    bound = 10.0 * SINGLE_ROUNDING * np.linalg.cond(S_ρ)
    for y, solved in ((Y, factor.solve(Y)), (Y[:, 0], factor.solve(Y[:, 0]))):
        assert solved.dtype == np.float64
        assert np.linalg.norm(solved - exact @ y) <= bound * np.linalg.norm(exact @ y)
    np.testing.assert_array_equal(factor.solve(0.0 * Y), 0.0)
    np.testing.assert_array_equal(matrix.values, before)
    assert factor.inertia == (0, 0)
    assert factor.memory() == 0.5 * double.memory()
    factor.destroy()
    assert factor.memory() == 0.0


@pytest.mark.parametrize("kind", ["single", "dense", "indefinite", "fronts", "pivots"])
def test_destroyed_factor_raises(kind, factor_block):
    """For one right-hand side, several or none: freed memory is not read."""
    S = np.diag(np.r_[-1.0 if kind == "indefinite" else 1.0, np.ones(39)])
    factor = factor_block(S, kind="dense" if kind == "indefinite" else kind)
    shapes = [(40,), (40, 3), (40, 9), (40, 0)]
    for shape in shapes:
        np.testing.assert_array_equal(np.isfinite(factor.solve(np.ones(shape))), True)
    factor.destroy()
    factor.destroy()
    for shape in shapes:
        with pytest.raises(RuntimeError, match="has been destroyed"):
            factor.solve(np.ones(shape))


@pytest.mark.parametrize("smallest", [1e-1, 1e-3, 1e-5])
def test_growth_bounds_the_error_of_single_precision(smallest):
    """The error of a solve is at most about ε times the growth of random vectors in it."""
    matrix, S, R = block(60, smallest)
    factor = factor_dense_for_preconditioner(matrix, R, RHO)
    double = factor_dense(matrix, R, RHO)
    y = np.random.default_rng(2).standard_normal(60)
    error = np.linalg.norm(factor.solve(y) - double.solve(y)) / np.linalg.norm(double.solve(y))
    stiffest = np.linalg.norm(S + RHO * R @ R.T, 2) / S.diagonal().mean()
    assert error <= SINGLE_ROUNDING * stiffest * growth(factor, S.diagonal())


# ---- sparse regularised blocks, by fronts and with pivots ------------------------------------

SHAPE = (6, 5, 4)


def spring_grid(shape, seed=11):
    """Return the matrix of coupled grids of springs, (3 n, 3 n), and its null vectors, (3 n, 3)."""
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
def test_factor_is_the_inverse_of_the_regularised_block(change, kind, factor_block):
    """K_ρ K_ρ⁻¹ Y = Y for one column and several."""
    K, R = spring_grid(SHAPE)
    K = change(K, R)
    R = R[:, :0] if change is CHANGES["no modes"] else R
    K_ρ = K + RHO * R @ R.T
    tolerance = 1e2 * np.finfo(float).eps * np.linalg.cond(K_ρ)
    Y = np.random.default_rng(5).standard_normal((len(K), 4))
    factor = factor_block(K, R, kind=kind, bs=3)
    agree(factor.memory() > 0.0 and factor.inertia == (0, 0))
    X = factor.solve(Y)
    equal(K_ρ @ X, Y, tolerance)
    equal(factor.solve(Y[:, 1].copy()), X[:, 1], tolerance)


def test_inertia_of_an_indefinite_block_with_definite_K_Q(factor_block):
    """If K_Q is positive definite and K_ρ is not, the correction has the inertia of K_ρ."""
    K = 0.01 * spring_grid(SHAPE)[0] + np.eye(120 * 3)
    last = factor_block(K, bs=3).last_dofs
    others = np.setdiff1d(np.arange(len(K)), last)[: len(last)]
    K[last, last] -= 1.5
    R = np.zeros((len(K), len(last)))
    R[last, np.arange(len(last))] = 0.2
    R[others, np.arange(len(last))] = np.sqrt(1.0 - 0.2**2)
    factor = factor_block(K, R, bs=3)
    negative = int(np.count_nonzero(np.linalg.eigvalsh(K + RHO * R @ R.T) < 0.0))
    agree(factor.inertia == (negative, 0) and negative > 100)


def test_unconnected_block_is_factored_with_pivots(factor_block):
    """The last front does not determine the modes of both parts, so that fronts refuse it."""
    K, R = spring_grid((4, 3, 2))
    n = len(K)
    both = np.block([[K, np.zeros((n, n))], [np.zeros((n, n)), 2.0 * K]])
    modes = np.block([[R, np.zeros(R.shape)], [np.zeros(R.shape), R]])
    agree(factor_block(both, modes, bs=3) is None)
    factor = factor_block(both, modes, kind="pivots", bs=3)
    Y = np.ones((2 * n, 2))
    equal((both + RHO * modes @ modes.T) @ factor.solve(Y), Y, 1e-11)


@pytest.mark.parametrize(
    "image", [[-1.0, 1.0], [np.inf, 1.0], [np.nan, 1.0]], ids=["minus-one", "inf", "nan"]
)
def test_singular_woodbury_correction_is_refused(image):
    """Λ⁻¹ + Vᵀ Z is singular, or Inf, or NaN, with V = I and Λ = diag(1, −1)."""
    R = np.array([[1.0], [1.0]]) * np.sqrt(0.5)
    front = SimpleNamespace(solve=lambda V: np.linalg.solve(V.T, np.diag(image)))
    fronts = SimpleNamespace(
        last_dofs=np.array([1]), factor_sum=lambda *_: SimpleNamespace(factor=front)
    )
    agree(factor_by_woodbury(fronts, None, R, 1.0, None) is None)


@pytest.mark.parametrize("option", ["pc_factor_mat_solver_type", "pc_type"])
def test_option_selects_the_factorisation_of_regularised_blocks(option, torn_grid, create_dual):
    """Interior blocks have their own options, and keep their fronts."""
    with inserted("test_feti_local_", {option: {"pc_type": "cholesky"}.get(option, "mumps")}):
        system = create_dual(torn_grid((2, 2), (4, 3)).A, interior="keep")
    agree(all(isinstance(factor, PetscFactor) for factor in factors_of(system)))
    agree(all(isinstance(S.interior_factor, FrontFactor) for S in system.operator.by_subdomain))


def test_unsymmetric_matrices_are_factored_with_pivots(
    torn_grid, read_pattern, create_dual, lifetime, monkeypatch
):
    """So are matrices whose indices cannot be read in place."""
    read = read_pattern(torn_grid((2, 2), (4, 3), change=unsymmetric(0.01)).A)
    S = set_up_operator(read, lifetime)
    agree(all(isinstance(S_i.interior_factor, PetscFactor) for S_i in S.by_subdomain))
    monkeypatch.setattr(create, "reads_in_place", lambda: False)
    system = create_dual(torn_grid((2, 2), (4, 3)).A, interior="keep")
    agree(all(isinstance(factor, PetscFactor) for factor in factors_of(system)))


# ---- null vectors of random matrices --------------------------------------------------------

every_size = pytest.mark.parametrize(
    "max_dofs_for_svd", [1000, 10], ids=["all-vectors", "inverse-iteration"]
)
every_kind = pytest.mark.parametrize("kind", ["pivots", "fronts", "dense"])


def singular(n, nullity, spread, *, softest=1e-6):
    """Return a positive semi-definite matrix, and its null vectors.

    Args:
        n: Order of the matrix.
        nullity: Dimension of its null space.
        spread: Decades over which the scales of its rows are spread.
        softest: Smallest nonzero eigenvalue before the rows are scaled; the largest is one.

    Returns:
        The matrix, (n, n), and a basis of its null space, (n, nullity).
    """
    rng = np.random.default_rng(SEED + n)
    root = 10.0 ** (spread * (rng.random(n) - 0.5))
    Q = np.linalg.qr(rng.standard_normal((n, n)))[0]
    values = np.concatenate([np.zeros(nullity), np.geomspace(softest, 1.0, n - nullity)])
    K = root[:, None] * ((Q * values) @ Q.T) * root
    return 0.5 * (K + K.T), Q[:, :nullity] / root[:, None]


@pytest.fixture
def null_vectors(factor_block):
    """Return a function that finds null vectors other than R, and if K + ρ R Rᵀ is singular."""

    def find(K, kind, R=None):
        d = np.abs(K.diagonal())
        way = "dense" if kind == "dense" else "pivots"
        again = partial(factor_block, K, rho=1.0, kind=way)
        Y = compute_null_vectors(
            lambda X: K @ X, lambda known, shift: again(known, shift=shift), d, R
        )
        rho = float(d.mean())
        factor = factor_block(K, R, rho, kind=kind) or factor_block(K, R, rho, kind="pivots")
        return Y, is_numerically_singular(factor, d)

    return find


@every_size
@every_kind
@pytest.mark.parametrize("spread", [0.0, 3.0])
@pytest.mark.parametrize(("known", "unknown"), [(0, 0), (3, 0), (0, 2), (3, 3), (1, 14)])
def test_null_vectors_complete_the_null_space(
    max_dofs_for_svd, kind, spread, known, unknown, null_vectors, monkeypatch
):
    """With the known ones they span the null space, for any scales of the rows."""
    monkeypatch.setattr(
        "dolfinx_feti.feti.subdomain.null_vectors.MAX_DOFS_FOR_SVD", max_dofs_for_svd
    )
    K, null = singular(50, known + unknown, spread)
    R = np.linalg.qr(null[:, :known])[0]
    Y, is_singular = null_vectors(K, kind, R)
    agree(Y.shape == (50, unknown))
    agree(is_singular == (unknown > 0))
    root = np.sqrt(np.abs(K.diagonal()))[:, None]
    both = np.linalg.qr(root * np.hstack([R, Y]))[0]
    expected = np.linalg.qr(root * null)[0]
    small(np.linalg.norm(expected - both @ (both.T @ expected)), 1e-6)


@every_kind
@pytest.mark.parametrize("softest", [1e-9, -1e-9])
def test_soft_and_buckling_modes_are_not_null_vectors(kind, softest, null_vectors):
    """An eigenvalue of 1e-9 of either sign is well above rounding."""
    K, _ = singular(40, 0, 2.0, softest=abs(softest))
    if softest < 0.0:
        values, Q = np.linalg.eigh(K)
        K = K - 2.0 * values[0] * np.outer(Q[:, 0], Q[:, 0])
    Y, is_singular = null_vectors(K, kind)
    agree(Y.shape[1] == 0)
    agree(not is_singular)


@every_kind
@pytest.mark.parametrize("soft", [1e-11, 1e-10, 1e-9])
@pytest.mark.parametrize(("nullity", "soft_modes"), [(4, 6), (8, 8), (1, 20)])
def test_null_vectors_are_told_from_many_soft_modes(
    nullity, soft_modes, soft, kind, null_vectors, monkeypatch
):
    """Inverse iteration finds them alone, and all, beside any number of soft modes."""
    monkeypatch.setattr("dolfinx_feti.feti.subdomain.null_vectors.MAX_DOFS_FOR_SVD", 10)
    n = 80
    Q = np.linalg.qr(np.random.default_rng(SEED).standard_normal((n, n)))[0]
    values = np.ones(n)
    values[:nullity] = 0.0
    values[nullity : nullity + soft_modes] = soft
    Y, _ = null_vectors((Q * values) @ Q.T, kind)
    agree(Y.shape == (n, nullity))
    null = Q[:, :nullity]
    small(np.linalg.norm(Y - null @ (null.T @ Y)), 1e-3 * np.linalg.norm(Y))


def test_null_vectors_of_an_unsymmetric_matrix_are_the_right_ones():
    """K Y = 0, not Yᵀ K = 0."""
    rng = np.random.default_rng(SEED)
    K = rng.standard_normal((30, 28)) @ rng.standard_normal((28, 30))
    Y = compute_null_vectors(lambda X: K @ X, None, np.abs(K.diagonal()))
    agree(Y.shape == (30, 2))
    small(np.abs(K @ Y).max(), 1e-10 * np.abs(K).max() * np.abs(Y).max())
