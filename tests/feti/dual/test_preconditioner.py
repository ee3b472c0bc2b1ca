# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The dual operator, its preconditioners and the constraint on them against dense formulas."""

from types import SimpleNamespace

import numpy as np
import pytest
from cases import case, each, every_interior, every_type
from collective import COMM, agree, dense, equal, matrix_of_map, random_part, small, whole
from hand_torn import scaled_diagonal
from modes import modes_of, on_torn_dofs

from dolfinx_feti.feti.dual import system
from dolfinx_feti.feti.dual.coarse import WeightedColumns
from dolfinx_feti.feti.dual.krylov import INTERVAL, OPTIMISM, _StoppingTest
from dolfinx_feti.feti.dual.system import DualSystem

PROBLEMS = {
    "elasticity": case((2, 2), (2, 3), 2),
    "one cell each": case((2, 2, 2), (1, 1, 1), 3),
    "Laplace": case((3,), (4,)),
    "no interior": case((3, 1), (1, 1), 2, fixed=lambda x: np.isin(x[:, 0], (0.0, 3.0))),
}
BUCKLING = scaled_diagonal(0.98)  # the kernel of each subdomain becomes negative
every_problem = each("grid", PROBLEMS)
every_state = each("change", {"at rest": None, "buckling": BUCKLING})
every_pc = pytest.mark.parametrize("pc_type", ["identity", "lumped", "dirichlet"])


def weight_of(problem, system, pc_type):
    """Y of the definition on all torn dofs."""
    K, Z = problem.K_torn, on_torn_dofs(system, modes_of(system).stabilisation)
    fixed = whole(system.pattern.dofs.fixed)
    glued = np.any(dense(system.pattern.gluing.B) != 0.0, axis=0)
    if pc_type == "identity":
        return np.abs(np.diag(K)[glued]).mean() * np.eye(len(K)) + Z @ Z.T
    if pc_type == "lumped":
        return K + Z @ Z.T
    Y, inside = np.zeros_like(K), ~fixed & ~glued
    glued &= ~fixed
    K_II, K_ΓI = K[np.ix_(inside, inside)], K[np.ix_(glued, inside)]
    X = np.linalg.solve(K_II, np.hstack([K[np.ix_(inside, glued)], Z[inside]]))
    S, Y_Z = np.split(np.hstack([K[np.ix_(glued, glued)], Z[glued]]) - K_ΓI @ X, [glued.sum()], 1)
    C2 = np.eye(Z.shape[1]) + Z[inside].T @ X[:, glued.sum() :]
    Y[np.ix_(glued, glued)] = S + Y_Z @ np.linalg.solve((C2 + C2.T) / 2, Y_Z.T)
    return Y


def matrix(system):
    return matrix_of_map(lambda r: system.preconditioner.apply(r)[0], system.dual.m)


@every_problem
@every_type
@every_pc
@every_state
@every_interior
def test_preconditioner_is_the_weighted_one(
    grid, kind, pc_type, change, interior, torn_grid, parts
):
    """M = B_D Y B_Dᵀ ⪰ 0; M G s, Gᵀ M r and Gᵀ M G of the blocks; force of a jump: no props."""
    problem = torn_grid(change=change, **grid)
    system = parts(problem.A, type=kind, pc_type=pc_type, interior=interior)
    pc, coarse, G, M = system.preconditioner, system.coarse, dense(system.coarse.G), matrix(system)
    B_D = dense(pc.B_D.matrix)
    equal(M, B_D @ weight_of(problem, system, pc_type) @ B_D.T, 1e-11)
    equal(M, M.T, 1e-12)
    agree(np.linalg.eigvalsh(M)[0] > -1e-12 * np.abs(M).max())
    equal(matrix_of_map(coarse.MG.multiply, coarse.size), M @ G, 1e-12)
    equal(matrix_of_map(coarse.MG.restrict, system.dual.m), G.T @ M, 1e-12)
    product = WeightedColumns(system.delta, system.modes, pc)
    equal(dense(product.galerkin_matrix), G.T @ M @ G, 1e-12)
    product.destroy()
    agree((system.inertia.dual > 0) == (change is not None))
    if interior == "keep":
        jump, free = random_part(system.dual.m), ~system.pattern.dofs.fixed
        expected = system.torn.multiply(pc.extend(pc.B_D.T @ jump))
        equal(whole(pc.apply(jump)[1][free]), whole(expected[free]), 1e-11)


# ---- the dual operator ----------------------------------------------------------------------

GRIDS = {"Laplace": case((2, 2), (2, 2)), "elasticity": case((2, 2), (1, 2), 2)}
CHANGES = {
    "no prestress": None,
    "prestress": scaled_diagonal(1.01),
    "compression": scaled_diagonal(0.99),
}
every_grid, every_change = each("grid", GRIDS), each("change", CHANGES)
every_q = pytest.mark.parametrize("q", ["identity", "diagonal", "preconditioner"])


def constraint(dual):
    """Constraint preconditioner from jumps to (λ, s), two matrices."""

    def apply(r, part):
        residual = np.concatenate([r, np.zeros(dual.size - dual.m)])
        return dual.split(dual.precondition(residual)[0])[part]

    return (matrix_of_map(lambda r, i=i: apply(r, i), dual.m) for i in (0, 1))


@every_grid
@every_type
@every_change
@every_interior
def test_operator(grid, kind, change, interior, torn_grid, parts):
    """(F λ − G s, 0) for (λ, s); F = B K⁺ Bᵀ = Fᵀ, on balanced λ with the Moore–Penrose inverse."""
    problem = torn_grid(change=change, **grid)
    system = parts(problem.A, type=kind, interior=interior)
    dual, G = system.dual, dense(system.coarse.G)
    F = matrix_of_map(dual.flexibility, dual.m)
    equal(F, F.T, 1e-12)
    lam, s = (random_part(n) for n in (dual.m, dual.size - dual.m))
    jump, zero = dual.split(dual.multiply(np.concatenate([lam, s])))
    equal(whole(jump), F @ whole(lam) - G @ whole(s), 1e-12)
    equal(zero, np.zeros_like(zero))
    if change is None:
        small(min(np.linalg.eigvalsh(F)[0], 0.0), 1e-14 * np.abs(F).max())
        B = dense(system.pattern.gluing.B)
        free = np.flatnonzero(np.any(B != 0, axis=0) | ~problem.dirichlet[problem.to_global])
        K = problem.K_torn[np.ix_(free, free)]
        expected = B[:, free] @ np.linalg.pinv(K, rcond=1e-10, hermitian=True) @ B[:, free].T
        P = np.eye(len(F)) - G @ np.linalg.solve(G.T @ G, G.T)
        equal(P @ F @ P, P @ expected @ P, 1e-10)


@every_grid
@every_q
@every_change
@pytest.mark.parametrize("pc_type", ["dirichlet", "identity"])
def test_constraint_preconditioner_is_the_inverse_it_stands_for(
    grid, q, change, pc_type, torn_grid, parts, lifetime
):
    """Its image is balanced, Gᵀz_λ + D z_s = 0, and P M Pᵀ r for D = 0; Q stands for M in Q."""
    system = parts(torn_grid(change=change, **grid).A, pc_type=pc_type, coarse_q=q)
    M = matrix(system)
    if system.coarse.MG is not None:
        M += np.diag(whole(system.coarse.q.array_r))
    G, N, D = (dense(getattr(system.coarse, key)) for key in ("G", "N", "D"))
    QG = matrix_of_map(system.dual.weighted_jump, system.coarse.size)
    z_lam, z_s = constraint(system.dual)
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
    agree(system.dual.exact == (change is None))
    agree(system.dual.frozen == (change is None and system.coarse.MG is None))
    equal(z_s, np.zeros_like(z_s) if system.dual.frozen else -w - v, 1e-10)
    given = system.pattern.gluing, system.inverse, system.preconditioner, system.coarse
    for part, expected in zip(
        constraint(lifetime.own(DualSystem(*given, cg=False))), (z_lam, -w - v), strict=True
    ):
        equal(part, expected, 1e-10)


@every_q
def test_preconditioner_waits_for_no_norm(q, torn_grid, parts, monkeypatch):
    """The norm of the assembled residual travels with the coarse right-hand side, if it can."""
    dual = parts(torn_grid(**GRIDS["elasticity"]).A, type="all_floating", coarse_q=q).dual
    r = np.random.default_rng(744 + COMM.rank).standard_normal(dual.size)
    expected, calls, sum_ = dual.unbalanced(r), [], system.total
    monkeypatch.setattr(system, "total", lambda *part: calls.append(0) or sum_(*part))
    norm = dual.precondition(r)[1]
    equal(norm, expected, 1e-12)
    agree(len(calls) == (q == "preconditioner"))


@pytest.mark.parametrize(
    ("cg", "exact", "measured"),
    [(True, True, []), (True, False, [3, 13, 23]), (False, True, [3, 13, 23])],
)
def test_residual_is_measured_again(cg, exact, measured):
    """Where an estimate promises too much, and every ten iterations then; never if CG knows it."""
    found, vector = [], SimpleNamespace(array_r=np.zeros(1), norm=lambda: 1.0, destroy=lambda: None)
    ksp = SimpleNamespace(
        buildResidual=lambda: vector, getSolution=lambda: vector, getNormType=lambda: None
    )
    dual = SimpleNamespace(exact=exact, unbalanced=lambda _: found.append(its) or 0.8)
    test = _StoppingTest(dual, 0.5, 100, cg, lambda *_: None, 1.0, np.inf if cg else INTERVAL)
    for its in range(1, 30):
        estimate = 0.4 if its == 3 else 1.0
        dual.norm = estimate if cg else 1.0 / OPTIMISM
        if test(ksp, its, estimate):
            break
    agree(found == measured and its == (29 if measured else 3), (found, its))
