# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The jump operator, its rows, counts and weights agree with dense matrices."""

import itertools

import numpy as np
import paper_cube
import pytest
from cases import case, each, every_scaling, every_type
from collective import COMM, agree, dense, equal, whole
from hand_torn import nowhere

from dolfinx_feti.feti.interface.gluing import Gluing
from dolfinx_feti.feti.interface.scaling import SCALINGS, weights_from_stiffness
from dolfinx_feti.torn.matrix import Torn

SEED = 5519
GRIDS = {
    "bars": case((4,), (2,)),
    "cross point": case((2, 2), (2, 1)),
    "elasticity": case((3, 2), (1, 2), 2),
    "component-wise conditions": case((2, 2), (1, 1), 2, fixed=lambda x: x == 0.0),
    "solid": case((2, 2, 2), (1, 1, 1), 3),
    "no condition": case((2, 2), (1, 1), fixed=nowhere),
}
every_grid = each("grid", GRIDS)
#: Numbers k that weights are computed from; those with the name of a scaling are its formula.
STIFFNESS = {
    "multiplicity": lambda torn: np.ones(torn.n),
    "stiffness": lambda torn: torn.stiffness(),
    "some zero": lambda torn: np.arange(torn.n) % 2,
    "all zero": lambda torn: np.zeros(torn.n),
    "far apart": lambda torn: 10.0 ** (100 * (np.arange(torn.n) % 3 - 1.0)),
}


@pytest.fixture
def create_gluing(torn_grid, lifetime):
    """Return a function that glues a grid, whose subdomain i has 3ⁱ times the stiffness."""

    def create(grid, kind="all_floating"):
        problem = torn_grid(stiffness=lambda i: 3.0**i, **grid)
        torn = lifetime.own(Torn(problem.A))
        return problem, torn, lifetime.own(Gluing(torn, all_floating=kind == "all_floating"))

    return create


def dense_jumps(to_global, dirichlet, *, all_floating):
    """Return B, (m, n): differences of copies of each dof, and a row for each Dirichlet copy."""
    rows = []
    unit = np.eye(len(to_global))
    for dof in np.flatnonzero(~dirichlet):
        copies = np.flatnonzero(to_global == dof)
        rows += [unit[i] - unit[j] for i, j in itertools.combinations(copies, 2)]
    if all_floating:
        rows += [unit[i] for i in np.flatnonzero(dirichlet[to_global])]
    return np.array(rows).reshape(-1, len(to_global))


def normal_form(B):
    """Return the rows of B in lexical order, each scaled so that its first entry is one."""
    first = B[np.arange(len(B)), np.argmax(B != 0.0, axis=1)]
    rows = B / first[:, None]
    return rows[np.lexsort(rows.T)]


@every_grid
@every_type
def test_jump_operator_has_a_row_for_each_pair_of_copies(grid, kind, create_gluing):
    """The interface is where B acts; B u = c for copies of any x with the prescribed values."""
    problem, torn, gluing = create_gluing(grid, kind)
    B = dense(gluing.B)
    floating = kind == "all_floating"
    expected = dense_jumps(problem.to_global, problem.dirichlet, all_floating=floating)
    agree(B.shape == expected.shape, (B.shape, expected.shape))
    agree(set(np.unique(B)) <= {-1.0, 0.0, 1.0})
    equal(normal_form(B), normal_form(expected))
    glued = np.zeros(torn.n, dtype=bool)
    glued[gluing.interface_dofs] = True
    equal(whole(glued), np.any(B != 0.0, axis=0))
    x = np.random.default_rng(SEED + 1).standard_normal(len(problem.dirichlet))
    u = problem.T @ x
    u_D = np.where(
        torn.is_dirichlet_copy, u[torn.first_torn_dof : torn.first_torn_dof + torn.n], 0.0
    )
    equal(B @ u, whole(gluing.gap(u_D)), 1e-15)


@every_grid
@every_type
@each("stiffness", STIFFNESS)
def test_scaled_jumps_give_a_projection(grid, kind, stiffness, create_gluing, lifetime):
    """B_DᵀB is a projection with the kernel of B, B B_Dᵀ B = B, and I − B_DᵀB averages.

    A copy is weighed by the other side: (B_D)_ij = (δ_j, −δ_i). δ = k / Σ k is never zero or NaN.
    """
    problem, torn, gluing = create_gluing(grid, kind)
    k = np.asarray(stiffness(torn), dtype=float)
    own_weights = weights_from_stiffness(torn, k)
    δ = whole(own_weights)
    k = whole(k)
    T = problem.T
    equal(T.T @ δ, np.ones(len(problem.dirichlet)), 1e-14)
    agree(np.all(δ > 0.0), δ.min())
    if 0.0 < k.min() and k.max() < 1e12 * k.min():
        equal(δ, k / (T @ T.T @ k), 1e-14)
    B = dense(gluing.B)
    B_D = dense(lifetime.own(gluing.scaled_jumps(torn, own_weights)))
    E = B_D.T @ B
    equal(E @ E, E, 1e-13)
    equal(B @ E, B, 1e-13)
    u = np.random.default_rng(SEED).standard_normal(len(E))
    average = T @ T.T @ (δ * u)
    is_dirichlet = problem.dirichlet[problem.to_global]
    average[is_dirichlet] = 0.0 if kind == "all_floating" else u[is_dirichlet]
    equal(u - E @ u, average, 1e-13)
    for row, scaled in zip(B, B_D, strict=True):
        copies = np.flatnonzero(row)
        expected = row[copies] * (δ[copies[::-1]] if len(copies) == 2 else 1.0)
        np.testing.assert_allclose(scaled[copies], expected, rtol=1e-14)
        assert np.count_nonzero(scaled) == len(copies)


@every_grid
@every_scaling
def test_weights_of_a_scaling_sum_to_one(grid, scaling, create_gluing):
    """Tᵀ δ T = I for all scalings, and δ = k / Σ k for those with a formula in STIFFNESS."""
    problem, torn, _ = create_gluing(grid)
    weights = SCALINGS[scaling](torn)
    equal(problem.T.T @ whole(weights), np.ones(len(problem.dirichlet)), 1e-14)
    if scaling in STIFFNESS:
        k = whole(np.asarray(STIFFNESS[scaling](torn), dtype=float))
        equal(whole(weights), k / (problem.T @ problem.T.T @ k), 1e-14)


@pytest.mark.parametrize("components", [1, 3])
def test_papers_cube_has_38052_multipliers(components, lifetime):
    """8³ subdomains of one cell of 24 tetrahedra, clamped all round: 12 684 rows a component."""
    problem = lifetime.own(paper_cube.cube(8, components))
    torn = lifetime.own(Torn(problem.A))
    gluing = lifetime.own(Gluing(torn, all_floating=True))
    agree(COMM.allreduce(len(torn.subdomains)) == 512)
    agree(gluing.B.getSize() == (12_684 * components, 512 * 15 * components))
