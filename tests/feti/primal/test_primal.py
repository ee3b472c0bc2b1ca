# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The primal form: its preconditioner against dense matrices, its spectrum, negative curvature."""

from petsc4py import PETSc

import numpy as np
import primal_form
import pytest
from cases import case, each, every_interior, every_type
from collective import COMM, agree, dense, equal, matrix_of_map, random_part, whole
from hand_torn import random_values, scaled_diagonal, softened

SEED = 1993
GRID = case((3, 2), (3, 2), 2)
Reason = PETSc.KSP.ConvergedReason
CHANGES = {"no prestress": None, "tension": scaled_diagonal(1.01), "compression": softened(0.0001)}
every_change = each("change", CHANGES)


def assembled(of_copies, exact):
    """Take a map of copies, (n, n), to one of assembled vectors: average, map, copies."""
    return exact.average @ of_copies @ exact.T


def solution(problem, primal, values):
    """Assert that the solution is that of a direct solver, with values prescribed; say how."""
    b = problem.vector(values)
    torn = primal.parts.torn.tear(b.array_r)
    b.destroy()
    u, outcome = primal.solve(torn, torn)
    equal(whole(u), problem.T @ problem.solve(values), 1e-8)
    return outcome


@every_change
@every_type
@every_interior
def test_operator_and_preconditioner(change, kind, interior, torn_grid, form):
    """A = Tᵀ S T and Π Tᵀ δ K_ρ⁻¹ δ T + V A₀⁻¹ Vᵀ, as they are defined; and the solution."""
    problem = torn_grid(change=change, **GRID)
    primal = form(problem, type=kind, interior=interior, coarse_modes=2)
    exact = primal_form.reference(problem, primal)
    system, n = primal.system, primal.copies.n
    zero = np.zeros(n)
    A = -matrix_of_map(lambda x: system.residual(zero, x), n)
    M = matrix_of_map(lambda r: system.precondition(r)[0], n)
    equal(assembled(A, exact), exact.A, 1e-11)
    equal(assembled(M, exact), exact.preconditioner + exact.coarse, 1e-9)
    outcome = solution(problem, primal, random_values(problem, SEED))
    agree(outcome.reason == Reason.CONVERGED_RTOL)


@every_type
@every_interior
@pytest.mark.parametrize("modes", [0, 3])
def test_spectrum(kind, interior, modes, torn_grid, form):
    """Without prestress: none below one, and beyond one the eigenvalues of the dual method."""
    problem = torn_grid(**GRID)
    primal = form(problem, type=kind, interior=interior, coarse_modes=modes)
    exact = primal_form.reference(problem, primal)
    balanced = np.linalg.eigvals(exact.preconditioner @ exact.A).real
    primal_values = np.sort(balanced[balanced > 1e-6])
    agree(len(balanced) - len(primal_values) == np.linalg.matrix_rank(exact.V))
    agree(primal_values.min() >= 1.0 - 1e-9)
    if modes:
        return  # soft modes have D ≠ 0
    dual = primal.parts.dual
    m = dual.m
    F = matrix_of_map(lambda x: dual.B @ primal.parts.inverse.solve(dual.B.T @ x), m)
    M = matrix_of_map(lambda x: primal.parts.preconditioner.apply(x)[0], m)
    G = dense(primal.parts.coarse.G)
    P = np.eye(len(F)) - M @ G @ np.linalg.pinv(G.T @ M @ G, rcond=1e-10, hermitian=True) @ G.T
    dual_values = np.linalg.eigvals(P @ M @ P.T @ F).real
    above = 1.0 + 1e-6
    equal(primal_values[primal_values > above], np.sort(dual_values[dual_values > above]), 1e-7)


@pytest.mark.parametrize(
    ("share", "proved"), [(0.002, 0), (0.02, 3)], ids=["met by CG", "told by the coarse space"]
)
def test_negative_curvature(share, proved, torn_grid, form):
    """An indefinite matrix is told, although K_ρ is definite."""
    problem = torn_grid((2, 2), (4, 4), components=2, change=softened(share))
    primal = form(problem, type="all_floating", interior="eliminate", coarse_modes=0)
    exact = primal_form.reference(problem, primal)
    agree(np.linalg.eigvalsh(exact.A)[0] < 0.0 < np.linalg.eigvalsh(exact.S_ρ)[0])
    agree(primal.space.negative() == proved)
    _, outcome = primal_form.cg(primal.system, random_part(primal.copies.n))
    agree(outcome.reason == Reason.DIVERGED_INDEFINITE_MAT)


def test_ritz_values(torn_grid, form):
    """The coefficients of conjugate gradients tell the spectrum."""
    problem = torn_grid((2, 2), (2, 2), components=2)
    primal = form(problem, type="all_floating", interior="keep", coarse_modes=0)
    exact = primal_form.reference(problem, primal)
    values = np.linalg.eigvals(exact.preconditioner @ exact.A).real
    _, found = primal_form.cg(primal.system, random_part(primal.copies.n), rtol=1e-13)
    equal(found.eigenvalues, [values[values > 1e-6].min(), values.max()], 1e-6)


def test_most_iterations_and_nothing_to_do(torn_grid, form):
    primal = form(torn_grid(**GRID), type="all_floating", interior="keep")
    n = primal.copies.n
    _, outcome = primal_form.cg(primal.system, random_part(n), max_it=2)
    agree(outcome.reason == Reason.DIVERGED_MAX_IT and outcome.iterations == 2)
    x, outcome = primal_form.cg(primal.system, np.zeros(n))
    agree(outcome.reason > 0 and outcome.iterations == 0 and not x.any())
    _, outcome = primal_form.cg(primal.system, np.full(n, np.nan))
    agree(outcome.reason == Reason.DIVERGED_NANORINF)


def test_no_subdomain_left_for_a_process(torn_grid, form):
    """One subdomain has no interface: there is nothing to iterate for."""
    problem = torn_grid((1, 1), (3, 2), components=2)
    primal = form(problem, type="classical", interior="keep")
    agree(solution(problem, primal, np.ones(len(problem.dirichlet))).iterations == 0)


def test_copies_agree_to_the_last_bit(torn_grid, form):
    """Each copy gets the same sum, in whatever order the processes answer."""
    problem = torn_grid((2, 2, 2), (2, 2, 2))
    primal = form(problem)
    total = whole(
        primal.copies.sum(np.random.default_rng(COMM.rank).standard_normal(primal.copies.n))
    )
    dof = problem.to_global[whole(primal.copies.dofs + primal.parts.torn.start)]
    for of_dof in np.unique(dof):
        agree(len(np.unique(total[dof == of_dof])) == 1)
