# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The generalised inverse and the Schur complement of each subdomain, against dense algebra."""

from types import SimpleNamespace

import numpy as np
import pytest
from cases import each, every_type
from collective import COMM, agree, equal, raises, small, whole
from hand_torn import scaled_diagonal
from modes import modes_of

from dolfinx_feti.errors import FactorError, SetUpError
from dolfinx_feti.feti.setup import refined, set_up
from dolfinx_feti.feti.subdomain import analysis, pseudoinverse
from dolfinx_feti.feti.subdomain.analysis import worth_eliminating
from dolfinx_feti.feti.subdomain.factors.multifrontal import FrontFactor

SEED = 271104


@pytest.fixture(autouse=True, params=["fronts", "pivots"])
def way(request, monkeypatch):
    """Subdomains are factored by fronts, or with pivots."""
    if request.param == "pivots":
        monkeypatch.setattr(analysis, "load_fronts_for", lambda *_: None)
    return request.param


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
    "strong": prestress((0.3, 0.5, 0.2, 0.4)),
    "tiny": prestress((1e-9, 1e-7, 1e-11, 0.0)),
    "of one subdomain": prestress((0.0, 1e-5, 0.0, 0.0)),
}


def blocks(problem, system):
    """Local matrices of this process on the free dofs."""
    K, start = problem.K_torn, system.torn.start
    return [K[np.ix_(start + dofs, start + dofs)] for dofs in system.operator.dofs]


@every_type
@pytest.mark.parametrize(("components", "soft"), [(1, 0), (2, 0), (2, 12)])
@each("change", CHANGES)
def test_algebra_is_exact_for_any_matrix(
    change, components, soft, kind, torn_grid, parts, unenriched
):
    """RᵀE = I − D/ρ, K E = R D, and K⁺ is the inverse of K + ρ R Rᵀ, whose inertia is counted."""
    problem = torn_grid((2, 2), (2, 2), components=components, change=change)
    system = parts(problem.A, type=kind, coarse_modes=soft, coarse_threshold=1.0)
    found = modes_of(system)
    agree((COMM.allreduce(sum(modes.soft for modes in system.modes)) > 0) == (soft > 0))
    y = np.random.default_rng(SEED + 2).standard_normal(system.torn.n)
    x = system.inverse.solve(y)
    agree(not x[system.pattern.dofs.fixed].any())
    of_modes = zip(found.R, found.E, found.D, found.rho, strict=True)
    errors, negative = [0.0], 0
    for K, dofs, (R, E, D, rho) in zip(
        blocks(problem, system), system.operator.dofs, of_modes, strict=True
    ):
        k, scale, K_ρ = R.shape[1], np.abs(K).max(), K + rho * R @ R.T
        errors += [
            np.abs(R.T @ E - np.eye(k) + D / rho).max(initial=0.0),
            np.abs(K @ E - R @ D).max(initial=0.0) / scale,
            np.abs(K_ρ @ x[dofs] - y[dofs]).max() / np.abs(y).max(),
            np.abs(D - D.T).max(initial=0.0) / rho,
        ]
        negative += np.count_nonzero(np.linalg.eigvalsh(K_ρ) < 0.0)
    small(max(errors), 1e-10)
    agree(system.inverse.negative() == negative, (system.inverse.negative(), negative))
    defects = [np.abs(D).max(initial=0.0) for D in found.D]
    agree(all(exact == (defect == 0.0) for exact, defect in zip(found.exact, defects, strict=True)))
    if change is None and not soft:
        agree(all(found.exact))
    if change is CHANGES["of one subdomain"] and kind == "all_floating" and not soft:
        equal(whole(np.array(found.exact)), [True, False, True, True])


def crushed(K, dofs):
    """One dof of each subdomain has a negative stiffness far larger than any other is."""
    for K_i in K:
        K_i[-1, -1] -= 30.0 * np.abs(K_i).max()


@every_type
@each("change", {"crushed": crushed, **{name: CHANGES[name] for name in ("softening", "random")}})
def test_buckling_modes_join_the_kernel(change, kind, torn_grid, parts, monkeypatch):
    """Enriched by its negative eigenvectors K_ρ is positive definite, and the algebra stays exact.

    K E = R D means Eᵀ K E = D − D²/ρ with whatever columns R has got, and whatever ρ they need.
    K + Z Zᵀ has no negative eigenvalue, K has.
    """
    problem = torn_grid((2, 2), (2, 2), components=2, change=change)
    with monkeypatch.context() as patch:
        patch.setattr(pseudoinverse, "ENRICHMENTS", 0)
        plain = parts(problem.A, type=kind)
    system = parts(problem.A, type=kind)
    found = modes_of(system)
    total = whole(np.array([plain.inverse.negative(), system.inverse.negative()]))
    agree(total[::2].any() == (change is not CHANGES["softening"]) and not total[1::2].any(), total)
    wider = whole(found.dimensions) - whole(modes_of(plain).dimensions)
    agree(wider.min() >= 0 and wider.sum() >= total[::2].sum(), wider)
    errors, lowest, stabilised = [0.0], [np.inf], [np.inf]
    of_modes = zip(found.E, found.D, found.rho, found.stabilisation, strict=True)
    for K, (E, D, rho, Z) in zip(blocks(problem, system), of_modes, strict=True):
        scale = np.abs(K).max()
        errors.append(np.abs(E.T @ K @ E - D + D @ D / rho).max(initial=0.0) / scale)
        lowest.append(np.linalg.eigvalsh(K)[0] / scale)
        stabilised.append(np.linalg.eigvalsh(K + Z @ Z.T)[0] / scale)
    small(max(errors), 1e-10)
    agree(min(stabilised) > -1e-13 and COMM.allreduce(min(lowest), op=min) < -1e-3, stabilised)
    counted = COMM.allreduce(found.negative_defects)
    exactly = (change, kind) == (CHANGES["softening"], "all_floating")
    agree(counted == 12 if exactly else counted > 0, counted)


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


# ---- the Schur complement -------------------------------------------------------------------

INDEFINITE, DIAGONAL = scaled_diagonal(0.5), ("none", "stiffening", "softening")


def complement(K, Γ):
    I = np.setdiff1d(np.arange(len(K)), Γ)  # noqa: E741
    return K[np.ix_(Γ, Γ)] - K[np.ix_(Γ, I)] @ np.linalg.solve(K[np.ix_(I, I)], K[np.ix_(I, Γ)])


@every_type
@each("change", {"indefinite": INDEFINITE, **{name: CHANGES[name] for name in DIAGONAL}})
def test_elimination_is_exact(kind, change, way, torn_grid, parts):
    """S by all ways, S u_Γ = f̂ with K u = f inside, and the inertia of K_II."""
    problem = torn_grid((2, 2), (6, 5), components=2, change=change)
    system = parts(problem.A, type=kind, interior="eliminate")
    torn, operator, fixed = system.torn, system.operator, system.pattern.dofs.fixed
    fronts = [isinstance(factor, FrontFactor) for factor in operator.interior_factors]
    agree(not any(fronts) if way == "pivots" or change is INDEFINITE else all(fronts))
    K = problem.K_torn[torn.start : torn.start + torn.n, torn.start : torn.start + torn.n]
    f = np.where(fixed, 0.0, np.random.default_rng(SEED).standard_normal(torn.n))
    condensed = operator.condense(f)
    errors, negative = [0.0], 0
    for rows, Γ in zip(torn.subdomains, operator.dofs, strict=True):
        free = rows[~fixed[rows]]
        inside = np.setdiff1d(free, Γ)
        negative += np.count_nonzero(np.linalg.eigvalsh(K[np.ix_(inside, inside)]) < 0.0)
        S = complement(K[np.ix_(free, free)], np.searchsorted(free, Γ))
        t = np.zeros(torn.n)
        t[Γ] = np.random.default_rng(SEED + 1).standard_normal(len(Γ))
        errors.append(np.abs(operator.multiply(t)[Γ] - S @ t[Γ]).max() / np.abs(S).max())
        u = operator.extend(t, f)
        errors.append(np.abs(u[Γ] - t[Γ]).max())
        errors.append(np.abs(torn.multiply(u)[inside] - f[inside]).max(initial=0.0))
        reaction = torn.multiply(u)[Γ] - f[Γ]
        errors.append(np.abs(S @ t[Γ] - condensed[Γ] - reaction).max() / np.abs(S).max())
    small(max(errors), 1e-10 if change is INDEFINITE else 1e-11)
    agree(operator.negative_interior() == negative and (negative > 0) == (change is INDEFINITE))
    agree(np.all(condensed[np.setdiff1d(np.arange(torn.n), np.concatenate(operator.dofs))] == 0.0))


@pytest.mark.parametrize(
    ("n", "on_interface", "condensed", "worth"),
    [
        (45, 42, False, True),
        (3300, 950, False, True),
        (1300, 700, False, False),
        (1300, 700, True, True),
        (8900, 2300, True, False),
    ],
    ids=["small", "part of a thin wall", "compact", "compact, with a pressure", "large"],
)
def test_choice(n, on_interface, condensed, worth):
    """Dense blocks for thin walls, small subdomains, and condensed pressures; not if too large."""
    dofs = SimpleNamespace(free=[np.arange(n)] * 2, interface=[np.arange(on_interface)] * 2)
    torn = SimpleNamespace(comm=COMM, pressures=object() if condensed else None)
    agree(worth_eliminating(torn, dofs) == worth)
