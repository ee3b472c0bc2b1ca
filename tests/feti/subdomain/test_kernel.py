# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Kernels of subdomains: what the Dirichlet conditions leave of the rigid body modes."""

from __future__ import annotations

import hand_torn
import numpy as np
import pytest
import scipy.linalg
from collective import agree, equal, small, whole
from modes import modes_of

from dolfinx_feti.feti.subdomain.modes import kernel_basis

CELLS = (2, 2, 2)
NODES = np.argwhere(np.ones((3, 3, 3))) * 1.0


def vertex(x):
    return np.all(x == 0.0, axis=1)


def edge(x):
    return np.all(x[:, :2] == 0.0, axis=1)


def face(x):
    return x[:, 0] == 0.0


def component(*which):
    return lambda mask: np.stack([mask if j in which else 0 * mask for j in range(3)], axis=-1)


#: Where a brick is held, in which components, and how many rigid body modes are left.
HELD = {
    "nowhere": (lambda x: np.zeros(len(x), dtype=bool), component(0, 1, 2), 6),
    "one component of a vertex": (vertex, component(1), 5),
    "two components of a vertex": (vertex, component(0, 2), 4),
    "a vertex": (vertex, component(0, 1, 2), 3),
    "one component along an edge": (edge, component(0), 4),
    "the axis of an edge": (edge, component(2), 5),
    "an edge": (edge, component(0, 1, 2), 1),
    "one component of a face": (face, component(0), 3),
    "two components of a face": (face, component(0, 1), 1),
    "a face": (face, component(0, 1, 2), 0),
    "three faces, one component each": (lambda x: x == 0.0, lambda mask: mask, 0),
    "all of it": (lambda x: np.full(len(x), True), component(0, 1, 2), 0),
}


@pytest.mark.parametrize("held", HELD.values(), ids=HELD)
def test_kernel_is_what_a_singular_value_decomposition_finds(held):
    """The tested candidates against the null space of the brick's matrix without its fixed dofs."""
    where, components, dimension = held
    _, K = hand_torn.brick(CELLS, 3)
    fixed = components(where(NODES)).astype(bool).ravel()
    R = kernel_basis(hand_torn.kernel(NODES, 3), fixed)
    equal(R.shape, (np.count_nonzero(~fixed), dimension))
    K_free = K[np.ix_(~fixed, ~fixed)]
    equal(R.T @ R, np.eye(dimension), 1e-14)
    small(np.abs(K_free @ R).max(initial=0.0), 1e-12 * np.abs(K).max())
    null = scipy.linalg.null_space(K_free, rcond=1e-10) if len(K_free) else np.zeros((0, 0))
    agree(null.shape[1] == dimension, f"{null.shape[1]} null vectors, {dimension} candidates")
    equal(null @ (null.T @ R), R, 1e-11)


@pytest.mark.parametrize("held", HELD.values(), ids=HELD)
def test_classical_kernel_agrees_with_inertia(held, torn_grid, parts):
    """The factor of the regularised matrix is positive definite: the kernel is no larger.

    Another subdomain is held by a face, so that the whole is regular; it has no kernel.
    """
    where, components, dimension = held

    def fixed(x):
        return components(where(x)).astype(bool) | (x[:, :1] == 4.0)

    problem = torn_grid((2, 1, 1), CELLS, components=3, fixed=fixed)
    system = parts(problem.A, type="classical")
    free = ~problem.dirichlet[problem.dofs[1]]
    second = scipy.linalg.null_space(problem.K[1][np.ix_(free, free)], rcond=1e-10).shape[1]
    equal(whole(modes_of(system).dimensions), [dimension, second])
    counts = [factor.pivots for factor in system.inverse.factors]
    agree(all(count == (0, 0) for count in counts), counts)


def test_too_few_candidates_are_no_silent_error(torn_grid, feti):
    """Without the rotations the regularised matrices are singular but for rounding.

    Either the missing mode is found as one of negative stiffness, or the solver says it failed.
    """
    problem = torn_grid((2, 2), (2, 2), components=2, modes=2)
    ksp = feti(problem.A)
    values = hand_torn.random_values(problem)
    reason, x = hand_torn.solve(ksp, problem, values)
    expected = problem.solve(values)
    right = np.abs(x - expected).max() < 1e-7 * np.abs(expected).max()
    agree(right or (reason < 0 and ksp.getPythonContext().message))


def test_modes_that_coincide_on_a_subdomain_count_once():
    """On a single node a rotation is a translation."""
    modes = np.hstack([np.eye(3), np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])])
    equal(kernel_basis(modes, np.zeros(3, dtype=bool)).shape, (3, 3))
    equal(kernel_basis(np.eye(3), np.ones(3, dtype=bool)).shape, (0, 0))


@pytest.mark.parametrize("shift", [0.0, 1e6])
def test_kernel_does_not_depend_on_the_origin(shift):
    """Far from the origin rotations look like translations to one part in a million."""
    modes = hand_torn.kernel(NODES + shift, 3)
    fixed = component(0, 1, 2)(edge(NODES)).astype(bool).ravel()
    R = kernel_basis(np.linalg.qr(modes)[0], fixed)
    _, K = hand_torn.brick(CELLS, 3)
    agree(R.shape[1] == 1, R.shape)
    eps = np.finfo(float).eps
    small(np.abs(K[np.ix_(~fixed, ~fixed)] @ R).max(), 100 * eps * (1 + shift) * np.abs(K).max())
