# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The generalised inverse and the Schur complement of each subdomain agree with dense algebra."""

from types import SimpleNamespace

import numpy as np
import pytest
from cases import each, every_type
from collective import COMM, agree, equal, raises, small, whole
from hand_torn import scaled_diagonal
from modes import modes_of

from dolfinx_feti.errors import FactorError, SetUpError
from dolfinx_feti.feti.setup import set_up, to_double_precision
from dolfinx_feti.feti.subdomain import mode_search, scaled
from dolfinx_feti.feti.subdomain.analysis import is_worth_eliminating
from dolfinx_feti.feti.subdomain.factors import create
from dolfinx_feti.feti.subdomain.factors.multifrontal import FrontFactor

SEED = 271104


@pytest.fixture(autouse=True, params=["fronts", "pivots"])
def factorisation(request, monkeypatch):
    """Subdomains are factored by fronts, or with pivots."""
    if request.param == "pivots":
        monkeypatch.setattr(create, "multifrontal_code", lambda *_: None)
    return request.param


@pytest.fixture
def without_buckling_modes(monkeypatch):
    """No buckling modes join the kernels."""
    monkeypatch.setattr(mode_search, "MAX_BUCKLING_ROUNDS", 0)


def prestress(sizes, seed=SEED):
    """Return a change that adds random symmetric matrices of sizes relative to each K_i."""

    def change(K, dofs):
        rng = np.random.default_rng(seed)
        for K_i, size in zip(K, sizes, strict=True):
            half = np.where(K_i != 0.0, rng.standard_normal(K_i.shape), 0.0)
            K_i += size * np.abs(K_i).max() * (half + half.T)

    return change


CHANGES = {
    "none": None,
    "stiffening": scaled_diagonal(1.01),
    "softening": scaled_diagonal(0.99),
    "random": prestress((0.03, 0.0, -0.02, 0.04)),
    "strong": prestress((0.3, 0.5, 0.2, 0.4)),
    "tiny": prestress((1e-9, 1e-7, 1e-11, 0.0)),
    "of one subdomain": prestress((0.0, 1e-5, 0.0, 0.0)),
}


def free_blocks(problem, system):
    """Return the matrices K_i of this process without Dirichlet dofs, (n_i, n_i) each."""
    K = problem.K_torn
    start = system.torn.first_torn_dof
    return [K[np.ix_(start + S.dofs, start + S.dofs)] for S in system.inverse.by_subdomain]


@every_type
@pytest.mark.parametrize(("components", "soft"), [(1, 0), (2, 0), (2, 12)])
@each("change", CHANGES)
def test_identities_of_the_generalised_inverse_hold_for_any_matrix(
    change, components, soft, kind, torn_grid, create_dual, without_buckling_modes
):
    """RᵀE = I − D/ρ, K E = R D, and K⁺ is the inverse of K + ρ R Rᵀ, whose inertia is counted."""
    problem = torn_grid((2, 2), (2, 2), components=components, change=change)
    system = create_dual(problem.A, type=kind, coarse_modes=soft, coarse_threshold=1.0)
    modes_of_all = modes_of(system)
    agree((COMM.allreduce(sum(modes.n_soft for modes in system.modes)) > 0) == (soft > 0))
    y = np.random.default_rng(SEED + 2).standard_normal(system.torn.n)
    x = system.inverse.solve(y)
    agree(not x[system.pattern.is_fixed].any())
    errors = dict.fromkeys(("RᵀE = I − D/ρ", "K E = R D", "K_ρ K⁺ y = y", "D = Dᵀ"), 0.0)
    negative = 0
    for K, K_i in zip(free_blocks(problem, system), system.inverse.by_subdomain, strict=True):
        dofs = K_i.dofs
        R = np.hstack([K_i.modes.R, K_i.modes.Y])
        E = K_i.modes.E
        D = K_i.modes.D
        rho = K_i.modes.rho
        k = R.shape[1]
        scale = np.abs(K).max()
        K_ρ = K + rho * R @ R.T
        of_subdomain = {
            "RᵀE = I − D/ρ": R.T @ E - np.eye(k) + D / rho,
            "K E = R D": (K @ E - R @ D) / scale,
            "K_ρ K⁺ y = y": (K_ρ @ x[dofs] - y[dofs]) / np.abs(y).max(),
            "D = Dᵀ": (D - D.T) / rho,
        }
        for name, difference in of_subdomain.items():
            errors[name] = np.maximum(errors[name], np.abs(difference).max(initial=0.0))
        negative += np.count_nonzero(np.linalg.eigvalsh(K_ρ) < 0.0)
    agree(all(error <= 1e-10 for error in errors.values()), errors)
    agree(system.inverse.count_negative_eigenvalues() == negative)
    for modes in system.modes:
        agree(modes.is_exact == (np.abs(modes.D).max(initial=0.0) == 0.0))
    if change is None and not soft:
        agree(all(modes_of_all.is_exact))
    if change is CHANGES["of one subdomain"] and kind == "all_floating" and not soft:
        equal(whole(np.array(modes_of_all.is_exact)), [True, False, True, True])


def crushed(K, dofs):
    """Give the last dof of each subdomain a negative stiffness far larger than any other."""
    for K_i in K:
        K_i[-1, -1] -= 30.0 * np.abs(K_i).max()


@every_type
@each("change", {"crushed": crushed, **{name: CHANGES[name] for name in ("softening", "random")}})
def test_buckling_modes_join_the_kernel(change, kind, torn_grid, create_dual, monkeypatch):
    """With its negative eigenvectors in R, K_ρ is positive definite, and identities still hold.

    K E = R D means Eᵀ K E = D − D²/ρ with whatever columns R has got, and whatever ρ they need. K +
    Z Zᵀ has no negative eigenvalue, K has.
    """
    problem = torn_grid((2, 2), (2, 2), components=2, change=change)
    with monkeypatch.context() as patch:
        patch.setattr(mode_search, "MAX_BUCKLING_ROUNDS", 0)
        plain = create_dual(problem.A, type=kind)
    system = create_dual(problem.A, type=kind)
    modes_of_all = modes_of(system)
    negative_before = COMM.allreduce(plain.inverse.count_negative_eigenvalues())
    negative_after = COMM.allreduce(system.inverse.count_negative_eigenvalues())
    agree((negative_before > 0) == (change is not CHANGES["softening"]))
    agree(negative_after == 0)
    wider = whole(modes_of_all.dimensions) - whole(modes_of(plain).dimensions)
    agree(wider.min() >= 0 and wider.sum() >= negative_before)
    errors = [0.0]
    lowest = [np.inf]
    stabilised = [np.inf]
    for K, modes in zip(free_blocks(problem, system), system.modes, strict=True):
        E = modes.E
        D = modes.D
        rho = modes.rho
        Z = modes.stabilisation
        scale = np.abs(K).max()
        errors.append(np.abs(E.T @ K @ E - D + D @ D / rho).max(initial=0.0) / scale)
        lowest.append(np.linalg.eigvalsh(K)[0] / scale)
        stabilised.append(np.linalg.eigvalsh(K + Z @ Z.T)[0] / scale)
    small(np.max(errors), 1e-10)
    agree(np.min(stabilised) > -1e-13, stabilised)
    agree(COMM.allreduce(np.min(lowest), op=min) < -1e-3, lowest)
    counted = COMM.allreduce(modes_of_all.negative_defects)
    exactly = (change, kind) == (CHANGES["softening"], "all_floating")
    if exactly:
        agree(counted == 12)
    else:
        agree(counted > 0)


def test_zero_pivot_after_buckling_modes_is_an_error(torn_grid, create_dual, monkeypatch):
    """The factorisation of K_ρ fails once the modes have joined; the set-up reports it."""
    factor = scaled.ScaledMatrix.factor
    width = {}

    def stop(K, R, *more):
        if R.shape[1] > width.setdefault(K.matrix.subdomain.number, R.shape[1]):
            raise FactorError("a zero pivot")
        return factor(K, R, *more)

    monkeypatch.setattr(scaled.ScaledMatrix, "factor", stop)
    problem = torn_grid((2, 2), (2, 2), components=2, change=CHANGES["random"])
    with raises(SetUpError, "subdomain .*a zero pivot"):
        create_dual(problem.A)


def test_zero_pivot_in_a_solve_starts_the_search_for_null_vectors(
    torn_grid, create_dual, monkeypatch
):
    """So does one in the factor; a regular subdomain has no null vectors."""
    is_singular = scaled.is_numerically_singular
    asked = set()

    def stop(factor, d, *most):
        if d.tobytes() not in asked:
            asked.add(d.tobytes())
            raise FactorError("a zero pivot")
        return is_singular(factor, d, *most)

    monkeypatch.setattr(scaled, "is_numerically_singular", stop)
    modes_of_all = modes_of(create_dual(torn_grid((2, 2), (2, 2), components=2).A))
    agree(all(modes_of_all.is_exact) and bool(asked) == bool(modes_of_all.is_exact))


@pytest.mark.parametrize("tie_stiffness", [0.0, 1e9], ids=["even", "stiff-tie"])
def test_single_precision_factors_are_used_for_preconditioning_only(
    tie_stiffness, torn_grid, read_pattern, lifetime
):
    """With a stiff tie they are in double precision, as single would round the rest away."""

    def add_tie(K, dofs):
        for K_i in K:
            K_i[:2, :2] += tie_stiffness * np.abs(K_i).max() * np.array([[1.0, -1.0], [-1.0, 1.0]])

    problem = torn_grid((2, 2), (2, 2), components=2, change=add_tie)
    read = read_pattern(problem.A, interior="eliminate")
    single_setup = set_up(read, lifetime, lifetime, is_primal=True)
    single = {K_i.factor.is_single_precision for K_i in single_setup.inverse.by_subdomain}
    agree(single <= {not tie_stiffness})
    y = np.random.default_rng(SEED + 5).standard_normal(read.torn.n)
    approximate = single_setup.inverse.solve(y)
    double_setup = to_double_precision(read, single_setup, lifetime)
    agree(not any(K_i.factor.is_single_precision for K_i in double_setup.inverse.by_subdomain))
    agree(to_double_precision(read, double_setup, lifetime) is double_setup)
    exact = double_setup.inverse.solve(y)
    small(np.abs(approximate - exact).max(initial=0.0) / np.abs(exact).max(initial=1.0), 1e-4)


# ---- the Schur complement -------------------------------------------------------------------

INDEFINITE = scaled_diagonal(0.5)
DIAGONAL = ("none", "stiffening", "softening")


def dense_schur_complement(K, Γ):
    """Return K_ΓΓ − K_ΓI K_II⁻¹ K_IΓ, (n_Γ, n_Γ)."""
    I = np.setdiff1d(np.arange(len(K)), Γ)  # noqa: E741
    return K[np.ix_(Γ, Γ)] - K[np.ix_(Γ, I)] @ np.linalg.solve(K[np.ix_(I, I)], K[np.ix_(I, Γ)])


@every_type
@each("change", {"indefinite": INDEFINITE, **{name: CHANGES[name] for name in DIAGONAL}})
def test_schur_complement_agrees_with_dense_elimination(
    kind, change, factorisation, torn_grid, create_dual
):
    """S by all ways, S u_Γ = f̂ with K u = f inside, and the inertia of K_II."""
    problem = torn_grid((2, 2), (6, 5), components=2, change=change)
    system = create_dual(problem.A, type=kind, interior="eliminate")
    torn = system.torn
    operator = system.operator
    fixed = system.pattern.is_fixed
    fronts = [isinstance(S.interior_factor, FrontFactor) for S in operator.by_subdomain]
    expected = factorisation == "fronts" and change is not INDEFINITE
    agree(set(fronts) == {expected}, fronts)
    K = problem.K_torn[
        torn.first_torn_dof : torn.first_torn_dof + torn.n,
        torn.first_torn_dof : torn.first_torn_dof + torn.n,
    ]
    f = np.where(fixed, 0.0, np.random.default_rng(SEED).standard_normal(torn.n))
    condensed = operator.interface_load(f)
    errors = dict.fromkeys(("S u_Γ", "u on Γ", "K u = f inside", "K u = f + reaction on Γ"), 0.0)
    negative = 0
    for S_i in operator.by_subdomain:
        Γ = S_i.subdomain.interface
        free = S_i.subdomain.free_dofs
        inside = np.setdiff1d(free, Γ)
        negative += np.count_nonzero(np.linalg.eigvalsh(K[np.ix_(inside, inside)]) < 0.0)
        S = dense_schur_complement(K[np.ix_(free, free)], np.searchsorted(free, Γ))
        t = np.zeros(torn.n)
        t[Γ] = np.random.default_rng(SEED + 1).standard_normal(len(Γ))
        u = operator.extend(t, f)
        reaction = torn.multiply(u)[Γ] - f[Γ]
        of_subdomain = {
            "S u_Γ": (operator.multiply(t)[Γ] - S @ t[Γ]) / np.abs(S).max(),
            "u on Γ": u[Γ] - t[Γ],
            "K u = f inside": torn.multiply(u)[inside] - f[inside],
            "K u = f + reaction on Γ": (S @ t[Γ] - condensed[Γ] - reaction) / np.abs(S).max(),
        }
        for name, difference in of_subdomain.items():
            errors[name] = np.maximum(errors[name], np.abs(difference).max(initial=0.0))
    tolerance = 1e-10 if change is INDEFINITE else 1e-11
    agree(all(error <= tolerance for error in errors.values()), errors)
    agree(
        operator.count_negative_interior_eigenvalues() == negative
        and (negative > 0) == (change is INDEFINITE)
    )
    agree(
        np.all(
            condensed[np.setdiff1d(np.arange(torn.n), np.concatenate(operator.interfaces))] == 0.0
        )
    )


@pytest.mark.parametrize(
    ("n", "on_interface", "condensed", "worth"),
    [
        (45, 42, False, True),
        (3300, 950, False, True),
        (1300, 700, False, False),
        (1300, 700, True, True),
        (8900, 2300, True, False),
    ],
    ids=["small", "part-of-a-thin-wall", "compact", "compact-with-a-pressure", "large"],
)
def test_interior_is_eliminated_where_it_pays(n, on_interface, condensed, worth):
    """Dense blocks for thin walls, small subdomains, and condensed pressures; not if too large."""
    subdomain = SimpleNamespace(free_dofs=np.arange(n), interface=np.arange(on_interface))
    torn = SimpleNamespace(comm=COMM, n_condensed_pressures=object() if condensed else None)
    agree(is_worth_eliminating(torn, [subdomain] * 2) == worth)
