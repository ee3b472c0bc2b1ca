# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The dual operator and the constraint preconditioner against dense formulas."""

import numpy as np
import pytest
from cases import case, each, every_type
from collective import COMM, agree, dense, equal, matrix_of_map, random_part, small, whole
from hand_torn import scaled_diagonal

from dolfinx_feti.feti.dual import system
from dolfinx_feti.feti.dual.system import DualSystem

SEED = 744

GRIDS = {"Laplace": case((2, 2), (2, 2)), "elasticity": case((2, 2), (1, 2), 2)}
CHANGES = {
    "no prestress": None,
    "prestress": scaled_diagonal(1.01),
    "compression": scaled_diagonal(0.99),
}
every_grid, every_change = each("grid", GRIDS), each("change", CHANGES)
every_q = pytest.mark.parametrize("q", ["identity", "diagonal", "preconditioner"])


def flexibility(system):
    return matrix_of_map(system.dual.flexibility, system.dual.m)


def constraint(dual):
    """Constraint preconditioner from jumps to (λ, s), two matrices."""

    def apply(r, part):
        residual = np.concatenate([r, np.zeros(dual.size - dual.m)])
        return dual.split(dual.precondition(residual)[0])[part]

    return (matrix_of_map(lambda r, i=i: apply(r, i), dual.m) for i in (0, 1))


@every_grid
@every_type
@every_change
def test_operator(grid, kind, change, torn_grid, parts):
    """(F λ − G s, 0) for (λ, s); F = B K⁺ Bᵀ = Fᵀ, on balanced λ with the Moore–Penrose inverse."""
    problem = torn_grid(change=change, **grid)
    system = parts(problem.A, type=kind)
    dual, F, G = system.dual, flexibility(system), dense(system.coarse.G)
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
    grid, q, change, pc_type, torn_grid, parts
):
    """Its image is balanced, Gᵀz_λ + D z_s = 0, and P M Pᵀ r for D = 0; Q stands for M in Q."""
    system = parts(torn_grid(change=change, **grid).A, pc_type=pc_type, coarse_q=q)
    M = matrix_of_map(lambda r: system.preconditioner.apply(r)[0], system.dual.m)
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


def test_eigenvalues_of_the_unfrozen_system_are_one_besides(torn_grid, parts, lifetime):
    """Besides those of P M Pᵀ F there is a one for each coarse unknown."""
    system = parts(torn_grid((2, 2), (2, 2)).A, pc_type="identity")
    given = system.pattern.gluing, system.inverse, system.preconditioner, system.coarse
    z_lam, z_s = constraint(lifetime.own(DualSystem(*given, cg=False)))
    F, G = flexibility(system), dense(system.coarse.G)
    operator = np.hstack([F, -G])
    preconditioned = np.vstack([z_lam @ operator, z_s @ operator])
    values = np.sort(np.linalg.eigvals(preconditioned).real)
    projected = np.sort(np.linalg.eigvals(z_lam @ F).real)
    nonzero = projected[np.abs(projected) > 1e-10]
    expected = np.sort(np.concatenate([nonzero, np.ones(system.coarse.total)]))
    equal(values[np.abs(values) > 1e-10], expected, 1e-7)


@every_q
def test_preconditioner_waits_for_no_norm(q, torn_grid, parts, monkeypatch):
    """The norm of the assembled residual travels with the coarse right-hand side, if it can."""
    dual = parts(torn_grid(**GRIDS["elasticity"]).A, type="all_floating", coarse_q=q).dual
    r = np.random.default_rng(SEED + COMM.rank).standard_normal(dual.size)
    expected, calls, sum_ = dual.unbalanced(r), [], system.total
    monkeypatch.setattr(system, "total", lambda *part: calls.append(0) or sum_(*part))
    norm = dual.precondition(r)[1]
    equal(norm, expected, 1e-12)
    agree(len(calls) == (q == "preconditioner"))
