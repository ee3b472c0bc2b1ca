# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The coarse matrix of the dual formulation and the projection agree with dense formulas."""

from petsc4py import PETSc

import numpy as np
import pytest
from cases import each, every_q, every_type
from collective import COMM, agree, dense, equal, matrix_of_map, small, whole
from hand_torn import scaled_diagonal
from modes import modes_of, on_torn_dofs

from dolfinx_feti.feti.coarse.dual_problem import DIAGONAL_SHARE

SEED = 33107


def dense_projection_weight(problem, formulation, q):
    """Return the weight Q of the projection by its definition, (m, m)."""
    B_D = dense(formulation.preconditioner.B_D.matrix)
    if q == "identity":
        return np.eye(len(B_D))
    Q = np.diag(B_D**2 @ np.diag(problem.K_torn))
    if q == "diagonal":
        return Q
    M = matrix_of_map(lambda r: formulation.preconditioner.apply(r)[0], formulation.system.m)
    return M + DIAGONAL_SHARE * Q


@every_type
@every_q
@each("change", {"no prestress": None, "prestress": scaled_diagonal(1.02)})
def test_coarse_matrix_and_projection_agree_with_dense_formulas(
    kind, q, change, torn_grid, create_dual
):
    """G = B E, N = GᵀQG + D and s₀ = N⁻¹ Eᵀf; P² = P and GᵀP = 0 for D = 0."""
    problem = torn_grid((3, 2), (2, 2), components=2, change=change)
    formulation = create_dual(problem.A, type=kind, coarse_q=q)
    coarse = formulation.coarse
    B = dense(formulation.pattern.gluing.B)
    n = formulation.torn.n
    E = on_torn_dofs(formulation, modes_of(formulation).E)
    G, N, D = (dense(M) for M in (coarse.G, coarse.N, coarse.D))
    QG = matrix_of_map(formulation.system.weighted_jump, coarse.n_c)
    equal(G, B @ E, 1e-13)
    equal(QG, dense_projection_weight(problem, formulation, q) @ G, 1e-11)
    equal(N, G.T @ QG + D, 1e-12)
    equal(N, N.T, 1e-12)
    f = np.random.default_rng(SEED + COMM.rank).standard_normal(n)
    e = coarse.restrict(f)
    equal(whole(e), E.T @ whole(f), 1e-13)
    s = coarse.solve(e)
    equal(whole(coarse.prolong(s)), E @ whole(s), 1e-12)
    equal(G.T @ whole(formulation.system.weighted_jump(s)) + D @ whole(s), whole(e), 1e-10)
    if change is None:
        equal(D, np.zeros_like(N))
        P = np.eye(len(G)) - QG @ np.linalg.solve(N, G.T)
        equal(P @ P, P, 1e-10)
        small(np.abs(G.T @ P).max(), 1e-10)
        agree(np.linalg.eigvalsh(N)[0] > 0.0)
    else:
        agree(np.abs(D).max() > 0.0)


def test_coarse_matrix_couples_neighbours_only(torn_grid, create_dual):
    """In a row of subdomains N is block tridiagonal for Q = I, wider by one for Q = M."""
    problem = torn_grid((8,), (3,))
    for q, width in (("identity", 1), ("diagonal", 1), ("preconditioner", 3)):
        N = create_dual(problem.A, coarse_q=q).coarse.N
        rows, columns = np.nonzero(dense(N))
        agree(np.abs(rows - columns).max() <= width, q)
        agree(N.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"] <= 8 * (2 * width + 1))


@pytest.mark.processes(1, 2, 3, 4, 8)
def test_coarse_problem_may_be_empty(torn_grid, create_dual):
    """All subdomains touch the Dirichlet boundary, so that none has a kernel."""
    coarse = create_dual(torn_grid((1, 4), (2, 2), components=2).A, type="classical").coarse
    agree(coarse.N_c == 0 and coarse.solve(np.zeros(0)).shape == (0,))
    agree(coarse.solver.inertia() == (0, 0))
