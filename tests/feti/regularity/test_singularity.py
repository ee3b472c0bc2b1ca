# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A singular problem is refused with its free motions; a hard one is not called singular."""

import re

import hand_torn
import numpy as np
import pytest
import scipy.linalg
from cases import case, each, every_formulation, every_interior, every_type
from collective import agree
from hand_torn import (
    components_at,
    dofs_of,
    edge,
    face,
    nowhere,
    origin,
    scaled_diagonal,
    solve_and_check,
)

from dolfinx_feti.errors import SetUpError, SingularError

SEED = 4711


def either(first, second):
    """Return a marker of what one or the other marks."""
    return lambda x: first(x) | second(x)


def bottom(x):
    """Mark the nodes with x₂ = 0."""
    return x[:, 2] == 0.0


on_line = components_at(edge, 0, 1)
on_plane = components_at(face, 0)
#: Grid, dimension of the kernel, what the message says.
FREE = {
    "Neumann's problem in 1-D": (case((3,), (2,), fixed=nowhere), 1, "a constant"),
    "Neumann's problem in 3-D": (case((2, 1, 2), (2, 2, 2), fixed=nowhere), 1, "a constant"),
    "free in the plane": (
        case((2, 2), (2, 2), 2, fixed=nowhere),
        3,
        "2 translations and 1 rotation free",
    ),
    "free in space": (
        case((2, 2, 1), (2, 1, 2), 3, fixed=nowhere),
        6,
        "3 translations and 3 rotations free",
    ),
    "one subdomain, which nothing glues": (
        case((1, 1), (3, 3), 2, fixed=nowhere),
        3,
        "2 translations and 1 rotation free",
    ),
    "held at a point of the plane": (
        case((2, 2), (3, 2), 2, fixed=components_at(origin, 0, 1)),
        1,
        "leave 1 rotation free",
    ),
    "slides in the plane": (case((3, 2), (2, 2), 2, fixed=on_plane), 1, "leave 1 translation free"),
    "held at a point": (
        case((2, 2, 2), (1, 1, 1), 3, fixed=components_at(origin, 0, 1, 2)),
        3,
        "leave 3 rotations free",
    ),
    "held on a line": (
        case((2, 1, 2), (2, 2, 2), 3, fixed=components_at(edge, 0, 1, 2)),
        1,
        "leave 1 rotation free",
    ),
    "turns and slides along a line": (
        case((2, 1, 2), (2, 2, 2), 3, fixed=on_line),
        2,
        "1 translation and 1 rotation free",
    ),
    "slides on a plane": (
        case((2, 2, 1), (2, 2, 2), 3, fixed=on_plane),
        3,
        "2 translations and 1 rotation free",
    ),
    "slides on two planes": (
        case((3, 1, 1), (2, 2, 2), 3, fixed=either(on_plane, components_at(bottom, 2))),
        1,
        "leave 1 translation free",
    ),
}


def check_singular(create_dual, A, dimension, text, **options):
    """Assert that all processes raise an error with the dimension of the kernel and a text."""
    with pytest.raises(SingularError) as caught:
        create_dual(A, **options)
    message = str(caught.value)
    agree(f"singular, with a kernel of dimension {dimension}:" in message, message)
    agree(re.search(text, message) and "Add Dirichlet conditions" in message, message)


@every_type
@every_interior
@each(("grid", "dimension", "text"), FREE)
def test_free_body_is_singular_and_its_motions_are_named(
    grid, dimension, text, kind, interior, torn_grid, create_dual
):
    """The dimension is that of the dense null space; the message counts free motions."""
    problem = torn_grid(**grid)
    null = scipy.linalg.null_space(problem.free_matrix, rcond=1e-12)
    agree(null.shape[1] == dimension, null.shape)
    check_singular(create_dual, problem.A, dimension, text, type=kind, interior=interior)


@every_type
@pytest.mark.parametrize("coarse_q", ["identity", "diagonal", "preconditioner"])
@pytest.mark.parametrize("pc_type", ["lumped", "identity", "dirichlet"])
def test_free_body_is_singular_with_any_coarse_matrix(
    kind, coarse_q, pc_type, torn_grid, create_dual
):
    """The message has the free motions with coordinates of the dofs and without."""
    problem = torn_grid((3, 2), (2, 2), components=2, fixed=on_plane)
    options = {"type": kind, "coarse_q": coarse_q, "pc_type": pc_type}
    check_singular(create_dual, problem.A, 1, "leave 1 translation free", **options)
    problem.A.compose("coordinates", None)
    check_singular(create_dual, problem.A, 1, "leave 1 translation free", **options)


@every_type
@pytest.mark.parametrize("load", ["dead", "elastic support", "soft support"])
def test_prestressed_body_is_singular_unless_supported(load, kind, torn_grid, create_dual):
    """Translations stay a kernel while the prestress is the body's own; a support ends that."""

    def springs(K, dofs):  # between the nodes, of either sign: rows that sum to zero
        rng = np.random.default_rng(SEED)
        for i, K_i in enumerate(K):
            weight = rng.standard_normal((len(K_i) // 2, len(K_i) // 2))
            is_coupled = K_i[::2, ::2] != 0.0
            weight = np.where(is_coupled, 2.0 * (weight + weight.T), 0.0)
            L = np.diag(weight.sum(axis=1)) - weight
            K_i += np.kron(L, np.eye(2))
            if load != "dead" and i == 0:
                K_i += {"elastic support": 1.0, "soft support": 1e-9}[load] * np.eye(len(K_i))

    problem = torn_grid((2, 2), (2, 2), components=2, fixed=nowhere, change=springs)
    values = np.abs(np.linalg.eigvalsh(problem.free_matrix))
    count = np.count_nonzero(values < 1e-13 * values.max())
    agree(count == (2 if load == "dead" else 0), np.sort(values)[:4])
    if load == "dead":
        check_singular(create_dual, problem.A, 2, "leave 2 translations free", type=kind)
    else:
        agree(create_dual(problem.A, type=kind).inertia.dual > 0)


@every_type
@pytest.mark.parametrize("stiff", [1.0, 1e6, 1e8])
def test_singular_interior_of_a_regular_body_is_reported_as_such(
    stiff, kind, torn_grid, create_dual
):
    """Far from equilibrium a tangent is indefinite; the message does not claim a kernel."""

    def shift(K, dofs):
        shared_dofs, count = np.unique(np.concatenate(dofs), return_counts=True)
        inner = np.flatnonzero(np.isin(dofs[0], shared_dofs[count == 1]))
        inner, last = inner[:-1], inner[-1]
        K[0][inner, inner] -= np.linalg.eigvalsh(K[0][np.ix_(inner, inner)])[0]
        for stored in (K[0][last], K[0][:, last]):
            stored[inner] = 0.0  # the stiff dof is no part of the motion
        K[0][last, last] = stiff

    problem = torn_grid((2, 2), (4, 4), components=1, fixed=nowhere, change=shift)
    values = np.linalg.eigvalsh(problem.free_matrix)
    agree(values[0] < 0.0 and np.abs(values).min() > 1e-4, values)
    with pytest.raises(SetUpError) as caught:
        create_dual(problem.A, type=kind, interior="eliminate")
    message = str(caught.value)
    agree("kernel of dimension" not in message and "interior" in message, message)
    agree("other subdomains, or the options feti_interior keep" in message, message)


# ---- several bodies, and mechanisms ---------------------------------------------------------


@pytest.fixture
def torn_bricks(lifetime):
    """Tear bricks that share nodes where they touch; each is a subdomain, or some are one."""

    def create(places, cells, fixed, joined=0):
        pattern, K_0 = hand_torn.brick(cells, 2)
        nodes = np.argwhere(np.ones([n + 1 for n in cells])) * 1.0
        x, number = np.unique(
            np.concatenate([nodes + p for p in places]), axis=0, return_inverse=True
        )
        dofs = [dofs_of(n, 2) for n in number.reshape(len(places), -1)]
        K = [K_0] * len(places)
        if joined:
            ours = np.unique(np.concatenate(dofs[:joined]))
            K_1 = np.zeros((len(ours), len(ours)))
            for of_brick in dofs[:joined]:
                rows = np.searchsorted(ours, of_brick)
                K_1[np.ix_(rows, rows)] += K_0
            K = [K_1, *K[joined:]]
            dofs = [ours, *dofs[joined:]]
            pattern = None
        mask = np.broadcast_to(fixed(x).reshape(len(x), -1), (len(x), 2)).ravel()
        modes = hand_torn.kernel(x, 2)
        return lifetime.own(hand_torn.tear(K, dofs, x, modes, mask, pattern=pattern))

    return create


APART = [(0, 0), (2, 0), (9, 0), (11, 0)]
HINGE = [(0, 0), (2, 2)]
#: Bricks that touch in corners: two on the ground carry a third one by two more in between.
LINKS = [(0, 0), (2, 2), (4, 4), (6, 2), (8, 0)]
ENDS = either(on_plane, components_at(lambda x: x[:, 0] == 13.0, 0, 1))
MOTION = r"nothing resists a motion that is not rigid, largest at \((4, 4|2, 4|4, 2)\)"
#: Places of bricks, their cells, where they are held, how many are one; dimension and message.
LOOSE = {
    "one of two bodies is not held": (
        (APART, (2, 2), face),
        3,
        r"not connected to the rest \(2 of 2 around \(11, 1\)\) .* 2 translations and 1 rotation",
    ),
    "each body says what it lacks": (
        (APART, (2, 2), ENDS),
        1,
        r"1 of 2 around \(2, 1\)\) .* leave 1 translation",
    ),
    "only a held node connects": (
        (HINGE, (2, 2), lambda x: np.all(x == 2.0, axis=1)),
        2,
        r"\(1 of 2 .* leave 1 rotation free; .*\(2 of 2 .* leave 1 rotation free",
    ),
    "hinge between subdomains": ((HINGE, (2, 2), face), 1, MOTION),
    "hinge inside": ((HINGE, (2, 2), face, 2), 1, MOTION),
    "four links": (
        (LINKS, (2, 2), lambda x: (x[:, 1] == 0.0) & ((x[:, 0] <= 2.0) | (x[:, 0] >= 8.0))),
        1,
        "nothing resists a motion that is not rigid",
    ),
    "many loose bodies": (
        ([(5 * i, 0) for i in range(6)], (1, 1), face),
        15,
        r"\(2 of 6.*\(4 of 6.*; 2 more parts are free",
    ),
}


@every_type
@every_interior
@each(("bricks", "dimension", "text"), LOOSE)
def test_loose_bodies_and_mechanisms_are_singular_and_named(
    bricks, dimension, text, kind, interior, torn_bricks, create_dual
):
    """The message says which body is free and how, or where a mechanism moves most."""
    A = torn_bricks(*bricks).A
    check_singular(create_dual, A, dimension, text, type=kind, interior=interior)


@every_type
@every_interior
@every_formulation
@each(("bricks", "dimension", "text"), LOOSE)
def test_every_formulation_refuses_loose_bodies_and_mechanisms(
    bricks, dimension, text, formulation, kind, interior, torn_bricks, create_ksp
):
    """The message is the same, before the first iteration."""
    options = {"feti_type": kind, "feti_interior": interior, "feti_formulation": formulation}
    context = create_ksp(torn_bricks(*bricks).A, **options).getPythonContext()
    agree(context.singular, context.message)
    message = context.message
    agree(f"singular, with a kernel of dimension {dimension}:" in message, message)
    agree(re.search(text, message), message)


@every_type
@every_interior
@pytest.mark.parametrize("max_dofs_for_svd", [1000, 5], ids=["all-vectors", "inverse-iteration"])
def test_supported_hinge_is_not_a_mechanism(
    max_dofs_for_svd, kind, interior, torn_bricks, create_ksp, monkeypatch
):
    """The hinge in one subdomain is a null vector beyond the rigid ones, and joins them."""
    monkeypatch.setattr(
        "dolfinx_feti.feti.subdomain.null_vectors.MAX_DOFS_FOR_SVD", max_dofs_for_svd
    )

    def fixed(x):
        return face(x)[:, None] | components_at(lambda x: np.all(x == 4.0, axis=1), 1)(x)

    problem = torn_bricks([*HINGE, (4, 2)], (2, 2), fixed, 2)
    solve_and_check(
        create_ksp(problem.A, feti_type=kind, feti_interior=interior, ksp_rtol=1e-11), problem
    )


# ---- no false alarm -------------------------------------------------------------------------

HARD_GRIDS = {
    "jumps of the stiffness": case((3, 3), (2, 2), 2, stiffness=lambda i: 1e8 ** (i % 2)),
    "jumps downwards": case((4, 1), (2, 2), 2, stiffness=lambda i: 1e-8**i),
    "slender": case((40, 1), (6, 1), 2),
    "slender row of subdomains": case((120, 1), (2, 1), 2),
    "solid beam": case((16, 1, 1), (6, 1, 1), 3),
    "held in two nodes": case((3, 2), (3, 3), 2, fixed=lambda x: origin(x) | origin(x - [0, 1])),
    "weak springs": case((3, 2), (3, 3), 2, fixed=nowhere, change=scaled_diagonal(1.0 + 1e-9)),
}


@every_type
@every_interior
@each("grid", HARD_GRIDS)
def test_hard_problems_are_not_called_singular(grid, kind, interior, torn_grid, create_dual):
    """Large jumps, slender bodies and weak supports are set up without an error."""
    create_dual(torn_grid(**grid).A, type=kind, interior=interior)
