# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What theory and the paper say of the spectrum of the preconditioned dual operator.

With the Dirichlet preconditioner λ_min ≥ 1 for any weight Q of the projection, and
λ_max ≤ C (1 + log H/h)² (Mandel, Tezaur 1996; Klawonn, Widlund 2001).
"""

from __future__ import annotations

import itertools

import numpy as np
import paper_cube
import pytest
from collective import agree, dense, matrix_of_map, small, whole
from hand_torn import random_values, solve

ROUNDING = 1e-6

every_type = pytest.mark.parametrize("kind", ["all_floating", "classical"])


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
    values = np.linalg.eigvals(P @ M @ P.T @ F)
    assert np.abs(values.imag).max() < 1e-8
    return np.sort(values.real[np.abs(values) > 1e-8])


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
def test_condition_numbers_of_the_paper(kind, pc_type, all_floating, classical, feti):
    """Its cube on the coarsest level: 512 subdomains, multiplicity scaling, Q = I."""
    problem = paper_cube.cube(8, 1)
    options = {"type": kind, "pc_type": pc_type, "scaling": "multiplicity"}
    low, high = spectrum(feti, problem, load=0.0, coarse_q="identity", **options)
    expected = all_floating if kind == "all_floating" else classical
    agree(abs(high / low - expected) < 0.008 * expected, (high / low, expected))
    problem.destroy()


# ---- bounds ---------------------------------------------------------------------------------

GRIDS = {
    "row": {"subdomains": (6,), "cells": (3,)},
    "cross points": {"subdomains": (3, 3), "cells": (3, 3)},
    "plane strain": {"subdomains": (3, 2), "cells": (2, 3), "components": 2},
    "solid": {"subdomains": (2, 2, 2), "cells": (2, 1, 2), "components": 3},
    "jumps": {"subdomains": (3, 3), "cells": (2, 2), "stiffness": lambda i: 10.0 ** (3 * (i % 2))},
}
every_grid = pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS)


@every_grid
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
@pytest.mark.parametrize("pc_type", ["dirichlet", "lumped", "identity"])
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


def test_kernels_of_all_dimensions_in_one_decomposition(feti):
    """The bound holds whatever is left of the rigid motions."""
    problem = paper_cube.cube(3, 1, fixed=corners_and_edges)
    options = {"type": "classical", "scaling": "multiplicity", "coarse_q": "identity"}
    options["coarse_modes"] = 0
    ksp = feti(problem.A, **{f"feti_{name}": value for name, value in options.items()})
    solve(ksp, problem, random_values(problem))
    context = ksp.getPythonContext()
    agree(context.report().kernels == (1, 2, 1, 1, 2, 1, 19), context.report().kernels)
    agree(context.eigenvalues[0] >= 1.0 - ROUNDING, context.eigenvalues)
    small(context.residual, 1e-8)
    problem.destroy()


# ---- growth ---------------------------------------------------------------------------------

KINDS = {
    "Laplace": {"components": 1, "subdomains": (4, 4)},
    "plane strain": {"components": 2, "subdomains": (3, 3)},
}


@every_type
@pytest.mark.parametrize("problem", KINDS.values(), ids=KINDS)
@pytest.mark.parametrize("q", ["preconditioner", "identity"])
def test_condition_grows_no_faster_than_a_squared_logarithm(problem, q, kind, torn_grid, feti):
    """The quotient κ/(1 + log H/h)² does not grow with H/h; lumped is left behind."""
    ratios = np.array([4, 8, 16])
    dirichlet, lumped = [], []
    for n in ratios:
        grid = torn_grid(cells=(n, n), **problem)
        low, high = spectrum(feti, grid, type=kind, coarse_q=q)
        dirichlet.append(high / low)
        low, high = spectrum(feti, grid, type=kind, coarse_q=q, pc_type="lumped")
        lumped.append(high / low)
    quotient = np.array(dirichlet) / (1.0 + np.log(ratios)) ** 2
    agree(np.all(quotient[1:] <= 1.05 * quotient[:-1]), (dirichlet, quotient))
    agree(lumped[-1] > 3.0 * dirichlet[-1], (dirichlet, lumped))


@every_type
@pytest.mark.parametrize("components", [1, 2])
def test_condition_is_bounded_in_the_number_of_subdomains(components, kind, torn_grid, feti):
    """At H/h = 4 from 4 to 100 subdomains; iterations with it."""
    condition = []
    for n in (2, 5, 10):
        grid = torn_grid((n, n), (4, 4), components=components)
        low, high = spectrum(feti, grid, type=kind)
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
