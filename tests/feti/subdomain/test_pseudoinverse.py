# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The generalised inverse: K K⁺ K = K without prestress, the exact algebra with it."""

import numpy as np
import pytest
from cases import each, every_type
from collective import COMM, agree, equal, raises, small, whole
from hand_torn import scaled_diagonal
from modes import modes_of

from dolfinx_feti.errors import FactorError, SetUpError
from dolfinx_feti.feti.setup import refined, set_up
from dolfinx_feti.feti.subdomain import analysis, pseudoinverse
from dolfinx_feti.feti.subdomain.modes import kernel_basis

SEED = 271104


@pytest.fixture(autouse=True, params=["fronts", "pivots"])
def way(request, monkeypatch):
    """Subdomains are factored by fronts, or with pivots."""
    if request.param == "pivots":
        monkeypatch.setattr(analysis, "load_fronts_for", lambda *_: None)


@pytest.fixture
def unenriched(monkeypatch):
    """No buckling modes join the kernels."""
    monkeypatch.setattr(pseudoinverse, "ENRICHMENTS", 0)


def prestress(sizes, seed=SEED):
    """A change that adds symmetric matrices of these sizes, relative to K, to the subdomains."""

    def change(K, dofs):
        rng = np.random.default_rng(seed)
        for K_i, size in zip(K, sizes, strict=True):
            half = rng.standard_normal(K_i.shape) * (K_i != 0.0)
            K_i += size * np.abs(K_i).max() * (half + half.T)

    return change


CHANGES = {
    "none": None,
    "stiffening": scaled_diagonal(1.01),
    "softening": scaled_diagonal(0.99),
    "random": prestress((0.03, 0.0, -0.02, 0.04)),
    "tiny": prestress((1e-9, 1e-7, 1e-11, 0.0)),
}


def modes(system):
    """Orthonormal candidates of each subdomain on its free dofs."""
    torn, near = system.torn, system.torn.near_kernel()
    return [kernel_basis(near[rows], system.pattern.dofs.fixed[rows]) for rows in torn.subdomains]


def blocks(problem, system):
    """Local matrices of this process on the free dofs."""
    K, start = problem.K_torn, system.torn.start
    return [K[np.ix_(start + dofs, start + dofs)] for dofs in system.operator.dofs]


@every_type
@pytest.mark.parametrize("components", [1, 2])
def test_generalised_inverse_solves_balanced_problems(components, kind, torn_grid, parts):
    """K K⁺ K = K and K R = 0."""
    problem = torn_grid((2, 2), (3, 2), components=components)
    system = parts(problem.A, type=kind)
    torn, fixed, found = system.torn, system.pattern.dofs.fixed, modes_of(system)
    x = np.where(fixed, 0.0, np.random.default_rng(SEED).standard_normal(torn.n))
    Kx = np.where(fixed, 0.0, torn.multiply(x))
    back = system.inverse.solve(Kx)
    equal(whole(back[fixed]), np.zeros(len(whole(back[fixed]))))
    again = np.where(fixed, 0.0, torn.multiply(back))
    equal(whole(again), whole(Kx), 1e-11)
    pairs = zip(blocks(problem, system), found.E, strict=True)
    error = max((np.abs(K @ E).max(initial=0.0) for K, E in pairs), default=0.0)
    small(error, 1e-12 * np.abs(problem.K_torn).max())
    agree(all(found.exact) and all(np.all(D == 0.0) for D in found.D))


@every_type
@each("change", CHANGES)
def test_algebra_is_exact_for_any_matrix(change, kind, torn_grid, parts, unenriched):
    """E and D satisfy RᵀE = I − D/ρ and K E = R D, and K⁺ that of K + ρ R Rᵀ."""
    problem = torn_grid((2, 2), (2, 2), components=2, change=change)
    system = parts(problem.A, type=kind)
    found = modes_of(system)
    y = np.random.default_rng(SEED + 2).standard_normal(system.torn.n)
    x = system.inverse.solve(y)
    of_modes = zip(modes(system), found.E, found.D, found.rho, strict=True)
    errors = [0.0]
    for K, dofs, (R, E, D, rho) in zip(
        blocks(problem, system), system.operator.dofs, of_modes, strict=True
    ):
        k, scale = R.shape[1], np.abs(K).max()
        errors += [
            np.abs(R.T @ E - np.eye(k) + D / rho).max(initial=0.0),
            np.abs(K @ E - R @ D).max(initial=0.0) / scale,
            np.abs((K + rho * R @ R.T) @ x[dofs] - y[dofs]).max() / np.abs(y).max(),
            np.abs(D - D.T).max(initial=0.0) / rho,
        ]
    small(max(errors), 1e-10)
    defects = [np.abs(D).max(initial=0.0) for D in found.D]
    agree(all(exact == (defect == 0.0) for exact, defect in zip(found.exact, defects, strict=True)))
    if change is None:
        agree(all(found.exact))


def test_defect_is_there_as_soon_as_the_modes_leave_the_kernel(torn_grid, parts):
    """Only the changed subdomain is not exact; its defect is RᵀK R up to second order."""
    problem = torn_grid((2, 2), (2, 2), components=2, change=prestress((0.0, 1e-5, 0.0, 0.0)))
    system = parts(problem.A)
    found = modes_of(system)
    equal(whole(np.array(found.exact)), [True, False, True, True])
    for K, R, D, exact in zip(
        blocks(problem, system), modes(system), found.D, found.exact, strict=True
    ):
        size = np.abs(D).max()
        assert exact or 1e3 * np.abs(D - R.T @ K @ R).max() < size > 1e-7 * np.abs(K).max()


@each("change", CHANGES | {"strong": prestress((0.3, 0.5, 0.2, 0.4))})
def test_negative_eigenvalues_are_counted(change, torn_grid, parts, unenriched):
    """The factor's inertia against a dense eigensolver."""
    problem = torn_grid((2, 2), (2, 3), components=2, change=change)
    system = parts(problem.A)
    expected = sum(
        np.count_nonzero(np.linalg.eigvalsh(K + rho * R @ R.T) < 0.0)
        for K, R, rho in zip(
            blocks(problem, system), modes(system), modes_of(system).rho, strict=True
        )
    )
    agree(system.inverse.negative() == expected, (system.inverse.negative(), expected))


def crushed(K, dofs):
    """One dof of each subdomain has a negative stiffness far larger than any other is."""
    for K_i in K:
        K_i[-1, -1] -= 30.0 * np.abs(K_i).max()


@every_type
@each("change", {"random": CHANGES["random"], "crushed": crushed})
def test_buckling_modes_join_the_kernel(change, kind, torn_grid, parts, monkeypatch):
    """Enriched by its negative eigenvectors K_ρ is positive definite, and the algebra stays exact.

    K E = R D means Eᵀ K E = D − D²/ρ with whatever columns R has got, and whatever ρ they need.
    """
    problem = torn_grid((2, 2), (2, 2), components=2, change=change)
    with monkeypatch.context() as patch:
        patch.setattr(pseudoinverse, "ENRICHMENTS", 0)
        plain = parts(problem.A, type=kind)
    system = parts(problem.A, type=kind)
    found = modes_of(system)
    total = whole(np.array([plain.inverse.negative(), system.inverse.negative()]))
    agree(total[::2].sum() > 0 and total[1::2].sum() == 0, total)
    wider = whole(found.dimensions) - whole(modes_of(plain).dimensions)
    agree(wider.min() >= 0 and wider.sum() >= total[::2].sum(), wider)
    errors = [0.0]
    for K, E, D, rho in zip(blocks(problem, system), found.E, found.D, found.rho, strict=True):
        errors.append(np.abs(E.T @ K @ E - D + D @ D / rho).max(initial=0.0) / np.abs(K).max())
    small(max(errors), 1e-10)


def test_zero_pivot_of_buckling_modes_is_an_error(torn_grid, parts, monkeypatch):
    """A solver that stops where they join the kernel has no factor of K_ρ, and says so."""
    factor, width = pseudoinverse._Block.factor, {}

    def stop(K, R, *more):
        if R.shape[1] > width.setdefault(K.i, R.shape[1]):
            raise FactorError("a zero pivot")
        return factor(K, R, *more)

    monkeypatch.setattr(pseudoinverse._Block, "factor", stop)
    problem = torn_grid((2, 2), (2, 2), components=2, change=CHANGES["random"])
    with raises(SetUpError, "subdomain .*a zero pivot"):
        parts(problem.A)


def test_zero_pivot_found_by_a_solve_asks_for_null_vectors(torn_grid, parts, monkeypatch):
    """As one in the factor; a regular subdomain has none."""
    tells_singular, asked = pseudoinverse.factor_tells_singular, set()

    def stop(factor, d):
        if d.tobytes() not in asked:
            asked.add(d.tobytes())
            raise FactorError("a zero pivot")
        return tells_singular(factor, d)

    monkeypatch.setattr(pseudoinverse, "factor_tells_singular", stop)
    found = modes_of(parts(torn_grid((2, 2), (2, 2), components=2).A))
    agree(all(found.exact) and bool(asked) == bool(found.exact))


@every_type
@pytest.mark.parametrize("change", ["softening", "random"])
def test_what_buckles_is_stabilised(change, kind, torn_grid, parts):
    """K + Z Zᵀ has no negative eigenvalue, K has."""
    problem = torn_grid((2, 2), (2, 2), components=2, change=CHANGES[change])
    system = parts(problem.A, type=kind)
    counted = COMM.allreduce(modes_of(system).negative_defects)
    agree(counted == 12 if (change, kind) == ("softening", "all_floating") else counted > 0)
    lowest = {1.0: np.inf, 0.0: np.inf}
    for K, Z in zip(blocks(problem, system), modes_of(system).stabilisation, strict=True):
        for share in lowest:
            value = np.linalg.eigvalsh(K + share * Z @ Z.T)[0] / np.abs(K).max()
            lowest[share] = min(lowest[share], value)
    agree(lowest[1.0] > -1e-13, lowest)
    agree(COMM.allreduce(lowest[0.0], op=min) < -1e-3, lowest)


@pytest.mark.parametrize("stiff", [0.0, 1e9], ids=["even", "stiff"])
def test_rough_factors_only_where_they_precondition(stiff, torn_grid, pattern, lifetime):
    """Single precision, but double where a stiff tie would have it round the rest away."""

    def tie(K, dofs):
        for K_i in K:
            K_i[:2, :2] += stiff * np.abs(K_i).max() * np.array([[1.0, -1.0], [-1.0, 1.0]])

    problem = torn_grid((2, 2), (2, 2), components=2, change=tie)
    read = pattern(problem.A, interior="eliminate")
    rough = set_up(read, lifetime, lifetime, rough=True)
    single = {factor.single for factor in rough.inverse.factors}
    agree(single <= {not stiff}, single)
    y = np.random.default_rng(SEED + 5).standard_normal(read.torn.n)
    approximate = rough.inverse.solve(y)
    fine = refined(read, rough, lifetime)
    agree(not any(factor.single for factor in fine.inverse.factors))
    agree(refined(read, fine, lifetime) is fine)
    exact = fine.inverse.solve(y)
    small(np.abs(approximate - exact).max(initial=0.0) / np.abs(exact).max(initial=1.0), 1e-4)
