# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""GMRES in the primal form: an unsymmetric K with the preconditioner of its symmetric part."""

from petsc4py import PETSc

import numpy as np
import pytest
from cases import case, every_type
from collective import COMM, agree, equal, matrix_of_map, random_part, small, whole
from hand_torn import one_sided, random_values, solve, solved, unsymmetric

from dolfinx_feti.feti.primal import krylov as module
from dolfinx_feti.feti.primal.form import create_preconditioner_of_part, create_primal_form
from dolfinx_feti.feti.primal.krylov import gmres
from dolfinx_feti.feti.setup import set_up_operator
from dolfinx_feti.feti.solution import RitzVectors
from dolfinx_feti.runtime.petsc_options import inserted

SEED = 1986
GRID = case((3, 2), (3, 3), 2)
Reason = PETSc.KSP.ConvergedReason


@pytest.fixture
def form(pattern, lifetime, double_products):
    """Make the primal form of a torn matrix that is not symmetric."""

    def create(problem, vectors=None, **options):
        read = pattern(problem.A, formulation="primal", interior="auto", **options)
        parts = set_up_operator(read, lifetime), create_preconditioner_of_part(read, lifetime)
        return create_primal_form(read, *parts, lifetime, vectors, most=20)

    return create


def iterate(form, f, *, rtol=1e-10, **how):
    system, norms = form.system, []
    target = rtol * system.norm(system.copies.sum(f))
    given = {"max_it": 200, "traced": 200, **how}
    found = gmres(system, f, target=target, monitor=lambda its, norm: norms.append(norm), **given)
    return *found, norms


def assembled(apply, form, T):
    """The dense matrix of a map of assembled vectors, given by their copies: average, map."""
    average = T.T * whole(form.system.copies.delta)
    return average @ matrix_of_map(apply, form.system.copies.n) @ T


@every_type
def test_operator_and_preconditioner(kind, torn_grid, form):
    """A = Tᵀ S T of K; Π Tᵀ δ K_ρ⁻¹ δ T + V A₀⁻¹ Vᵀ, with K_ρ of ½ (K + Kᵀ) and Π of K."""
    problem = torn_grid(change=unsymmetric(0.1), **GRID)
    primal = form(problem, type=kind, coarse_modes=2)
    system, V, torn = primal.system, primal.coarse.V, primal.pattern.torn
    rows = whole(system.copies.dofs + torn.start)
    inside = np.setdiff1d(np.flatnonzero(~whole(primal.pattern.dofs.fixed)), rows)
    T = problem.T[rows][:, ~problem.dirichlet]
    T = T[:, T.any(axis=0)]
    K, zero = problem.K_torn, np.zeros(system.copies.n)
    X = np.linalg.solve(K[np.ix_(inside, inside)], K[np.ix_(inside, rows)])
    A = T.T @ (K[np.ix_(rows, rows)] - K[np.ix_(rows, inside)] @ X) @ T
    equal(assembled(lambda x: -system.residual(zero, x), primal, T), A, 1e-11)
    average = T.T * whole(system.copies.delta)
    V = average @ matrix_of_map(V.prolong, V.size)
    coarse = V @ np.linalg.pinv(V.T @ A @ V, rcond=1e-10) @ V.T
    K_ρ = np.linalg.inv(matrix_of_map(primal.preconditioner.solve, system.copies.n))
    equal(K_ρ, K_ρ.T, 1e-8)
    M = average @ np.linalg.solve(K_ρ, average.T)
    expected = M - coarse @ A @ M + coarse
    equal(assembled(lambda r: system.precondition(r)[0], primal, T), expected, 1e-8)


@pytest.mark.parametrize("solver", ["mumps", "petsc"])
def test_transposed_products(solver, torn_grid, pattern, lifetime):
    """Sᵀ X of every subdomain, for all columns at once, and K_II⁻ᵀ."""
    problem = torn_grid(change=unsymmetric(0.1), **GRID)
    with inserted("test_feti_dirichlet_", {"pc_factor_mat_solver_type": solver}):
        read = pattern(problem.A, formulation="primal", interior="auto")
        S = set_up_operator(read, lifetime)
    for i, Γ in enumerate(S.interface):
        X, Y = np.random.default_rng(SEED).standard_normal((2, len(Γ), 3))
        agree(np.allclose(Y.T @ S.multiply_many(i, X), S.multiply_many(i, Y, transpose=True).T @ X))
        agree(S.multiply_many(i, X[:, :0], transpose=True).shape == (len(Γ), 0))


@pytest.mark.parametrize("count", [0, 4])
def test_least_residuals(count, torn_grid, form):
    """A Z = R H with Rᵀ R = I; V and W get no residual; and its norm is that of the iterate."""
    problem = torn_grid(change=unsymmetric(0.1, skew=True), **GRID)
    plain = form(problem)
    copies, f = plain.system.copies, random_part(plain.system.copies.n)
    W = [copies.average(random_part(copies.n, seed=7 + j)) for j in range(count)]
    W = np.column_stack(W or [f])[:, :count]
    primal = form(problem, RitzVectors(W, W))
    system, δ = primal.system, copies.delta[:, None]
    agree(primal.deflation.count == count)
    _, outcome, trace, norms = iterate(primal, f)
    agree(outcome.reason == Reason.CONVERGED_RTOL and len(norms) == outcome.iterations + 1)
    agree(np.all(np.diff(norms) <= 0.0))
    R, Z, H = trace.R.T, trace.Z.T, trace.H
    equal(COMM.allreduce(R.T @ (δ * R)), np.eye(R.shape[1]), 1e-12)
    AZ = np.column_stack([-system.residual(0.0 * z, z) for z in Z.T])
    equal(whole(AZ), whole(R @ H), 1e-10)
    for its in (0, 3, outcome.iterations):
        r = system.residual(f, iterate(primal, f, max_it=its)[0])
        small(system.norm(r) / norms[its] - 1.0, 1e-3)
        small(np.abs(COMM.allreduce(W.T @ (δ * r[:, None]))).max(initial=0.0), 1e-8 * norms[0])


def test_symmetric_matrix_takes_the_iterations_of_cg(torn_grid, feti, form):
    """A skew part of 1e-8 makes GMRES of CG."""
    counts = []
    for share in (0.0, 1e-8):
        problem = torn_grid(change=unsymmetric(share, skew=True), **GRID)
        ksp = feti(problem.A, feti_formulation="primal")
        agree(solve(ksp, problem, random_values(problem))[0] > 0)
        agree(ksp.getPythonContext().method == ("gmres" if share else "cg"))
        counts.append(ksp.getIterationNumber())
    agree(counts[0] - 2 <= counts[1] <= counts[0], counts)


@every_type
@pytest.mark.parametrize("skew", [True, False], ids=["skew", "indefinite"])
@pytest.mark.parametrize("share", [0.01, 0.3, 3.0])
def test_against_lu(share, skew, kind, torn_grid, feti):
    """Up to matrices that are random but for a pattern; ``auto`` takes the primal form."""
    problem = torn_grid(change=unsymmetric(share, skew=skew), **GRID)
    context = solved(feti(problem.A, feti_type=kind, ksp_rtol=1e-11), problem)
    agree(context.message == "" and context.method == "gmres", context.message)
    report = context.report()
    agree((report.formulation, report.interior) == ("primal", "kept"), report)
    agree(context.inertia.assembled is None)


@pytest.mark.parametrize("components", [1, 2])
@pytest.mark.parametrize("scaling", ["stiffness", "multiplicity"])
def test_unsymmetric_pattern(scaling, components, torn_grid, feti):
    """Entries without a mirror: ½ (K + Kᵀ) has another pattern than K, and other rows."""
    problem = torn_grid((3, 2), (7, 7), components=components, change=one_sided(0.02))
    context = solved(feti(problem.A, feti_scaling=scaling, ksp_rtol=1e-11), problem)
    agree(context.method == "gmres" and context.iterations < 25, context.iterations)


def test_fresh_starts(torn_grid, feti, monkeypatch):
    """A few vectors are enough where fresh starts follow; where none does, the message says so."""
    monkeypatch.setattr(module, "RESTART", 8)
    problem = torn_grid(change=unsymmetric(0.1, skew=True), **GRID)
    ksp = feti(problem.A, ksp_rtol=1e-10)
    agree(solved(ksp, problem, 1e-7).iterations > 8)
    monkeypatch.setattr("dolfinx_feti.feti.solver.RESTARTS", 0)
    agree(solve(ksp, problem, random_values(problem))[0] == Reason.DIVERGED_BREAKDOWN)
    agree("stagnates" in ksp.getPythonContext().message)


def test_ends(torn_grid, form):
    """No load, a NaN, no iterations left."""
    primal = form(torn_grid(change=unsymmetric(0.1, skew=True), **GRID))
    n = primal.system.copies.n
    x, outcome, _, _ = iterate(primal, np.zeros(n))
    agree(outcome.reason > 0 and outcome.iterations == 0 and not x.any())
    agree(iterate(primal, np.full(n, np.nan))[1].reason == Reason.DIVERGED_NANORINF)
    _, outcome, _, _ = iterate(primal, random_part(n), max_it=2)
    agree(outcome.reason == Reason.DIVERGED_MAX_IT and outcome.iterations == 2)


def test_singular_symmetric_part(torn_grid, feti):
    """A dof inside that only a skew part holds: the message asks for other subdomains."""

    def change(K, dofs):
        j = 2 * 5  # an inner node of the first subdomain
        K[0][j] = -K[0][:, j]
        K[0][j, j] = 0.0

    problem = torn_grid(change=change, **GRID)
    ksp = feti(problem.A)
    agree(solve(ksp, problem, random_values(problem))[0] == Reason.DIVERGED_PCSETUP_FAILED)
    context = ksp.getPythonContext()
    agree("symmetric part" in context.message and "other subdomains" in context.message)
    agree(not context.singular)
