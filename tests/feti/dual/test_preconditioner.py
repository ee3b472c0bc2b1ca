# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Preconditioners against their dense definition."""

import numpy as np
import pytest
import scipy.linalg
from cases import case, each, every_type
from collective import COMM, agree, dense, equal, matrix_of_map, small, whole
from hand_torn import scaled_diagonal
from modes import modes_of

from dolfinx_feti.feti.dual.coarse import WeightedColumns

SEED = 90210

PROBLEMS = {
    "elasticity": case((2, 2), (2, 3), 2),
    "one cell each": case((2, 2, 2), (1, 1, 1), 3),
    "Laplace": case((3,), (4,)),
}
BUCKLING = scaled_diagonal(0.98)  # the kernel of each subdomain becomes negative
every_problem = each("grid", PROBLEMS)
every_change = each("change", {"at rest": None, "buckling": BUCKLING})
every_pc = pytest.mark.parametrize("pc_type", ["identity", "lumped", "dirichlet"])


def props_of(system):
    """Z of all subdomains on all torn dofs, (n, q)."""
    torn = system.torn
    columns = [np.zeros((torn.n, 0))]
    for dofs, Z in zip(system.operator.dofs, modes_of(system).stabilisation, strict=True):
        columns.append(np.zeros((torn.n, Z.shape[1])))
        columns[-1][dofs] = Z
    return scipy.linalg.block_diag(*COMM.allgather(np.hstack(columns)))


def weight_of(problem, system, pc_type):
    """Y of the definition on all torn dofs."""
    K, Z = problem.K_torn, props_of(system)
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
@every_change
def test_preconditioner_is_the_weighted_one(grid, kind, pc_type, change, torn_grid, parts):
    """M = B_D Y B_Dᵀ ⪰ 0; M G s, Gᵀ M r and Gᵀ M G of the blocks; force of a jump: no props."""
    problem = torn_grid(change=change, **grid)
    system = parts(problem.A, type=kind, pc_type=pc_type)
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
    jump, free = (
        np.random.default_rng(SEED + 3).standard_normal(system.dual.m),
        ~system.pattern.dofs.fixed,
    )
    expected = system.torn.multiply(pc.extend(pc.B_D.T @ jump))
    equal(whole(pc.apply(jump)[1][free]), whole(expected[free]), 1e-11)


@every_type
@every_pc
@pytest.mark.parametrize("scaling", ["multiplicity", "stiffness"])
def test_force_of_a_jump_is_the_residual_of_the_averaged_displacement(
    kind, pc_type, scaling, torn_grid, parts
):
    """‖Tᵀ t‖ = ‖b − A x‖ where T x = u − E_Γ B_Dᵀ B u and u solves the torn equations."""
    problem = torn_grid((2, 2), (3, 2), components=2, stiffness=lambda i: 7.0**i)
    system = parts(problem.A, type=kind, pc_type=pc_type, scaling=scaling)
    torn, inverse, gluing = system.torn, system.inverse, system.pattern.gluing
    lam = np.random.default_rng(SEED + 1).standard_normal(gluing.B.getSize()[0])
    reaction = system.dual.B.T @ lam[slice(*gluing.B.getOwnershipRange())]
    force = np.where(system.pattern.dofs.fixed, 0.0, reaction)
    for dofs, E in zip(system.operator.dofs, modes_of(system).E, strict=True):  # balanced: Eᵀ f = 0
        force[dofs] -= E @ np.linalg.solve(E.T @ E, E.T @ force[dofs]) if E.size else 0.0
    u = inverse.solve(force)
    jump = system.dual.B @ u
    averaged = u - system.preconditioner.extend(system.preconditioner.B_D.T @ jump)
    t = system.preconditioner.apply(jump)[1]
    free = torn.assemble(torn.dirichlet.astype(float)) == 0.0
    expected = torn.assemble(force - torn.multiply(averaged))
    equal(whole(np.where(free, torn.assemble(t), 0.0)), whole(np.where(free, expected, 0.0)), 1e-9)


def test_extension_is_harmonic(torn_grid, parts):
    """The extension of a rigid motion of the interface is that motion, without a force inside."""
    problem = torn_grid((2, 2), (3, 3), components=2)
    system = parts(problem.A)
    pc, torn, glued = system.preconditioner, system.torn, system.pattern.gluing.glued
    motion = torn.near_kernel() @ np.array([0.3, -1.1, 0.7])
    w = np.zeros(torn.n)
    w[glued] = motion[glued]
    equal(whole(pc.extend(w)), whole(motion), 1e-12)
    w[glued] = np.random.default_rng(SEED + 2).standard_normal(torn.n)[glued]
    force = torn.multiply(pc.extend(w))
    force[glued] = 0.0
    small(np.abs(force).max(initial=0.0), 1e-11 * np.abs(problem.K_torn).max())


def test_subdomains_may_have_no_interior(torn_grid, parts):
    """Single cells in a row, held at both ends: the Schur complement is the matrix."""
    ends = lambda x: (x[:, 0] == 0.0) | (x[:, 0] == 3.0)  # noqa: E731
    problem = torn_grid((3, 1), (1, 1), components=2, fixed=ends)
    system = parts(problem.A)
    agree(all(len(rows) == 0 for rows in system.operator.interior))
    equal(matrix(system), matrix(parts(problem.A, pc_type="lumped")), 1e-14)
