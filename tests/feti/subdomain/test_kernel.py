# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Kernels of subdomains: what is left of the rigid body modes, and null vectors beyond them."""

import hand_torn
import numpy as np
import pytest
import scipy.linalg
from cases import each, every_interior, every_type
from collective import COMM, agree, equal, small, whole
from mixed import errors_of_solves
from modes import modes_of
from walls import tube, wall

from dolfinx_feti.feti.subdomain.blocks import sparse_block
from dolfinx_feti.feti.subdomain.modes import kernel_basis

SEED = 60221
BRICK = (2, 2, 2)
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


@each(("where", "components", "dimension"), HELD)
def test_kernel_is_what_a_singular_value_decomposition_finds(
    where, components, dimension, torn_grid, parts
):
    """In classical FETI, against the null space of a brick's matrix without its fixed dofs.

    Another subdomain is held by a face, so that the whole is regular; it has no kernel. The factor
    of the regularised matrix is positive definite: the kernel is no larger.
    """

    def fixed(x):
        return components(where(x)).astype(bool) | (x[:, :1] == 4.0)

    problem = torn_grid((2, 1, 1), BRICK, components=3, fixed=fixed)
    system = parts(problem.A, type="classical")
    errors, nullities = [0.0], []
    for rows, R in zip(system.operator.dofs, modes_of(system).R, strict=True):
        K = problem.K_torn[np.ix_(system.torn.start + rows, system.torn.start + rows)]
        null = scipy.linalg.null_space(K, rcond=1e-10) if len(K) else K
        errors += [
            np.abs(R.T @ R - np.eye(R.shape[1])).max(initial=0.0),
            np.abs(K @ R).max(initial=0.0) / np.abs(K).max(initial=1.0),
            np.abs(null @ (null.T @ R) - R).max(initial=0.0),
        ]
        nullities.append(null.shape[1])
    small(max(errors), 1e-12)
    equal(whole(modes_of(system).dimensions), whole(np.array(nullities)))
    agree(whole(np.array(nullities))[0] == dimension, nullities)
    counts = [factor.pivots for factor in system.inverse.factors]
    agree(all(count == (0, 0) for count in counts), counts)


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
    _, K = hand_torn.brick(BRICK, 3)
    agree(R.shape[1] == 1, R.shape)
    eps = np.finfo(float).eps
    small(np.abs(K[np.ix_(~fixed, ~fixed)] @ R).max(), 100 * eps * (1 + shift) * np.abs(K).max())


# ---- a few P2–P0 cells ----------------------------------------------------------------------

QUARTER = {"media": 2, "around": 11, "along": 1, "length": 0.13, "quarter": True}
CELLS = 198


def quarter_tube(subdomains, kappa=1000.0, **options):
    body = wall(tube(**QUARTER), kappa=kappa, quarter=True)
    return body, body.problem(subdomains, options)


@every_interior
@pytest.mark.parametrize("kappa", [1000.0, 1e5])
@pytest.mark.parametrize("subdomains", [64, CELLS])
def test_kernel_of_a_few_cells(subdomains, kappa, interior, parts):
    """A cell has three null vectors beside the rigid ones; all count as kernel, with D = 0."""
    _, problem = quarter_tube(subdomains, kappa)
    problem._system.residual()
    problem._system.linearise()
    system = parts(problem.A, interior=interior, coarse_modes=0)
    torn, modes = system.torn, modes_of(system)
    expected = []
    for rows in torn.subdomains:
        K = sparse_block(torn.K, rows, rows).toarray()
        root = np.sqrt(K.diagonal())
        scaled = K / root[:, None] / root
        expected.append(scipy.linalg.null_space(scaled, rcond=1e-11).shape[1])
    equal(np.array(modes.kernel, dtype=np.int64), expected)
    agree(len(whole(np.array(expected))) >= subdomains and COMM.allreduce(sum(expected)) > 0)
    agree(subdomains < CELLS or set(expected) <= {9}, expected)
    agree(all(modes.exact))
    small(max((np.abs(D).max(initial=0.0) for D in modes.D), default=0.0), 0.0)
    error = 0.0
    for i, (E, rho) in enumerate(zip(modes.E, modes.rho, strict=True)):
        image = system.operator.local_product(i, E)
        error = max(error, np.abs(image).max(initial=0.0) / rho)
    small(error, 1e-11)


@every_interior
@every_type
def test_few_cells_agree_with_a_direct_solver(kind, interior):
    """Every linear solve of a load step, with null vectors at rest and without them under load."""
    body, problem = quarter_tube(64, feti_type=kind, feti_interior=interior, ksp_rtol=1e-10)
    errors = errors_of_solves(problem)
    steps = body.inflate(problem, [5.0])
    agree(len(steps) == len(errors) >= 3)
    small(max(errors), 1e-8)
    small(max(step.linear_residual for step in steps), 1e-10)
