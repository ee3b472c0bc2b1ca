# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Lanczos' method from the coefficients of CG, with and without reorthogonalisation."""

from __future__ import annotations

import numpy as np
import pytest
import reference
import scipy.linalg
from collective import agree
from hand_torn import random_values, solve

every_type = pytest.mark.parametrize("kind", ["all_floating", "classical"])
every_pc = pytest.mark.parametrize("pc_type", ["dirichlet", "lumped", "identity"])

#: What the paper takes, and a test on the dual residual that CG can meet exactly.
OPTIONS = {
    "feti_scaling": "multiplicity",
    "feti_coarse_q": "identity",
    "feti_coarse_modes": 0,
    "feti_dual_ksp_rtol": 1e-10,
    "feti_dual_ksp_norm_type": "natural",
}


def jumping(torn_grid):
    """Six squares in plane strain, every other one 10³ times stiffer, which the scaling ignores."""
    return torn_grid((2, 3), (3, 3), components=2, stiffness=lambda i: 1e3 ** (i % 2))


def spectrum(problem, *, kind, pc_type):
    """Eigenvalues of P M Pᵀ F other than zero, by dense formulas that share nothing with FETI."""
    free = np.ones(len(problem.to_global), dtype=bool)
    if kind == "classical":
        free = ~problem.dirichlet[problem.to_global]
    K = problem.K_torn[np.ix_(free, free)]
    copies = problem.to_global[free]
    B = reference.jumps(copies, problem.dirichlet, all_floating=kind == "all_floating")
    delta = 1.0 / np.bincount(copies)[copies]
    pair = np.count_nonzero(B, axis=1) == 2  # Dirichlet rows have weight one
    B_D = np.where(pair[:, None], B * delta, B)
    Y = {"identity": np.eye(len(K)), "lumped": K, "dirichlet": schur(K, np.any(B, axis=0))}
    M = B_D @ Y[pc_type] @ B_D.T
    R = scipy.linalg.null_space(K, rcond=1e-10)
    F = B @ np.linalg.pinv(K, rcond=1e-10, hermitian=True) @ B.T
    G = B @ R
    P = np.eye(len(B)) - G @ np.linalg.pinv(G)
    values, vectors = np.linalg.eigh(P @ F @ P)
    root = vectors * np.sqrt(np.where(values > 1e-9 * values[-1], values, 0.0))
    values = np.linalg.eigvalsh(root.T @ M @ root)
    return values[values > 1e-9 * values[-1]]


def schur(K, glued):
    """Schur complement on the glued dofs, zero elsewhere."""
    S = np.zeros_like(K)
    Γ, I = np.flatnonzero(glued), np.flatnonzero(~glued)  # noqa: E741
    inside = np.linalg.solve(K[np.ix_(I, I)], K[np.ix_(I, Γ)]) if len(I) else np.zeros((0, len(Γ)))
    S[np.ix_(Γ, Γ)] = K[np.ix_(Γ, Γ)] - K[np.ix_(Γ, I)] @ inside
    return S


def solved(feti, problem, **options):
    """Context of a solve with a random load."""
    ksp = feti(problem.A, **(OPTIONS | options))
    reason, _ = solve(ksp, problem, random_values(problem, seed=11215))
    agree(reason > 0, ksp.getPythonContext().message)
    return ksp.getPythonContext()


@every_type
@every_pc
def test_ritz_values_are_the_ends_of_the_spectrum(kind, pc_type, torn_grid, feti):
    """Condition number to 1e-6, and no iteration for a ghost.

    In exact arithmetic there are no more iterations than different eigenvalues. The identity has a
    factor θ, which leaves the condition number as it is. All-floating and lumped, no load reaches
    the lowest eigenvectors, which pull the copies of a Dirichlet dof apart.
    """
    problem = jumping(torn_grid)
    values = spectrum(problem, kind=kind, pc_type=pc_type)
    different = 1 + np.count_nonzero(np.diff(values) > 1e-9 * values[1:])
    plain, full = (
        solved(feti, problem, feti_type=kind, feti_pc_type=pc_type, feti_dual_ksp_type=method)
        for method in ("cg", "fcg")
    )
    agree((plain.method, full.method) == ("cg", "fcg"), (plain.method, full.method))
    agree(full.iterations <= different + 1, (full.iterations, different))
    agree(full.iterations < plain.iterations, (full.iterations, plain.iterations))
    if pc_type != "identity":
        high = full.eigenvalues[1]
        agree(abs(high / values[-1] - 1.0) < 1e-6, (high, values[-1]))
    if (kind, pc_type) != ("all_floating", "lumped"):
        expected = values[-1] / values[0]
        agree(abs(full.condition_number / expected - 1.0) < 1e-6, (full.eigenvalues, values))


@pytest.mark.parametrize("method", ["cg", "fcg"])
def test_later_solves_may_take_more_iterations(method, torn_grid, feti):
    """PETSc sizes the arrays of the coefficients at set-up, for the iterations then allowed."""
    problem = jumping(torn_grid)
    ksp = feti(problem.A, feti_pc_type="identity", feti_dual_ksp_type=method, ksp_max_it=2)
    counts = []
    for most in (2, 1000, 5, 1000):
        ksp.setTolerances(max_it=most)
        reason, _ = solve(ksp, problem, random_values(problem))
        counts.append(ksp.getPythonContext().iterations)
        agree((reason > 0) == (most == 1000))
    agree(counts[0] == 2 and counts[2] == 5, counts)
    agree(counts[1] == counts[3] > 20, counts)
