# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The jump operator, its rows, counts and projections; sums over copies against the dense T."""

from __future__ import annotations

import numpy as np
import paper_cube
import pytest
import reference
from collective import COMM, agree, dense, equal, small, whole

from dolfinx_feti.feti.gluing.copies import Copies
from dolfinx_feti.feti.gluing.jump import Gluing, weights_of_copies
from dolfinx_feti.torn.matrix import Torn

SEED = 5519

every_type = pytest.mark.parametrize(
    "all_floating", [True, False], ids=["all_floating", "classical"]
)
every_scaling = pytest.mark.parametrize(
    "stiffness", [False, True], ids=["multiplicity", "stiffness"]
)

GRIDS = {
    "bars": {"subdomains": (4,), "cells": (2,)},
    "cross point": {"subdomains": (2, 2), "cells": (2, 1)},
    "elasticity": {"subdomains": (3, 2), "cells": (1, 2), "components": 2},
    "component-wise conditions": {
        "subdomains": (2, 2),
        "cells": (1, 1),
        "components": 2,
        "fixed": lambda x: x == 0.0,
    },
    "solid": {"subdomains": (2, 2, 2), "cells": (1, 1, 1), "components": 3},
    "no condition": {
        "subdomains": (2, 2),
        "cells": (1, 1),
        "fixed": lambda x: np.zeros(len(x), dtype=bool),
    },
}
every_grid = pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS)


@pytest.fixture
def glue(torn_grid):
    """Glue a grid; K of subdomain i is scaled by 3ⁱ."""
    made = []

    def create(grid, *, all_floating=True):
        problem = torn_grid(stiffness=lambda i: 3.0**i, **grid)
        torn = Torn(problem.A)
        gluing = Gluing(torn, all_floating=all_floating)
        made.extend([gluing, torn])
        return problem, torn, gluing

    yield create
    for owner in made:
        owner.destroy()


@pytest.fixture
def weigh(glue):
    """Glue a grid, and weigh its copies by the stiffness or alike."""
    made = []

    def create(grid, *, all_floating=True, stiffness=False):
        problem, torn, gluing = glue(grid, all_floating=all_floating)
        k = torn.stiffness() if stiffness else np.ones(torn.n)
        delta = weights_of_copies(torn, k)
        made.append(gluing.scaled_jumps(torn, delta))
        return problem, gluing, delta, dense(made[-1])

    yield create
    for owner in made:
        owner.destroy()


def normal_form(B):
    """Rows of B without their order and sign."""
    first = B[np.arange(len(B)), np.argmax(B != 0.0, axis=1)]
    rows = B / first[:, None]
    return rows[np.lexsort(rows.T)]


@every_grid
@every_type
def test_rows_are_those_of_the_definition(grid, all_floating, glue):
    problem, _, gluing = glue(grid, all_floating=all_floating)
    B = dense(gluing.B)
    expected = reference.jumps(problem.to_global, problem.dirichlet, all_floating=all_floating)
    agree(B.shape == expected.shape, (B.shape, expected.shape))
    agree(set(np.unique(B)) <= {-1.0, 0.0, 1.0})
    equal(normal_form(B), normal_form(expected))
    assembled = B @ problem.T
    jump_rows = np.abs(B).sum(axis=1) == 2
    equal(assembled[jump_rows], np.zeros_like(assembled[jump_rows]))  # B T = 0 off Γ_D
    agree(np.linalg.matrix_rank(B) == np.linalg.matrix_rank(expected))


@every_grid
@every_type
@every_scaling
def test_scaled_jumps_make_a_projection(grid, all_floating, stiffness, weigh):
    """B_DᵀB is a projection with the kernel of B, B B_Dᵀ B = B, and I − B_DᵀB averages."""
    problem, gluing, delta, B_D = weigh(grid, all_floating=all_floating, stiffness=stiffness)
    B = dense(gluing.B)
    E = B_D.T @ B
    equal(E @ E, E, 1e-13)
    equal(B @ B_D.T @ B, B, 1e-13)
    u = np.random.default_rng(SEED).standard_normal(len(E))
    average = problem.T @ problem.T.T @ (whole(delta) * u)
    held = problem.dirichlet[problem.to_global]
    average[held] = 0.0 if all_floating else u[held]
    equal(u - E @ u, average, 1e-13)


@every_grid
@every_scaling
def test_weights_of_the_copies_sum_to_one(grid, stiffness, weigh):
    problem, _, delta, _ = weigh(grid, stiffness=stiffness)
    delta = whole(delta)
    equal(problem.T.T @ delta, np.ones(len(problem.dirichlet)), 1e-14)
    k = np.diag(problem.K_torn) if stiffness else np.ones(len(delta))
    equal(delta, k / (problem.T @ problem.T.T @ k), 1e-14)


@every_grid
@pytest.mark.parametrize("kind", ["some zero", "all zero", "far apart"])
def test_any_stiffness_makes_a_projection(grid, kind, glue):
    """A weight is never zero, negative or NaN, whatever the stiffness is."""
    _, torn, gluing = glue(grid)
    stiffness = {
        "some zero": (np.arange(torn.n) % 2).astype(float),
        "all zero": np.zeros(torn.n),
        "far apart": 10.0 ** (100 * (np.arange(torn.n) % 3 - 1.0)),
    }
    delta = weights_of_copies(torn, stiffness[kind])
    scaled = gluing.scaled_jumps(torn, delta)
    B, B_D = dense(gluing.B), dense(scaled)
    agree(np.isfinite(B_D).all() and delta.min(initial=1.0) > 0.0)
    equal(B @ B_D.T @ B, B, 1e-13)
    scaled.destroy()


@every_grid
def test_a_copy_is_weighed_by_the_other_side(grid, weigh):
    _, gluing, delta, B_D = weigh(grid, stiffness=True)
    B, delta = dense(gluing.B), whole(delta)
    for row, scaled in zip(B, B_D, strict=True):
        copies = np.flatnonzero(row)
        expected = np.zeros_like(row)
        expected[copies] = row[copies] * (delta[copies[::-1]] if len(copies) == 2 else 1.0)
        np.testing.assert_allclose(scaled, expected, rtol=1e-14)


@every_grid
@every_type
def test_interface_is_where_the_jump_operator_acts(grid, all_floating, glue):
    _, torn, gluing = glue(grid, all_floating=all_floating)
    glued = np.zeros(torn.n, dtype=bool)
    glued[gluing.glued] = True
    equal(whole(glued), np.any(dense(gluing.B) != 0.0, axis=0))


@every_grid
@every_type
def test_gap_of_the_prescribed_values(grid, all_floating, glue):
    """B u = c for the copies of any vector that has the prescribed values."""
    problem, torn, gluing = glue(grid, all_floating=all_floating)
    x = np.random.default_rng(SEED + 1).standard_normal(len(problem.dirichlet))
    u = problem.T @ x
    u_D = np.where(torn.dirichlet, u[torn.start : torn.start + torn.n], 0.0)
    c = gluing.gap(u_D)
    equal(dense(gluing.B) @ u, whole(c), 1e-15)
    constrained = problem.dirichlet[problem.to_global].sum() * all_floating
    agree(np.count_nonzero(np.abs(dense(gluing.B)).sum(axis=1) == 1.0) == constrained)


# ---- the cube of the paper ------------------------------------------------------------------


@pytest.mark.parametrize("components", [1, 3])
def test_paper_counts_38052_multipliers_on_its_cube(components):
    """8³ subdomains of one cell of 24 tetrahedra, clamped all round: 12 684 rows a component."""
    problem = paper_cube.cube(8, 1, components)
    torn = Torn(problem.A)
    gluing = Gluing(torn, all_floating=True)
    agree(len(whole(np.array([len(rows) for rows in torn.subdomains]))) == 512)
    agree(gluing.B.getSize()[0] == 12_684 * components, gluing.B.getSize())
    small(gluing.B.getSize()[1] - 512 * 15 * components, 0)
    for owner in (gluing, torn, problem):
        owner.destroy()


# ---- sums, averages and scalar products of copies -------------------------------------------


@pytest.fixture
def copies_of(pattern):
    made = []

    def create(problem, **options):
        read = pattern(problem.A, **options)
        delta = weights_of_copies(read.torn, read.torn.stiffness())
        made.append(Copies(read.torn, read.dofs.interface, delta))
        return made[-1], whole(made[-1].dofs + read.torn.start)

    yield create
    for each in made:
        each.destroy()


@pytest.mark.parametrize("kind", ["all_floating", "classical"])
@pytest.mark.parametrize("shape", [(1, 1), (3, 2), (2, 2, 2)])
def test_sum_average_and_product(kind, shape, torn_grid, copies_of):
    """T Tᵀ t, T Tᵀ δ t and xᵀ y; nothing is left of dofs with a prescribed value."""
    problem = torn_grid(shape, [2] * len(shape), components=len(shape))
    copies, rows = copies_of(problem, type=kind)
    T = np.where(problem.dirichlet, 0.0, problem.T[rows])
    values = np.random.default_rng(SEED).standard_normal((2, len(rows)))
    last = COMM.scan(copies.n)
    t, s = values[:, last - copies.n : last]
    δ = whole(copies.delta)
    equal(whole(copies.sum(t)), T @ (T.T @ values[0]), 1e-14)
    equal(whole(copies.average(t)), T @ (T.T @ (δ * values[0])), 1e-14)
    x, y = T.T @ (δ * values)[0], T.T @ (δ * values)[1]
    small(copies.dot(copies.average(t), copies.average(s)) - x @ y, 1e-12 * max(1.0, abs(x @ y)))
    t, s = copies.average(t), copies.average(s)
    equal(copies.dots((t, s), (s, s)), [copies.dot(t, s), copies.dot(s, s)], 1e-14)
    agree(len(copies.row) == np.count_nonzero((T @ T.T)[last - copies.n : last]))


def test_copies_agree_to_the_last_bit(torn_grid, copies_of):
    """Each copy gets the same sum, in whatever order the processes answer."""
    problem = torn_grid((2, 2, 2), (2, 2, 2))
    copies, rows = copies_of(problem, type="all_floating")
    t = np.random.default_rng(SEED + COMM.rank).standard_normal(copies.n)
    total, dof = whole(copies.sum(t)), problem.to_global[rows]
    for each in np.unique(dof):
        agree(len(np.unique(total[dof == each])) == 1)
