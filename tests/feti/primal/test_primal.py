# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The primal formulation: its preconditioner and spectrum, and GMRES for an unsymmetric matrix."""

from petsc4py import PETSc

import numpy as np
import primal_form
import pytest
from cases import case, each, every_interior, every_scaling, every_type
from collective import COMM, agree, dense, equal, matrix_of_map, random_part, small, whole
from hand_torn import (
    one_sided,
    random_values,
    scaled_diagonal,
    softened,
    solve,
    solve_and_check,
    unsymmetric,
)

from dolfinx_feti.feti.primal.formulation import create_primal_formulation
from dolfinx_feti.feti.primal.krylov import gmres as gmres_module
from dolfinx_feti.feti.primal.krylov.gmres import gmres
from dolfinx_feti.feti.primal.preconditioner import create_symmetric_part_preconditioner
from dolfinx_feti.feti.primal.stopping import StoppingTest
from dolfinx_feti.feti.setup import set_up_operator
from dolfinx_feti.feti.solve_info import DeflationVectors
from dolfinx_feti.runtime.petsc_options import inserted

SEED = 1993
GRID = case((3, 2), (3, 2), 2)
Reason = PETSc.KSP.ConvergedReason
CHANGES = {"no prestress": None, "tension": scaled_diagonal(1.01), "compression": softened(0.0001)}
every_change = each("change", CHANGES)


def on_assembled_vectors(of_copies, exact):
    """Return a map of copies, (n, n), as one of assembled vectors, (N, N): average, map, copy."""
    return exact.average @ of_copies @ exact.T


def check_solution(problem, primal, values):
    """Assert that the primal form solves with prescribed values; return its SolveInfo."""
    b = problem.vector(values)
    torn = primal.pattern.torn
    u_D = np.where(torn.is_dirichlet_copy, torn.tear(b.array_r), 0.0)
    settings = {"target": 1e-10 * b.norm(), "max_it": 200, "monitor": lambda *_: None}
    u, info = primal.solve(b, u_D, **settings)
    b.destroy()
    equal(whole(u), problem.T @ problem.solve(values), 1e-8)
    return info


@every_change
@every_type
@every_interior
def test_operator_and_preconditioner_agree_with_dense_formulas(
    change, kind, interior, torn_grid, create_primal
):
    """A = Tᵀ S T and M = Π Tᵀ δ K_ρ⁻¹ δ T + V A₀⁻¹ Vᵀ, and the solution with them."""
    problem = torn_grid(change=change, **GRID)
    primal = create_primal(problem, type=kind, interior=interior, coarse_modes=2)
    exact = primal_form.reference(problem, primal)
    system = primal.system
    n = primal.system.copies.size
    zero = np.zeros(n)
    A = -matrix_of_map(lambda x: system.residual(zero, x), n)
    M = matrix_of_map(lambda r: system.precondition(r)[0], n)
    equal(on_assembled_vectors(A, exact), exact.A, 1e-11)
    equal(on_assembled_vectors(M, exact), exact.preconditioner + exact.coarse, 1e-9)
    outcome = check_solution(problem, primal, random_values(problem, SEED))
    agree(outcome.reason == Reason.CONVERGED_RTOL)


@every_type
@every_interior
@pytest.mark.parametrize("modes", [0, 3])
def test_spectrum_is_that_of_the_dual_form_above_one(
    kind, interior, modes, torn_grid, create_primal, create_dual
):
    """Without prestress no eigenvalue is below one, and those above one are the same."""
    problem = torn_grid(**GRID)
    primal = create_primal(problem, type=kind, interior=interior, coarse_modes=modes)
    exact = primal_form.reference(problem, primal)
    balanced = np.linalg.eigvals(exact.preconditioner @ exact.A).real
    primal_values = np.sort(balanced[balanced > 1e-6])
    agree(len(balanced) - len(primal_values) == np.linalg.matrix_rank(exact.V))
    agree(primal_values.min() >= 1.0 - 1e-9)
    if modes:
        return  # soft modes have D ≠ 0
    formulation = create_dual(problem.A, type=kind, interior=interior, coarse_modes=modes)
    F = matrix_of_map(formulation.system.flexibility, formulation.system.m)
    M = matrix_of_map(lambda x: formulation.preconditioner.apply(x)[0], formulation.system.m)
    G = dense(formulation.coarse.G)
    P = np.eye(len(F)) - M @ G @ np.linalg.pinv(G.T @ M @ G, rcond=1e-10, hermitian=True) @ G.T
    dual_values = np.linalg.eigvals(P @ M @ P.T @ F).real
    above = 1.0 + 1e-6
    equal(primal_values[primal_values > above], np.sort(dual_values[dual_values > above]), 1e-7)


@pytest.mark.parametrize(
    ("share", "proved"), [(0.002, 0), (0.02, 3)], ids=["met-by-CG", "found-by-the-coarse-space"]
)
def test_indefinite_matrix_is_reported_by_cg(share, proved, torn_grid, create_primal):
    """K_ρ is definite, so that the factors of subdomains do not show it."""
    problem = torn_grid((2, 2), (4, 4), components=2, change=softened(share))
    primal = create_primal(problem, type="all_floating", interior="eliminate", coarse_modes=0)
    exact = primal_form.reference(problem, primal)
    agree(np.linalg.eigvalsh(exact.A)[0] < 0.0 < np.linalg.eigvalsh(exact.S_ρ)[0])
    agree(primal.coarse.negative_eigenvalues == proved)
    _, outcome = primal_form.cg(primal.system, random_part(primal.system.copies.size))
    agree(outcome.reason == Reason.DIVERGED_INDEFINITE_MAT)


def test_ritz_values_follow_from_the_coefficients_of_cg(torn_grid, create_primal):
    """They are the extreme eigenvalues of the preconditioned operator."""
    problem = torn_grid((2, 2), (2, 2), components=2)
    primal = create_primal(problem, type="all_floating", interior="keep", coarse_modes=0)
    exact = primal_form.reference(problem, primal)
    values = np.linalg.eigvals(exact.preconditioner @ exact.A).real
    _, info = primal_form.cg(primal.system, random_part(primal.system.copies.size), rtol=1e-13)
    equal(info.ritz_values, [values[values > 1e-6].min(), values.max()], 1e-6)


def test_single_subdomain_needs_no_iteration(torn_grid, create_primal):
    """It has no interface; the other processes have no subdomain."""
    problem = torn_grid((1, 1), (3, 2), components=2)
    primal = create_primal(problem, type="classical", interior="keep")
    agree(check_solution(problem, primal, np.ones(len(problem.dirichlet))).iterations == 0)


def test_copies_agree_to_the_last_bit(torn_grid, create_primal):
    """Each copy gets the same sum, in whatever order the processes answer."""
    problem = torn_grid((2, 2, 2), (2, 2, 2))
    primal = create_primal(problem)
    copies = primal.system.copies
    t = np.random.default_rng(SEED + COMM.rank).standard_normal(copies.size)
    total = whole(copies.sum(t))
    dof = problem.to_global[whole(copies.dofs + primal.pattern.torn.first_torn_dof)]
    for of_dof in np.unique(dof):
        agree(len(np.unique(total[dof == of_dof])) == 1)


# ---- GMRES, with the preconditioner of the symmetric part -----------------------------------

WIDE = case((3, 2), (3, 3), 2)


@pytest.fixture
def create_unsymmetric_primal(read_pattern, lifetime, double_precision_products, monkeypatch):
    """Return a function that builds the primal form of an unsymmetric matrix."""
    monkeypatch.setattr("dolfinx_feti.feti.subdomain.scaled.MAX_SINGLE_PRECISION_ERROR", 0.0)

    def create(problem, vectors=None, **options):
        read = read_pattern(problem.A, formulation="primal", interior="auto", **options)
        S = set_up_operator(read, lifetime)
        preconditioner = create_symmetric_part_preconditioner(read, lifetime)
        return create_primal_formulation(
            read, S, preconditioner, lifetime, vectors, max_ritz_vectors=20
        )

    return create


def solve_by_gmres(form, f, *, max_it=200):
    """Solve by GMRES to 1e-10 of the right-hand side.

    Returns:
        Solution, (n_Γ,), how the method ended, the basis, and the norms of all residuals.
    """
    system = form.system
    norms = []
    stopping = StoppingTest(1e-10 * system.norm(system.copies.sum(f)), max_it)
    results = gmres(
        system,
        f,
        stopping,
        monitor=lambda its, norm: norms.append(norm),
        stored_iterations=200,
        allow_indefinite=False,
    )
    return *results, norms


def dense_on_assembled_vectors(apply, form, T):
    """Return the matrix, (N, N), of a map of assembled vectors that is given by copies.

    Args:
        apply: Maps copies of an assembled vector, (n_Γ,), to copies of the result.
        form: The primal form.
        T: Copies of the free interface dofs, (n_Γ, N) of all processes.
    """
    average = T.T * whole(form.system.copies.delta)
    return average @ matrix_of_map(apply, form.system.copies.size) @ T


@every_type
def test_operators_of_an_unsymmetric_matrix_agree_with_dense_formulas(
    kind, torn_grid, create_unsymmetric_primal
):
    """A = Tᵀ S T of K; in M, K_ρ is that of ½ (K + Kᵀ), and Π that of K."""
    problem = torn_grid(change=unsymmetric(0.1), **WIDE)
    primal = create_unsymmetric_primal(problem, type=kind, coarse_modes=2)
    system = primal.system
    basis = primal.coarse.V
    torn = primal.pattern.torn
    rows = whole(system.copies.dofs + torn.first_torn_dof)
    inside = np.setdiff1d(np.flatnonzero(~whole(primal.pattern.is_fixed)), rows)
    T = problem.T[rows][:, ~problem.dirichlet]
    T = T[:, T.any(axis=0)]
    K = problem.K_torn
    zero = np.zeros(system.copies.size)
    X = np.linalg.solve(K[np.ix_(inside, inside)], K[np.ix_(inside, rows)])
    A = T.T @ (K[np.ix_(rows, rows)] - K[np.ix_(rows, inside)] @ X) @ T
    equal(dense_on_assembled_vectors(lambda x: -system.residual(zero, x), primal, T), A, 1e-11)
    average = T.T * whole(system.copies.delta)
    V = average @ matrix_of_map(basis.prolong, basis.n_c)
    coarse = V @ np.linalg.pinv(V.T @ A @ V, rcond=1e-10) @ V.T
    solve = primal.preconditioner.inverse.solve_regularised_on_interface
    K_ρ = np.linalg.inv(matrix_of_map(solve, system.copies.size))
    equal(K_ρ, K_ρ.T, 1e-8)
    M = average @ np.linalg.solve(K_ρ, average.T)
    expected = M - coarse @ A @ M + coarse
    equal(
        dense_on_assembled_vectors(lambda r: system.precondition(r)[0], primal, T), expected, 1e-8
    )


@pytest.mark.parametrize("solver", ["mumps", "petsc"])
def test_transposed_products_agree_with_products(solver, torn_grid, read_pattern, lifetime):
    """Yᵀ (S X) = (Sᵀ Y)ᵀ X in each subdomain, for all columns at once and for none."""
    problem = torn_grid(change=unsymmetric(0.1), **WIDE)
    with inserted("test_feti_dirichlet_", {"pc_factor_mat_solver_type": solver}):
        read = read_pattern(problem.A, formulation="primal", interior="auto")
        S = set_up_operator(read, lifetime)
    for S_i in S.by_subdomain:
        n = len(S_i.subdomain.interface)
        X, Y = np.random.default_rng(SEED).standard_normal((2, n, 3))
        transposed = S_i.multiply(Y, transpose=True)
        equal(Y.T @ S_i.multiply(X), transposed.T @ X, 1e-12)
        agree(S_i.multiply(X[:, :0], transpose=True).shape == (n, 0))


@pytest.mark.parametrize("count", [0, 4])
def test_gmres_reduces_the_residual_of_the_assembled_system(
    count, torn_grid, create_unsymmetric_primal
):
    """A Z = R H with Rᵀ R = I; residuals are orthogonal to V and W, with the monitored norms."""
    problem = torn_grid(change=unsymmetric(0.1, skew=True), **WIDE)
    plain = create_unsymmetric_primal(problem)
    copies = plain.system.copies
    f = random_part(plain.system.copies.size)
    W = [copies.average(random_part(copies.size, seed=7 + j)) for j in range(count)]
    W = np.column_stack(W or [f])[:, :count]
    primal = create_unsymmetric_primal(problem, DeflationVectors(W, W))
    system = primal.system
    δ = copies.delta[:, None]
    agree(primal.deflation.count == count)
    _, outcome, basis, norms = solve_by_gmres(primal, f)
    agree(outcome.reason == Reason.CONVERGED_RTOL and len(norms) == outcome.iterations + 1)
    agree(np.all(np.diff(norms) <= 0.0))
    R = basis.R.T
    Z = basis.Z.T
    H = basis.H
    equal(COMM.allreduce(R.T @ (δ * R)), np.eye(R.shape[1]), 1e-12)
    AZ = np.column_stack([-system.residual(0.0 * z, z) for z in Z.T])
    equal(whole(AZ), whole(R @ H), 1e-10)
    for its in (0, 3, outcome.iterations):
        r = system.residual(f, solve_by_gmres(primal, f, max_it=its)[0])
        small(system.norm(r) / norms[its] - 1.0, 1e-3)
        small(np.abs(COMM.allreduce(W.T @ (δ * r[:, None]))).max(initial=0.0), 1e-8 * norms[0])


def test_gmres_takes_the_iterations_of_cg_for_a_small_skew_part(
    torn_grid, create_ksp, create_unsymmetric_primal
):
    """A skew part of 1e-8 is enough to select GMRES."""
    counts = []
    for share in (0.0, 1e-8):
        problem = torn_grid(change=unsymmetric(share, skew=True), **WIDE)
        ksp = create_ksp(problem.A, feti_formulation="primal")
        agree(solve(ksp, problem, random_values(problem))[0] > 0)
        agree(ksp.getPythonContext().method == ("gmres" if share else "cg"))
        counts.append(ksp.getIterationNumber())
    agree(counts[0] - 2 <= counts[1] <= counts[0], counts)


@every_type
@pytest.mark.parametrize("skew", [True, False], ids=["skew", "indefinite"])
@pytest.mark.parametrize("share", [0.01, 0.3, 3.0])
def test_gmres_solves_unsymmetric_matrices(share, skew, kind, torn_grid, create_ksp):
    """``auto`` takes the primal form, even if the entries are random but for their pattern."""
    problem = torn_grid(change=unsymmetric(share, skew=skew), **WIDE)
    context = solve_and_check(create_ksp(problem.A, feti_type=kind, ksp_rtol=1e-11), problem)
    agree(context.message == "" and context.method == "gmres", context.message)
    report = context.report()
    agree((report.formulation, report.interior) == ("primal", "kept"), report)
    agree(context.inertia.assembled is None)


@pytest.mark.parametrize("components", [1, 2])
@every_scaling
def test_gmres_solves_unsymmetric_patterns(scaling, components, torn_grid, create_ksp):
    """Entries have no mirror, so that ½ (K + Kᵀ) has another pattern than K, and other rows."""
    problem = torn_grid((3, 2), (7, 7), components=components, change=one_sided(0.02))
    context = solve_and_check(create_ksp(problem.A, feti_scaling=scaling, ksp_rtol=1e-11), problem)
    agree(context.method == "gmres" and context.iterations < 25, context.iterations)


def test_fresh_starts_make_up_for_few_gmres_directions(torn_grid, create_ksp, monkeypatch):
    """Without fresh starts the method stagnates, and the message says so."""
    monkeypatch.setattr(gmres_module, "GMRES_DIRECTIONS", 8)
    problem = torn_grid(change=unsymmetric(0.1, skew=True), **WIDE)
    ksp = create_ksp(problem.A, ksp_rtol=1e-10)
    agree(solve_and_check(ksp, problem, 1e-7).iterations > 8)
    monkeypatch.setattr("dolfinx_feti.feti.outer_loop.MAX_FRESH_STARTS", 0)
    agree(solve(ksp, problem, random_values(problem))[0] == Reason.DIVERGED_BREAKDOWN)
    agree("stagnates" in ksp.getPythonContext().message)


def test_singular_symmetric_part_is_reported(torn_grid, create_ksp):
    """An interior dof is held only by a skew part: the message suggests other subdomains."""

    def change(K, dofs):
        j = 2 * 5  # an inner node of the first subdomain
        K[0][j] = -K[0][:, j]
        K[0][j, j] = 0.0

    problem = torn_grid(change=change, **WIDE)
    ksp = create_ksp(problem.A)
    agree(solve(ksp, problem, random_values(problem))[0] == Reason.DIVERGED_PCSETUP_FAILED)
    context = ksp.getPythonContext()
    agree("symmetric part" in context.message and "other subdomains" in context.message)
    agree(not context.singular)
