# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Spectra agree with theory and the paper, solutions with dense matrices, also under prestress.

With the Dirichlet preconditioner λ_min ≥ 1 for any weight Q of the projection, and λ_max ≤ C (1 +
log H/h)² (Mandel, Tezaur 1996; Klawonn, Widlund 2001).
"""

import itertools

import numpy as np
import paper_cube
import pytest
from cases import case, each, every_q, every_type
from collective import agree, dense, equal, matrix_of_map, small, whole
from hand_torn import random_values, solve, solve_and_check

from dolfinx_feti.feti.dual import krylov
from dolfinx_feti.feti.dual.recovery import recover
from dolfinx_feti.feti.interface.scaling import SCALINGS
from dolfinx_feti.feti.subsolver_options import KrylovOptions

ROUNDING = 1e-6

#: The paper's options.
PAPER = {
    "formulation": "dual",
    "scaling": "multiplicity",
    "coarse_q": "identity",
    "coarse_modes": 0,
}
#: The dual method ends by its own tolerance, in the norm √(r·z) that CG itself computes, and not by
#: the assembled residual.
EXACT = {"feti_dual_ksp_rtol": 1e-10, "feti_dual_ksp_norm_type": "natural"}

every_pc = pytest.mark.parametrize("pc_type", ["dirichlet", "lumped", "identity"])


def spectrum(create_ksp, problem, load=1.0, **options):
    """Return the extreme Ritz values of the dual system for a random load, without soft modes.

    Args:
        create_ksp: The fixture.
        problem: Problem torn by hand.
        load: Factor of the load on free dofs; prescribed values stay.
        **options: FETI's options, without prefix.
    """
    options = {"formulation": "dual", "coarse_modes": 0} | options
    ksp = create_ksp(problem.A, ksp_rtol=1e-10, **{f"feti_{key}": o for key, o in options.items()})
    values = random_values(problem, seed=11213)
    reason, _ = solve(ksp, problem, np.where(problem.dirichlet, values, load * values))
    agree(reason > 0, ksp.getPythonContext().message)
    agree(ksp.getPythonContext().method == "cg")
    return ksp.getPythonContext().eigenvalues


def eigenvalues(formulation):
    """Return the eigenvalues of P M Pᵀ F on balanced multipliers modulo the kernel of Bᵀ, dense.

    If Q contains M, M is the preconditioner plus Q's diagonal part.
    """
    F = matrix_of_map(formulation.system.flexibility, formulation.system.m)
    M = matrix_of_map(lambda r: formulation.preconditioner.apply(r)[0], formulation.system.m)
    if formulation.coarse.MG is not None:
        M += np.diag(whole(formulation.coarse.q.array_r))
    G, N = (dense(getattr(formulation.coarse, name)) for name in ("G", "N"))
    QG = matrix_of_map(formulation.system.weighted_jump, formulation.coarse.n_c)
    P = np.eye(len(F)) - QG @ np.linalg.solve(N, G.T)
    values, vectors = np.linalg.eigh(P.T @ F @ P)
    root = vectors * np.sqrt(np.where(values > 1e-9 * values[-1], values, 0.0))
    values = np.linalg.eigvalsh(root.T @ M @ root)
    return values[values > 1e-9 * values[-1]]


# ---- the paper's table ----------------------------------------------------------------------


@every_type
@pytest.mark.parametrize(
    ("pc_type", "all_floating", "classical"),
    [
        pytest.param("identity", 53.6, 98.2, marks=pytest.mark.serial),  # one is enough on several
        pytest.param("lumped", 10.3, 14.1, marks=pytest.mark.serial),
        ("dirichlet", 7.6, 10.0),
    ],
)
def test_condition_numbers_of_the_paper(
    kind, pc_type, all_floating, classical, create_ksp, lifetime
):
    """The paper's cube on the coarsest level: 512 subdomains, multiplicity scaling, Q = I."""
    problem = lifetime.own(paper_cube.cube(8))
    options = {"type": kind, "pc_type": pc_type, "scaling": "multiplicity"}
    low, high = spectrum(create_ksp, problem, load=0.0, coarse_q="identity", **options)
    expected = all_floating if kind == "all_floating" else classical
    agree(abs(high / low - expected) < 0.008 * expected, (high / low, expected))


# ---- bounds ---------------------------------------------------------------------------------

GRIDS = {
    "row": case((6,), (3,)),
    "cross points": case((3, 3), (3, 3)),
    "plane strain": case((3, 2), (2, 3), 2),
    "solid": case((2, 2, 2), (2, 1, 2), 3),
    "jumps": case((3, 3), (2, 2), stiffness=lambda i: 10.0 ** (3 * (i % 2))),
}


@each("grid", GRIDS)
@every_type
def test_no_eigenvalue_below_one(grid, kind, torn_grid, create_ksp):
    """The lowest Ritz value is at least one for all scalings and weights Q.

    This also holds for the lumped preconditioner, which bounds the Dirichlet preconditioner.
    """
    problem = torn_grid(**grid)
    for pc_type, scaling, q in itertools.product(
        ("dirichlet", "lumped"), SCALINGS, ("preconditioner", "diagonal", "identity")
    ):
        options = {"pc_type": pc_type, "scaling": scaling, "coarse_q": q}
        low, high = spectrum(create_ksp, problem, type=kind, **options)
        # In 1-D the coarse problem alone may solve; then there are no Ritz values.
        needs_no_iteration = len(grid["subdomains"]) == 1 and np.isnan(high)
        if not needs_no_iteration:
            agree(low >= 1.0 - ROUNDING, options)


@pytest.mark.parametrize("grid", [GRIDS["cross points"], GRIDS["plane strain"]])
@every_q
@every_pc
def test_ritz_values_lie_in_the_dense_spectrum(
    grid, q, pc_type, torn_grid, create_dual, create_ksp
):
    """Those of CG lie inside the spectrum and come close to its ends."""
    problem = torn_grid(**grid)
    values = eigenvalues(create_dual(problem.A, pc_type=pc_type, coarse_q=q))
    if pc_type != "identity":
        agree(values[0] >= 1.0 - 1e-9)
    low, high = spectrum(create_ksp, problem, pc_type=pc_type, coarse_q=q)
    agree(values[0] - ROUNDING <= low and high <= values[-1] + ROUNDING, (values, low, high))
    agree(abs(high - values[-1]) < 0.02 * values[-1], (values[-1], high))
    agree(abs(low - values[0]) < 0.05 * values[0], (values[0], low))


def corners_and_edges(x):
    """Mark Dirichlet dofs of a cube of 3³ subcubes so that kernels have all dimensions.

    A face of one subcube is clamped, and so an edge or a vertex of its neighbours; components are
    fixed in an edge of another one (two of them), and in two corners (one of them, and two).
    """
    face = (x[:, 0] == 0) & np.all(x <= 1, axis=1)
    mark = np.repeat(face[:, None], 3, axis=1)
    mark[(x[:, 0] == 3) & (x[:, 1] == 3) & (x[:, 2] <= 1), :2] = True
    mark[np.all(x == (3, 0, 0), axis=1), :2] = True
    mark[np.all(x == (3, 3, 3), axis=1), 0] = True
    return mark


def test_lower_bound_holds_for_kernels_of_all_dimensions(create_ksp, lifetime):
    """Subdomains of one decomposition have zero to six rigid modes."""
    problem = lifetime.own(paper_cube.cube(3, fixed=corners_and_edges))
    options = {f"feti_{name}": value for name, value in PAPER.items()}
    ksp = create_ksp(problem.A, feti_type="classical", **options)
    solve(ksp, problem, random_values(problem))
    context = ksp.getPythonContext()
    agree(context.report().kernels == (1, 2, 1, 1, 2, 1, 19))
    agree(context.eigenvalues[0] >= 1.0 - ROUNDING, context.eigenvalues)
    small(context.residual, 1e-8)


# ---- growth ---------------------------------------------------------------------------------


@every_type
@each("problem", {"Laplace": ((4, 4), 1), "plane strain": ((3, 3), 2)})
@pytest.mark.parametrize("q", ["preconditioner", "identity"])
def test_condition_grows_no_faster_than_a_squared_logarithm(
    problem, q, kind, torn_grid, create_ksp
):
    """κ/(1 + log H/h)² does not grow with H/h; the lumped preconditioner has a larger κ."""
    ratios = np.array([4, 8, 16])
    condition = {"dirichlet": [], "lumped": []}
    for n, pc_type in itertools.product(ratios, condition):
        grid = torn_grid(problem[0], (n, n), components=problem[1])
        low, high = spectrum(create_ksp, grid, type=kind, coarse_q=q, pc_type=pc_type)
        condition[pc_type].append(high / low)
    quotient = np.array(condition["dirichlet"]) / (1.0 + np.log(ratios)) ** 2
    agree(np.all(quotient[1:] <= 1.05 * quotient[:-1]), (condition, quotient))
    agree(condition["lumped"][-1] > 3.0 * condition["dirichlet"][-1], condition)


@every_type
@pytest.mark.parametrize("components", [1, 2])
def test_condition_is_bounded_in_the_number_of_subdomains(components, kind, torn_grid, create_ksp):
    """For H/h = 4 and 4 to 100 subdomains κ stays below 12."""
    condition = []
    for n in (2, 5, 10):
        low, high = spectrum(
            create_ksp, torn_grid((n, n), (4, 4), components=components), type=kind
        )
        condition.append(high / low)
    agree(condition[-1] < 1.15 * condition[-2], condition)
    agree(condition[-1] < 12.0, condition)


@every_type
def test_stiffness_scaling_is_robust_to_jumps(kind, torn_grid, create_ksp):
    """On a checkerboard with a jump of 10⁶ κ stays small; multiplicity scaling makes it large."""
    condition = {}
    for jump, scaling in ((1.0, "stiffness"), (1e6, "stiffness"), (1e6, "multiplicity")):
        grid = torn_grid((5, 3), (4, 4), stiffness=lambda i, jump=jump: jump ** (i % 2))
        options = {"feti_type": kind, "feti_scaling": scaling, "feti_formulation": "dual"}
        ksp = create_ksp(grid.A, ksp_rtol=1e-6, **options)
        _, x = solve(ksp, grid, random_values(grid))
        condition[jump, scaling] = ksp.getPythonContext().condition_number
        agree(np.all(np.isfinite(x)))
    agree(condition[1e6, "stiffness"] <= 1.5 * condition[1.0, "stiffness"], condition)
    agree(condition[1e6, "multiplicity"] > 100 * condition[1e6, "stiffness"], condition)


# ---- Lanczos' method, with and without reorthogonalisation ----------------------------------


@pytest.fixture
def grid_with_jumps(torn_grid):
    """Return six squares in plane strain, every other one 10³ times stiffer."""
    return torn_grid((2, 3), (3, 3), components=2, stiffness=lambda i: 1e3 ** (i % 2))


@every_type
@every_pc
def test_reorthogonalised_cg_finds_the_ends_of_the_spectrum(
    kind, pc_type, grid_with_jumps, create_dual, create_ksp
):
    """κ is exact to 1e-6, and no iteration is spent on a second copy of an eigenvalue.

    In exact arithmetic there are no more iterations than different eigenvalues. All-floating and
    lumped, no load reaches the lowest eigenvectors, which pull the copies of a Dirichlet dof apart.
    """
    settings = {"type": kind, "pc_type": pc_type, **PAPER}
    values = eigenvalues(create_dual(grid_with_jumps.A, **settings))
    distinct = 1 + np.count_nonzero(np.diff(values) > 1e-9 * values[1:])
    options = {f"feti_{name}": value for name, value in settings.items()}
    contexts = []
    for method in ("cg", "fcg"):
        ksp = create_ksp(grid_with_jumps.A, feti_dual_ksp_type=method, **options, **EXACT)
        reason, _ = solve(ksp, grid_with_jumps, random_values(grid_with_jumps, seed=11215))
        contexts.append(ksp.getPythonContext())
        agree(
            reason > 0 and contexts[-1].method == method,
            (contexts[-1].method, contexts[-1].message),
        )
    cg, reorthogonalised = contexts
    agree(reorthogonalised.iterations <= distinct + 1, (reorthogonalised.iterations, distinct))
    agree(reorthogonalised.iterations < cg.iterations)
    small(reorthogonalised.eigenvalues[1] / values[-1] - 1.0, 1e-6)
    if (kind, pc_type) != ("all_floating", "lumped"):
        small(reorthogonalised.condition_number * values[0] / values[-1] - 1.0, 1e-6)


@pytest.mark.parametrize("method", ["cg", "fcg"])
def test_later_solves_may_have_a_larger_iteration_limit(method, grid_with_jumps, create_ksp):
    """PETSc allocates the coefficients of Lanczos' method at set-up, for the limit of that time."""
    ksp = create_ksp(
        grid_with_jumps.A, feti_pc_type="identity", feti_dual_ksp_type=method, ksp_max_it=2
    )
    counts = []
    for max_it in (2, 1000, 5, 1000):
        ksp.setTolerances(max_it=max_it)
        reason, _ = solve(ksp, grid_with_jumps, random_values(grid_with_jumps))
        counts.append(ksp.getPythonContext().iterations)
        agree((reason > 0) == (max_it == 1000))
    agree(counts[0] == 2 and counts[2] == 5, counts)
    agree(counts[1] == counts[3] > 20, counts)


# ---- multipliers, displacements and the assembled problem -------------------------------------

SEED = 101013

PROBLEMS = {
    "Laplace in 1-D": case((5,), (3,)),
    "Laplace in 2-D": case((3, 2), (2, 3)),
    "Laplace in 3-D": case((2, 2, 2), (2, 2, 1)),
    "elasticity in 2-D": case((2, 3), (3, 2), 2),
    "elasticity in 3-D": case((2, 2, 1), (1, 2, 2), 3),
    "jumping stiffness": case((3, 2), (2, 2), 2, stiffness=lambda i: 20.0 ** (i % 2)),
    "component-wise conditions": case((2, 2), (2, 2), 2, fixed=lambda x: x == 0.0),
    "held in single nodes": case(
        (2, 2), (2, 2), 2, fixed=lambda x: np.isin(np.arange(len(x)), (0, len(x) - 1))
    ),
    "no rotations in the near kernel": case((2, 2), (2, 2), 2, modes=2),
}
every_grid = each("grid", PROBLEMS)


def opposed_prestress(size):
    """Return a change that adds X to one side of each interface and −X to the other.

    The assembled matrix stays as it is.

    Args:
        size: Size of X relative to the largest entry of K_i.
    """

    def change(K, dofs):
        rng = np.random.default_rng(SEED + 1)
        for i in range(len(K)):
            for j in range(i):
                common = np.intersect1d(dofs[i], dofs[j])
                if len(common) < 4:
                    continue
                half = rng.standard_normal((len(common), len(common)))
                X = size * np.abs(K[i]).max() * (half + half.T) / np.sqrt(len(common))
                for k, sign in ((i, 1.0), (j, -1.0)):
                    rows = np.searchsorted(dofs[k], common)
                    K[k][np.ix_(rows, rows)] += sign * X

    return change


@every_grid
@every_type
def test_multipliers_and_displacements_agree_with_a_dense_solve(grid, kind, torn_grid, create_dual):
    """Bᵀλ is unique, and u solves K u + Bᵀλ = f, B u = c."""
    problem = torn_grid(**grid)
    formulation = create_dual(problem.A, type=kind)
    torn = formulation.torn
    gluing = formulation.pattern.gluing
    b = problem.vector(random_values(problem))
    u_D = np.where(torn.is_dirichlet_copy, torn.tear(b.array_r), 0.0)
    f = formulation.torn_load(b, u_D)
    c = gluing.gap(u_D)
    start, jump = formulation.system.start(f, c)
    correction, _ = krylov.solve(
        formulation.system,
        jump,
        formulation.method,
        KrylovOptions(""),
        target=1e-12 * b.norm(),
        max_it=500,
        monitor=lambda *_: None,
    )
    multipliers = start + correction
    lam = whole(multipliers.lam)
    recovered = recover(formulation.system, multipliers, f, c)
    u = whole(np.where(formulation.pattern.is_fixed, u_D, recovered))

    B = dense(gluing.B)
    G = dense(formulation.coarse.G)
    is_dirichlet = problem.dirichlet[problem.to_global]
    free = ~whole(formulation.pattern.is_fixed)
    K = problem.K_torn[np.ix_(free, free)]
    C = B[:, free]
    saddle = np.block([[K, C.T], [C, np.zeros(2 * [len(C)])]])  # K u + Bᵀ λ = f, B u = c
    expected = np.linalg.lstsq(saddle, np.concatenate([whole(f)[free], whole(c)]), rcond=1e-12)[0]
    equal(C.T @ lam, C.T @ expected[len(K) :], 1e-8)
    equal(u[free], expected[: len(K)], 1e-8)
    equal(u[is_dirichlet], (problem.T @ whole(b.array_r))[is_dirichlet], 1e-8)
    small(np.abs(B @ u - whole(c)).max(), 1e-8 * np.abs(u).max())
    equal(G.T @ lam, whole(formulation.coarse.restrict(f)), 1e-8)


@every_grid
@every_type
def test_solution_and_reported_residual_are_exact(grid, kind, torn_grid, create_ksp):
    """The residual is relative to the load on the free dofs, with that of prescribed values."""
    problem = torn_grid(**grid)
    values = random_values(problem)
    free = ~problem.dirichlet
    K = problem.matrix
    ksp = create_ksp(problem.A, feti_type=kind, ksp_rtol=1e-10)
    reason, x = solve(ksp, problem, values)
    agree(reason > 0, ksp.getPythonContext().message)
    equal(x, problem.solve(values), 1e-8)
    scale = np.linalg.norm((values - K @ np.where(free, 0.0, values))[free])
    residual = np.linalg.norm((values - K @ x)[free]) / scale
    small(residual, 1e-10)
    equal(ksp.getPythonContext().residual, residual, 1e-2 + 1e-14 / residual)


# ---- prestress ------------------------------------------------------------------------------


@every_type
@pytest.mark.parametrize("size", [1e-7, 1e-3, 0.1, 0.5])
@pytest.mark.parametrize("enriched", [True, False], ids=["enrich", "gmres"])
def test_self_equilibrated_prestress_leaves_the_solution_unchanged(
    size, kind, enriched, torn_grid, create_ksp, monkeypatch
):
    """Kernels and definiteness of subdomains change, but not the assembled matrix."""
    grid = {"subdomains": (2, 2), "cells": (3, 3), "components": 2}
    plain = torn_grid(**grid)
    problem = torn_grid(**grid, change=opposed_prestress(size))
    values = random_values(problem)
    equal(problem.solve(values), plain.solve(values), 1e-10)
    if not enriched:
        monkeypatch.setattr("dolfinx_feti.feti.subdomain.mode_search.MAX_BUCKLING_ROUNDS", 0)
    context = solve_and_check(
        create_ksp(problem.A, feti_type=kind, ksp_rtol=1e-11), problem, values=values
    )
    report = context.report()
    agree(report.exact < 4, report)
    if size == 0.5:
        agree(report.inertia.dual > 0)
        # where K_ρ is positive definite, the primal form takes over
        agree(context.method == ("cg" if enriched else "gmres"))


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("size", [1e-8, 1e-2])
@pytest.mark.parametrize("formulation", ["auto", "dual"])
def test_interior_prestress_of_either_sign_is_solved(
    sign, size, formulation, torn_grid, create_ksp
):
    """K R ≠ 0 in two subdomains, so that D ≠ 0 there.

    The dual system is indefinite if D is, and takes GMRES.
    """

    def change(K, dofs):
        rng = np.random.default_rng(SEED + 2)
        interior = slice(8, 10)  # the middle node of a 2 × 2 brick
        for i in (0, 2):
            half = rng.standard_normal((2, 2))
            K[i][interior, interior] += sign * size * np.abs(K[i]).max() * (half @ half.T)

    problem = torn_grid((2, 2), (2, 2), components=2, change=change)
    ksp = create_ksp(problem.A, ksp_rtol=1e-11, feti_formulation=formulation)
    context = solve_and_check(ksp, problem)
    report = context.report()
    agree(report.exact == 2)
    agree((report.inertia.defect > 0) == (sign < 0), report.inertia)
    needs_gmres = formulation == "dual" and sign < 0
    agree(context.method == ("gmres" if needs_gmres else "cg"), context.method)
    agree(report.formulation == ("dual" if formulation == "dual" else "primal"))
