# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What theory and the paper say of the spectrum of the preconditioned dual operator.

With the Dirichlet preconditioner λ_min ≥ 1 for any weight Q of the projection, and
λ_max ≤ C (1 + log H/h)² (Mandel, Tezaur 1996; Klawonn, Widlund 2001).
"""

import itertools

import numpy as np
import paper_cube
import pytest
from cases import case, each, every_type
from collective import agree, dense, matrix_of_map, small, whole
from hand_torn import random_values, solve

ROUNDING = 1e-6

#: What the paper takes, and a test on the dual residual that CG can meet exactly.
PAPER = {"scaling": "multiplicity", "coarse_q": "identity", "coarse_modes": 0}
EXACT = {"feti_dual_ksp_rtol": 1e-10, "feti_dual_ksp_norm_type": "natural"}

every_pc = pytest.mark.parametrize("pc_type", ["dirichlet", "lumped", "identity"])


def spectrum(feti, problem, load=1.0, **options):
    """Ritz values of a CG solve with random loads, without soft modes: the paper's coarse space."""
    options.setdefault("coarse_modes", 0)
    ksp = feti(problem.A, ksp_rtol=1e-10, **{f"feti_{key}": o for key, o in options.items()})
    values = random_values(problem, seed=11213)
    reason, _ = solve(ksp, problem, np.where(problem.dirichlet, values, load * values))
    agree(reason > 0, ksp.getPythonContext().message)
    agree(ksp.getPythonContext().method == "cg")
    return ksp.getPythonContext().eigenvalues


def eigenvalues(system):
    """Eigenvalues of P M Pᵀ F on the balanced multipliers modulo the kernel of Bᵀ, dense.

    Where Q has M in it, it stands for M.
    """
    F = matrix_of_map(system.dual.flexibility, system.dual.m)
    M = matrix_of_map(lambda r: system.preconditioner.apply(r)[0], system.dual.m)
    if system.coarse.MG is not None:
        M += np.diag(whole(system.coarse.q.array_r))
    G, N = (dense(getattr(system.coarse, name)) for name in ("G", "N"))
    QG = matrix_of_map(system.dual.weighted_jump, system.coarse.size)
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
def test_condition_numbers_of_the_paper(kind, pc_type, all_floating, classical, feti, lifetime):
    """Its cube on the coarsest level: 512 subdomains, multiplicity scaling, Q = I."""
    problem = lifetime.own(paper_cube.cube(8))
    options = {"type": kind, "pc_type": pc_type, "scaling": "multiplicity"}
    low, high = spectrum(feti, problem, load=0.0, coarse_q="identity", **options)
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
def test_no_eigenvalue_below_one(grid, kind, torn_grid, feti):
    """The Ritz values of CG for all scalings and weights Q; lumped bounds Dirichlet."""
    problem = torn_grid(**grid)
    for pc_type, scaling, q in itertools.product(
        ("dirichlet", "lumped"),
        ("stiffness", "multiplicity"),
        ("preconditioner", "diagonal", "identity"),
    ):
        options = {"pc_type": pc_type, "scaling": scaling, "coarse_q": q}
        low, high = spectrum(feti, problem, type=kind, **options)
        exact = len(grid["subdomains"]) == 1 and np.isnan(high)  # in a row, no iteration is needed
        agree(exact or low >= 1.0 - ROUNDING, (options, low))


@pytest.mark.parametrize("grid", [GRIDS["cross points"], GRIDS["plane strain"]])
@pytest.mark.parametrize("q", ["preconditioner", "diagonal", "identity"])
@every_pc
def test_ritz_values_against_a_dense_eigensolver(grid, q, pc_type, torn_grid, parts, feti):
    """CG's extreme values lie inside the spectrum and reach its ends."""
    problem = torn_grid(**grid)
    values = eigenvalues(parts(problem.A, pc_type=pc_type, coarse_q=q))
    if pc_type != "identity":
        agree(values[0] >= 1.0 - 1e-9, values[0])
    low, high = spectrum(feti, problem, pc_type=pc_type, coarse_q=q)
    agree(values[0] - ROUNDING <= low and high <= values[-1] + ROUNDING, (values, low, high))
    agree(abs(high - values[-1]) < 0.02 * values[-1], (values[-1], high))
    agree(abs(low - values[0]) < 0.05 * values[0], (values[0], low))


def corners_and_edges(x):
    """Hold a cube of 3³ subcubes so that kernels have all dimensions.

    A face of one subcube is clamped, and so an edge or a vertex of its neighbours; components are
    fixed in an edge of another one (two of them), and in two corners (one of them, and two).
    """
    face = (x[:, 0] == 0) & np.all(x <= 1, axis=1)
    mark = np.repeat(face[:, None], 3, axis=1)
    mark[(x[:, 0] == 3) & (x[:, 1] == 3) & (x[:, 2] <= 1), :2] = True
    mark[np.all(x == (3, 0, 0), axis=1), :2] = True
    mark[np.all(x == (3, 3, 3), axis=1), 0] = True
    return mark


def test_kernels_of_all_dimensions_in_one_decomposition(feti, lifetime):
    """The bound holds whatever is left of the rigid motions."""
    problem = lifetime.own(paper_cube.cube(3, fixed=corners_and_edges))
    options = {f"feti_{name}": value for name, value in PAPER.items()}
    ksp = feti(problem.A, feti_type="classical", **options)
    solve(ksp, problem, random_values(problem))
    context = ksp.getPythonContext()
    agree(context.report().kernels == (1, 2, 1, 1, 2, 1, 19), context.report().kernels)
    agree(context.eigenvalues[0] >= 1.0 - ROUNDING, context.eigenvalues)
    small(context.residual, 1e-8)


# ---- growth ---------------------------------------------------------------------------------


@every_type
@each("problem", {"Laplace": ((4, 4), 1), "plane strain": ((3, 3), 2)})
@pytest.mark.parametrize("q", ["preconditioner", "identity"])
def test_condition_grows_no_faster_than_a_squared_logarithm(problem, q, kind, torn_grid, feti):
    """The quotient κ/(1 + log H/h)² does not grow with H/h; lumped is left behind."""
    ratios, condition = np.array([4, 8, 16]), {"dirichlet": [], "lumped": []}
    for n, pc_type in itertools.product(ratios, condition):
        grid = torn_grid(problem[0], (n, n), components=problem[1])
        low, high = spectrum(feti, grid, type=kind, coarse_q=q, pc_type=pc_type)
        condition[pc_type].append(high / low)
    quotient = np.array(condition["dirichlet"]) / (1.0 + np.log(ratios)) ** 2
    agree(np.all(quotient[1:] <= 1.05 * quotient[:-1]), (condition, quotient))
    agree(condition["lumped"][-1] > 3.0 * condition["dirichlet"][-1], condition)


@every_type
@pytest.mark.parametrize("components", [1, 2])
def test_condition_is_bounded_in_the_number_of_subdomains(components, kind, torn_grid, feti):
    """At H/h = 4 from 4 to 100 subdomains; iterations with it."""
    condition = []
    for n in (2, 5, 10):
        low, high = spectrum(feti, torn_grid((n, n), (4, 4), components=components), type=kind)
        condition.append(high / low)
    agree(condition[-1] < 1.15 * condition[-2], condition)
    agree(condition[-1] < 12.0, condition)


@every_type
def test_stiffness_scaling_does_not_notice_jumps(kind, torn_grid, feti):
    """A checkerboard of 10⁶; with multiplicity scaling the jump is the condition number."""
    condition = {}
    for jump, scaling in ((1.0, "stiffness"), (1e6, "stiffness"), (1e6, "multiplicity")):
        grid = torn_grid((5, 3), (4, 4), stiffness=lambda i, jump=jump: jump ** (i % 2))
        ksp = feti(grid.A, ksp_rtol=1e-6, feti_type=kind, feti_scaling=scaling)
        _, x = solve(ksp, grid, random_values(grid))
        condition[jump, scaling] = ksp.getPythonContext().condition_number
        agree(np.all(np.isfinite(x)))
    agree(condition[1e6, "stiffness"] <= 1.5 * condition[1.0, "stiffness"], condition)
    agree(condition[1e6, "multiplicity"] > 100 * condition[1e6, "stiffness"], condition)


# ---- Lanczos' method, with and without reorthogonalisation ----------------------------------


@pytest.fixture
def jumping(torn_grid):
    """Six squares in plane strain, every other one 10³ times stiffer, which the scaling ignores."""
    return torn_grid((2, 3), (3, 3), components=2, stiffness=lambda i: 1e3 ** (i % 2))


@every_type
@every_pc
def test_ritz_values_are_the_ends_of_the_spectrum(kind, pc_type, jumping, parts, feti):
    """Condition number to 1e-6, and no iteration for a ghost.

    In exact arithmetic there are no more iterations than different eigenvalues. All-floating and
    lumped, no load reaches the lowest eigenvectors, which pull the copies of a Dirichlet dof apart.
    """
    chosen = {"type": kind, "pc_type": pc_type, **PAPER}
    values = eigenvalues(parts(jumping.A, **chosen))
    different = 1 + np.count_nonzero(np.diff(values) > 1e-9 * values[1:])
    options, found = {f"feti_{name}": value for name, value in chosen.items()}, []
    for method in ("cg", "fcg"):
        ksp = feti(jumping.A, feti_dual_ksp_type=method, **options, **EXACT)
        reason, _ = solve(ksp, jumping, random_values(jumping, seed=11215))
        found.append(ksp.getPythonContext())
        agree(reason > 0 and found[-1].method == method, (found[-1].method, found[-1].message))
    plain, full = found
    agree(full.iterations <= different + 1, (full.iterations, different))
    agree(full.iterations < plain.iterations, (full.iterations, plain.iterations))
    small(full.eigenvalues[1] / values[-1] - 1.0, 1e-6)
    if (kind, pc_type) != ("all_floating", "lumped"):
        small(full.condition_number * values[0] / values[-1] - 1.0, 1e-6)


@pytest.mark.parametrize("method", ["cg", "fcg"])
def test_later_solves_may_take_more_iterations(method, jumping, feti):
    """PETSc sizes the arrays of the coefficients at set-up, for the iterations then allowed."""
    ksp = feti(jumping.A, feti_pc_type="identity", feti_dual_ksp_type=method, ksp_max_it=2)
    counts = []
    for most in (2, 1000, 5, 1000):
        ksp.setTolerances(max_it=most)
        reason, _ = solve(ksp, jumping, random_values(jumping))
        counts.append(ksp.getPythonContext().iterations)
        agree((reason > 0) == (most == 1000))
    agree(counts[0] == 2 and counts[2] == 5, counts)
    agree(counts[1] == counts[3] > 20, counts)
