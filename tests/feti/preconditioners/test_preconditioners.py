# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The dual operator and its preconditioners agree with dense formulas."""

from types import SimpleNamespace

import numpy as np
import pytest
from cases import case, each, every_interior, every_q, every_type
from collective import COMM, agree, dense, equal, matrix_of_map, random_part, small, whole
from hand_torn import scaled_diagonal
from modes import modes_of, on_torn_dofs

from dolfinx_feti.feti.coarse.weighted_columns import compute_weighted_columns
from dolfinx_feti.feti.dual import system
from dolfinx_feti.feti.dual.krylov import RATIO_MARGIN, ResidualEstimate, StoppingTest
from dolfinx_feti.feti.dual.system import DualSystem, DualUnknowns
from dolfinx_feti.feti.preconditioners.registry import PRECONDITIONERS

PROBLEMS = {
    "elasticity": case((2, 2), (2, 3), 2),
    "one cell each": case((2, 2, 2), (1, 1, 1), 3),
    "Laplace": case((3,), (4,)),
    "no interior": case((3, 1), (1, 1), 2, fixed=lambda x: np.isin(x[:, 0], (0.0, 3.0))),
}
BUCKLING = scaled_diagonal(0.98)  # the kernel of each subdomain becomes negative
every_problem = each("grid", PROBLEMS)
every_state = each("change", {"at rest": None, "buckling": BUCKLING})
every_pc = pytest.mark.parametrize("pc_type", PRECONDITIONERS)


def dense_weight(problem, formulation, pc_type):
    """Return Y of a preconditioner by its definition, on all torn dofs, (n, n)."""
    K = problem.K_torn
    Z = on_torn_dofs(formulation, modes_of(formulation).stabilisation)
    fixed = whole(formulation.pattern.is_fixed)
    glued = np.any(dense(formulation.pattern.gluing.B) != 0.0, axis=0)
    if pc_type == "identity":
        return np.abs(np.diag(K)[glued]).mean() * np.eye(len(K)) + Z @ Z.T
    if pc_type == "lumped":
        return K + Z @ Z.T
    Y = np.zeros_like(K)
    inside = ~fixed & ~glued
    glued &= ~fixed
    K_II = K[np.ix_(inside, inside)]
    K_ΓI = K[np.ix_(glued, inside)]
    X = np.linalg.solve(K_II, np.hstack([K[np.ix_(inside, glued)], Z[inside]]))
    S, Y_Z = np.split(np.hstack([K[np.ix_(glued, glued)], Z[glued]]) - K_ΓI @ X, [glued.sum()], 1)
    C2 = np.eye(Z.shape[1]) + Z[inside].T @ X[:, glued.sum() :]
    Y[np.ix_(glued, glued)] = S + Y_Z @ np.linalg.solve((C2 + C2.T) / 2, Y_Z.T)
    return Y


def dense_preconditioner(formulation):
    """Return M as a dense matrix, (m, m), on each process."""
    return matrix_of_map(lambda r: formulation.preconditioner.apply(r)[0], formulation.system.m)


@every_problem
@every_type
@every_pc
@every_state
@every_interior
def test_preconditioner_agrees_with_its_definition(
    grid, kind, pc_type, change, interior, torn_grid, create_dual
):
    """M = B_D Y B_Dᵀ is semi-definite, and M G s, Gᵀ M r and Gᵀ M G are those of matrices.

    The force of a jump has no stabilisation.
    """
    problem = torn_grid(change=change, **grid)
    formulation = create_dual(problem.A, type=kind, pc_type=pc_type, interior=interior)
    pc = formulation.preconditioner
    coarse = formulation.coarse
    G = dense(formulation.coarse.G)
    M = dense_preconditioner(formulation)
    B_D = dense(pc.B_D.matrix)
    equal(M, B_D @ dense_weight(problem, formulation, pc_type) @ B_D.T, 1e-11)
    equal(M, M.T, 1e-12)
    agree(np.linalg.eigvalsh(M)[0] > -1e-12 * np.abs(M).max())
    equal(matrix_of_map(coarse.MG.multiply, coarse.n_c), M @ G, 1e-12)
    equal(matrix_of_map(coarse.MG.multiply_transposed, formulation.system.m), G.T @ M, 1e-12)
    MG, galerkin_matrix = compute_weighted_columns(pc, formulation.delta, formulation.inverse)
    equal(dense(galerkin_matrix), G.T @ M @ G, 1e-12)
    galerkin_matrix.destroy()
    MG.destroy()
    agree((formulation.inertia.dual > 0) == (change is not None))
    if interior == "keep":
        jump = random_part(formulation.system.m)
        free = ~formulation.pattern.is_fixed
        expected = formulation.torn.multiply(pc.extend(pc.B_D.T @ jump))
        equal(whole(pc.apply(jump)[1][free]), whole(expected[free]), 1e-11)


# ---- the dual operator ----------------------------------------------------------------------

GRIDS = {"Laplace": case((2, 2), (2, 2)), "elasticity": case((2, 2), (1, 2), 2)}
CHANGES = {
    "no prestress": None,
    "prestress": scaled_diagonal(1.01),
    "compression": scaled_diagonal(0.99),
}
every_grid = each("grid", GRIDS)
every_change = each("change", CHANGES)


def dense_constraint_preconditioner(system):
    """Return the constraint preconditioner C from a jump to λ, (m, m), and to s, (N_c, m)."""
    to_lam = matrix_of_map(lambda r: system.precondition(r)[0].lam, system.m)
    to_s = matrix_of_map(lambda r: system.precondition(r)[0].s, system.m)
    return to_lam, to_s


@every_grid
@every_type
@every_change
@every_interior
def test_dual_operator_agrees_with_its_definition(
    grid, kind, change, interior, torn_grid, create_dual
):
    """F λ − G s with F = B K⁺ Bᵀ = Fᵀ; on balanced λ K⁺ acts as the Moore–Penrose inverse."""
    problem = torn_grid(change=change, **grid)
    formulation = create_dual(problem.A, type=kind, interior=interior)
    dual = formulation.system
    G = dense(formulation.coarse.G)
    F = matrix_of_map(dual.flexibility, dual.m)
    equal(F, F.T, 1e-12)
    lam = random_part(dual.m)
    s = random_part(formulation.coarse.n_c)
    jump = dual.multiply(DualUnknowns(lam, s))
    equal(whole(jump), F @ whole(lam) - G @ whole(s), 1e-12)
    if change is None:
        small(min(np.linalg.eigvalsh(F)[0], 0.0), 1e-14 * np.abs(F).max())
        B = dense(formulation.pattern.gluing.B)
        free = np.flatnonzero(np.any(B != 0, axis=0) | ~problem.dirichlet[problem.to_global])
        K = problem.K_torn[np.ix_(free, free)]
        expected = B[:, free] @ np.linalg.pinv(K, rcond=1e-10, hermitian=True) @ B[:, free].T
        P = np.eye(len(F)) - G @ np.linalg.solve(G.T @ G, G.T)
        equal(P @ F @ P, P @ expected @ P, 1e-10)


@every_grid
@every_q
@every_change
def test_start_has_the_jump_that_it_returns(grid, q, change, torn_grid, create_dual):
    """The jump is d − F λ₀ + G s₀, also if D = 0, where s₀ has the smallest jump."""
    problem = torn_grid(change=change, **grid)
    dual = create_dual(problem.A, coarse_q=q).system
    torn = dual.preconditioner.operator.torn
    f = np.where(torn.is_dirichlet_copy, 0.0, random_part(torn.n))
    c = np.zeros(dual.m)
    start, r = dual.start(f, c)
    d = dual.B @ dual.inverse.solve(f) - c
    equal(whole(r), whole(d - dual.multiply(start)), 1e-10)


@every_grid
@every_q
@every_change
@pytest.mark.parametrize("pc_type", ["dirichlet", "identity"])
def test_constraint_preconditioner_agrees_with_its_definition(
    grid, q, change, pc_type, torn_grid, create_dual, lifetime
):
    """Its image is balanced, Gᵀz_λ + D z_s = 0, and equals P M Pᵀ r for D = 0."""
    formulation = create_dual(torn_grid(change=change, **grid).A, pc_type=pc_type, coarse_q=q)
    M = dense_preconditioner(formulation)
    if formulation.coarse.MG is not None:
        M += np.diag(whole(formulation.coarse.q.array_r))
    G, N, D = (dense(getattr(formulation.coarse, key)) for key in ("G", "N", "D"))
    QG = matrix_of_map(formulation.system.weighted_jump, formulation.coarse.n_c)
    z_lam, z_s = dense_constraint_preconditioner(formulation.system)
    scale = np.abs(z_lam).max()
    small(np.abs(G.T @ z_lam + D @ z_s).max(), 1e-10 * max(scale, np.abs(D @ z_s).max()))
    equal(z_lam, z_lam.T, 1e-10)
    w = np.linalg.solve(N, QG.T)
    y = M - M @ G @ w
    v = np.linalg.solve(N, G.T @ y - D @ w)
    equal(z_lam, y - QG @ v, 1e-10)
    if change is None:
        P = np.eye(len(G)) - QG @ np.linalg.solve(N, G.T)
        equal(z_lam, P @ M @ P.T, 1e-10)
    agree(formulation.system.has_exact_kernel == (change is None))
    agree(formulation.system.omits_s == (change is None and formulation.coarse.MG is None))
    equal(z_s, np.zeros_like(z_s) if formulation.system.omits_s else -w - v, 1e-10)
    not_cg = DualSystem(
        formulation.pattern.gluing,
        formulation.inverse,
        formulation.preconditioner,
        formulation.coarse,
        is_cg=False,
    )
    to_lam, to_s = dense_constraint_preconditioner(lifetime.own(not_cg))
    equal(to_lam, z_lam, 1e-10)
    equal(to_s, -w - v, 1e-10)


@every_q
def test_norm_of_the_residual_takes_no_reduction(q, torn_grid, create_dual, monkeypatch):
    """It is summed with the coarse right-hand side, except for Q = M."""
    dual = create_dual(torn_grid(**GRIDS["elasticity"]).A, type="all_floating", coarse_q=q).system
    r = np.random.default_rng(744 + COMM.rank).standard_normal(dual.m)
    expected = dual.assembled_norm(r)
    calls = []
    total_of = system.total_of

    def counted(*arguments):
        calls.append(arguments)
        return total_of(*arguments)

    monkeypatch.setattr(system, "total_of", counted)
    norm = dual.precondition(r)[1]
    equal(norm, expected, 1e-12)
    agree(len(calls) == (1 if q == "preconditioner" else 0))


@pytest.mark.parametrize(
    ("is_cg", "has_exact_kernel", "measured"),
    [(True, True, []), (True, False, [3, 13, 23]), (False, True, [3, 13, 23])],
)
def test_residual_is_measured_after_a_small_estimate(is_cg, has_exact_kernel, measured):
    """It is measured again every ten iterations; CG with an exact kernel has it anyway."""
    measurements = []

    def measure(_residual):
        measurements.append(its)
        return 0.8

    vector = SimpleNamespace(norm=lambda: 1.0, destroy=lambda: None)
    ksp = SimpleNamespace(
        buildResidual=lambda: vector,
        getSolution=lambda: vector,
        getNormType=lambda: None,
        getAttr=lambda _: None,
    )
    shell = SimpleNamespace(
        system=SimpleNamespace(has_exact_kernel=has_exact_kernel),
        assembled_norm=measure,
        read_unknowns=lambda x: x,
    )
    initial = 1.0 if is_cg else 1.0 / RATIO_MARGIN
    estimate = ResidualEstimate(shell, preconditions_residual=is_cg, initial=initial)
    test = StoppingTest(shell, estimate, target=0.5, max_it=100, monitor=lambda *_: None)
    for its in range(30):
        norm = 0.4 if its == 3 else 1.0
        shell.preconditioned_norm = norm
        if test(ksp, its, norm):
            break
    agree(measurements == measured, measurements)
    agree(its == (29 if measured else 3), its)
