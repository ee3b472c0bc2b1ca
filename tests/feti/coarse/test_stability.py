# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What the coarse fields prove of the assembled matrix, against dense matrices."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse
from collective import COMM, agree, dense, equal, small, whole

from dolfinx_feti.feti.coarse.stability import ROUNDING, galerkin_matrix

SEED = 1923
GRID = {"subdomains": (3, 2), "cells": (3, 3), "components": 2}

every_type = pytest.mark.parametrize("kind", ["all_floating", "classical"])
every_interior = pytest.mark.parametrize("interior", ["keep", "eliminate"])


def soften(share):
    """Take a share of the stiffness from each subdomain: they buckle alone, or the whole does."""

    def change(K, dofs):
        for K_i in K:
            K_i -= share * np.abs(K_i).max() * np.eye(len(K_i))

    return change


def assembled(problem):
    """A on its free dofs."""
    K, free = problem.T.T @ problem.K_torn @ problem.T, ~problem.dirichlet
    return K[np.ix_(free, free)]


def count_negative(A):
    return np.count_nonzero(np.linalg.eigvalsh(A) < 0.0)


def averaged(problem, system, *, harmonic):
    """V = E − E_Γ B_Dᵀ B E on all torn dofs, (n, K)."""
    torn, modes = system.torn, system.modes
    columns = [np.zeros((torn.n, 0))]
    for dofs, E in zip(modes.dofs, modes.E, strict=True):
        columns.append(np.zeros((torn.n, E.shape[1])))
        columns[-1][dofs] = E
    E = scipy.sparse.block_diag(COMM.allgather(np.hstack(columns))).toarray()
    B, B_D = dense(system.gluing.B), dense(system.gluing.B_D)
    jump = B_D.T @ (B @ E)
    if system.matrices.condensed:
        E = extended(problem, system, E)
    return E - (extended(problem, system, jump) if harmonic else jump)


def extended(problem, system, X):
    """Extend fields on the interface harmonically to the interior."""
    K = problem.K_torn
    glued = np.any(dense(system.gluing.B) != 0.0, axis=0)
    inside = ~glued & ~whole(system.inverse.fixed)
    X = np.where(glued[:, None], X, 0.0)
    X[inside] = -np.linalg.solve(K[np.ix_(inside, inside)], (K @ X)[inside])
    return X


@every_type
@every_interior
@pytest.mark.parametrize("pc_type", ["dirichlet", "lumped", "identity", "none"])
@pytest.mark.parametrize("coarse_q", ["preconditioner", "identity"])
def test_galerkin_matrix(kind, interior, pc_type, coarse_q, torn_grid, parts):
    """A₀ = Vᵀ K V of single-valued fields V that meet the Dirichlet conditions."""
    problem = torn_grid(change=soften(0.01), **GRID)
    system = parts(
        problem.A, type=kind, interior=interior, pc_type=pc_type, coarse_q=coarse_q, coarse_modes=2
    )
    V = averaged(problem, system, harmonic=pc_type == "dirichlet")
    small(np.abs(dense(system.gluing.B) @ V).max(), 1e-12)
    A_0 = galerkin_matrix(
        system.torn, system.gluing, system.modes, system.preconditioner, system.coarse
    )
    expected = V.T @ problem.K_torn @ V
    equal(dense(A_0), expected, 1e2 * ROUNDING)
    A_0.destroy()
    agree(system.inertia.dual > 0)
    proved, there = system.inertia.assembled, count_negative(assembled(problem))
    agree(proved <= there and proved >= count_negative(expected), (proved, there))


@every_type
@every_interior
@pytest.mark.parametrize("share", [0.0, 0.002, 0.004, 0.01, 0.05, 0.2])
def test_what_is_proved_is_there(kind, interior, share, torn_grid, parts):
    """Never more negative eigenvalues than A has, and some wherever it has many."""
    problem = torn_grid(change=soften(share), **GRID)
    there = count_negative(assembled(problem))
    for pc_type in ("dirichlet", "lumped", "identity"):
        system = parts(problem.A, type=kind, interior=interior, pc_type=pc_type)
        proved = system.inertia.assembled
        agree(0 <= proved <= there, (proved, there))
        agree(proved > 0 or there <= 1 or pc_type != "dirichlet", (proved, there))
        agree(share > 0.0 or system.inertia.dual == 0)


@every_type
def test_unsymmetric_matrix_has_no_inertia(kind, torn_grid, parts):
    def change(K, dofs):
        rng = np.random.default_rng(SEED)
        for K_i in K:
            K_i += 0.01 * np.abs(K_i).max() * rng.standard_normal(K_i.shape) * (K_i != 0.0)

    problem = torn_grid(change=change, **GRID)
    agree(parts(problem.A, type=kind).inertia.assembled is None)
