# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A singular problem never passes, and the message says what moves; a hard one is not singular."""

from __future__ import annotations

import re

from petsc4py import PETSc

import hand_torn
import numpy as np
import pytest
import scipy.linalg
from collective import agree, equal

from dolfinx_feti.errors import SetUpError, SingularError

SEED = 4711
Reason = PETSc.KSP.ConvergedReason

every_type = pytest.mark.parametrize("kind", ["all_floating", "classical"])
every_interior = pytest.mark.parametrize("interior", ["keep", "eliminate"])


def nowhere(x):
    return np.zeros(len(x), dtype=bool)


def components(where, *which):
    """Hold some components of the nodes where a condition holds."""
    return lambda x: where(x)[:, None] & np.isin(np.arange(x.shape[1]), which)


def both(first, second):
    return lambda x: first(x) | second(x)


def origin(x):
    return np.all(x == 0.0, axis=1)


def edge(x):
    return np.all(x[:, :2] == 0.0, axis=1)


def face(x):
    return x[:, 0] == 0.0


#: Grid, where it is held, dimension of the kernel, what the message says.
FREE = {
    "Neumann's problem in 1-D": ((3,), (2,), 1, nowhere, 1, "a constant"),
    "Neumann's problem in 3-D": ((2, 1, 2), (2, 2, 2), 1, nowhere, 1, "a constant"),
    "free in the plane": ((2, 2), (2, 2), 2, nowhere, 3, "2 translations and 1 rotation free"),
    "free in space": ((2, 2, 1), (2, 1, 2), 3, nowhere, 6, "3 translations and 3 rotations free"),
    "held at a point of the plane": (
        (2, 2), (3, 2), 2, components(origin, 0, 1), 1, "leave 1 rotation free",
    ),
    "slides in the plane": (
        (3, 2), (2, 2), 2, components(face, 0), 1, "leave 1 translation free",
    ),
    "held at a point": (
        (2, 2, 2), (1, 1, 1), 3, components(origin, 0, 1, 2), 3, "leave 3 rotations free",
    ),
    "held on a line": (
        (2, 1, 2), (2, 2, 2), 3, components(edge, 0, 1, 2), 1, "leave 1 rotation free",
    ),
    "turns and slides along a line": (
        (2, 1, 2), (2, 2, 2), 3, components(edge, 0, 1), 2, "1 translation and 1 rotation free",
    ),
    "slides on a plane": (
        (2, 2, 1), (2, 2, 2), 3, components(face, 0), 3, "2 translations and 1 rotation free",
    ),
    "slides on two planes": (
        (3, 1, 1), (2, 2, 2), 3, both(components(face, 0), components(lambda x: x[:, 2] == 0.0, 2)),
        1, "leave 1 translation free",
    ),
}  # fmt: skip


def message(parts, A, **options):
    with pytest.raises(SingularError) as caught:
        parts(A, **options)
    return str(caught.value)


def check(parts, A, dimension, text, **options):
    """Assert that all processes raise an error with this dimension and these words."""
    said = message(parts, A, **options)
    agree(f"singular, with a kernel of dimension {dimension}:" in said, said)
    agree(re.search(text, said), said)
    agree("Add Dirichlet conditions" in said, said)


@every_type
@every_interior
@pytest.mark.parametrize("case", FREE.values(), ids=FREE)
def test_body_that_moves_as_a_whole(case, kind, interior, torn_grid, parts):
    subdomains, cells, dofs, fixed, dimension, text = case
    problem = torn_grid(subdomains, cells, components=dofs, fixed=fixed)
    null = scipy.linalg.null_space(problem.free_matrix, rcond=1e-12)
    agree(null.shape[1] == dimension, null.shape)
    check(parts, problem.A, dimension, text, type=kind, interior=interior)


@every_type
@pytest.mark.parametrize("coarse_q", ["identity", "diagonal", "preconditioner"])
@pytest.mark.parametrize("pc_type", ["lumped", "identity", "dirichlet"])
def test_singular_with_any_coarse_matrix(kind, coarse_q, pc_type, torn_grid, parts):
    problem = torn_grid((3, 2), (2, 2), components=2, fixed=components(face, 0))
    options = {"type": kind, "coarse_q": coarse_q, "pc_type": pc_type}
    check(parts, problem.A, 1, "leave 1 translation free", **options)


def test_message_without_coordinates(torn_grid, parts):
    problem = torn_grid((2, 2), (2, 2), components=2, fixed=components(face, 0))
    problem.A.compose("coordinates", None)
    check(parts, problem.A, 1, "leave 1 translation free")


@every_type
@pytest.mark.parametrize("load", ["dead", "elastic support", "soft support"])
def test_prestressed_body(load, kind, torn_grid, parts):
    """Translations stay a kernel while the prestress is the body's own; a support ends that."""

    def springs(K, dofs):  # between the nodes, of either sign: rows that sum to zero
        rng = np.random.default_rng(SEED)
        for i, K_i in enumerate(K):
            weight = rng.standard_normal((len(K_i) // 2, len(K_i) // 2))
            weight = 2.0 * (weight + weight.T) * (K_i[::2, ::2] != 0.0)
            L = np.diag(weight.sum(axis=1)) - weight
            K_i += np.kron(L, np.eye(2))
            if load != "dead" and i == 0:
                K_i += {"elastic support": 1.0, "soft support": 1e-9}[load] * np.eye(len(K_i))

    problem = torn_grid((2, 2), (2, 2), components=2, fixed=nowhere, change=springs)
    values = np.abs(np.linalg.eigvalsh(problem.free_matrix))
    count = np.count_nonzero(values < 1e-13 * values.max())
    agree(count == (2 if load == "dead" else 0), np.sort(values)[:4])
    if load == "dead":
        check(parts, problem.A, 2, "leave 2 translations free", type=kind)
    else:
        agree(parts(problem.A, type=kind).inertia.dual > 0)


@every_type
@pytest.mark.parametrize("stiff", [1.0, 1e6, 1e8])
def test_interior_is_singular_and_the_whole_is_not(stiff, kind, torn_grid, parts):
    """An indefinite tangent, far from an equilibrium: no kernel is claimed that there is not."""

    def shift(K, dofs):
        here, count = np.unique(np.concatenate(dofs), return_counts=True)
        inner = np.flatnonzero(np.isin(dofs[0], here[count == 1]))
        inner, last = inner[:-1], inner[-1]
        K[0][inner, inner] -= np.linalg.eigvalsh(K[0][np.ix_(inner, inner)])[0]
        for stored in (K[0][last], K[0][:, last]):
            stored[inner] = 0.0  # the stiff dof is no part of the motion
        K[0][last, last] = stiff

    problem = torn_grid((2, 2), (4, 4), components=1, fixed=nowhere, change=shift)
    values = np.linalg.eigvalsh(problem.free_matrix)
    agree(values[0] < 0.0 and np.abs(values).min() > 1e-4, values)
    with pytest.raises(SetUpError) as caught:
        parts(problem.A, type=kind, interior="eliminate")
    said = str(caught.value)
    agree("kernel of dimension" not in said and "interior" in said, said)
    agree("other subdomains, or the options feti_interior keep" in said, said)


# ---- several bodies, and mechanisms ---------------------------------------------------------


def bricks(places, cells, components, fixed, *, one=False):
    """Tear bricks that share nodes where they touch; each a subdomain, or all one."""
    pattern, K_0 = hand_torn.brick(cells, components)
    nodes = np.argwhere(np.ones([n + 1 for n in cells])) * 1.0
    points = np.concatenate([nodes + place for place in places])
    x, number = np.unique(points, axis=0, return_inverse=True)
    number = number.reshape(len(places), -1)
    dofs = [(n[:, None] * components + np.arange(components)).ravel() for n in number]
    mask = np.broadcast_to(fixed(x).reshape(len(x), -1), (len(x), components)).ravel()
    K, modes = [K_0] * len(places), hand_torn.kernel(x, components)
    if not one:
        return hand_torn.tear(K, dofs, x, modes, mask, pattern=pattern)
    whole_K = np.zeros((len(mask), len(mask)))
    coupled = np.zeros_like(whole_K)
    for d in dofs:
        whole_K[np.ix_(d, d)] += K_0
        coupled[np.ix_(d, d)] += pattern
    return hand_torn.tear([whole_K], [np.arange(len(mask))], x, modes, mask, pattern=coupled)


@pytest.fixture
def torn_bricks():
    made = []

    def create(*args, **kwargs):
        made.append(bricks(*args, **kwargs))
        return made[-1]

    yield create
    for problem in made:
        problem.destroy()


APART = [(0, 0), (2, 0), (9, 0), (11, 0)]


@every_type
@every_interior
def test_one_of_two_bodies_is_not_held(kind, interior, torn_bricks, parts):
    problem = torn_bricks(APART, (2, 2), 2, face)
    text = r"not connected to the rest \(2 of 2 around \(11, 1\)\) .* 2 translations and 1 rotation"
    check(parts, problem.A, 3, text, type=kind, interior=interior)


@every_type
def test_each_body_says_what_it_lacks(kind, torn_bricks, parts):
    def fixed(x):
        return components(face, 0)(x) | components(lambda x: x[:, 0] == 13.0, 0, 1)(x)

    problem = torn_bricks(APART, (2, 2), 2, fixed)
    check(parts, problem.A, 1, r"1 of 2 around \(2, 1\)\) .* leave 1 translation", type=kind)


@every_type
def test_bodies_that_only_a_held_node_connects(kind, torn_bricks, parts):
    """Both turn about the node in which they touch and are held."""
    problem = torn_bricks([(0, 0), (2, 2)], (2, 2), 2, lambda x: np.all(x == 2.0, axis=1))
    text = r"\(1 of 2 .* leave 1 rotation free; .*\(2 of 2 .* leave 1 rotation free"
    check(parts, problem.A, 2, text, type=kind)


@every_type
@every_interior
@pytest.mark.parametrize("one", [False, True], ids=["between subdomains", "inside"])
def test_hinge_is_a_mechanism(one, kind, interior, torn_bricks, parts):
    """A brick turns about the node by which it hangs on another."""
    problem = torn_bricks([(0, 0), (2, 2)], (2, 2), 2, face, one=one)
    text = r"nothing resists a motion that is not rigid, largest at \((4, 4|2, 4|4, 2)\)"
    check(parts, problem.A, 1, text, type=kind, interior=interior)


@every_type
@every_interior
@pytest.mark.parametrize("dense", [1000, 5], ids=["all vectors", "inverse iteration"])
def test_hinge_that_is_held_is_no_mechanism(dense, kind, interior, torn_bricks, feti, monkeypatch):
    """The hinge in one subdomain is a null vector beyond the rigid ones, and joins them."""
    monkeypatch.setattr("dolfinx_feti.feti.subdomain.nullspace.ALL_VECTORS", dense)

    def fixed(x):
        return face(x)[:, None] | components(lambda x: np.all(x == 4.0, axis=1), 1)(x)

    hinge = bricks([(0, 0), (2, 2)], (2, 2), 2, fixed, one=True)
    other, K_0 = hinge.K[0], hand_torn.brick((2, 2), 2)[1]
    x = np.vstack([hinge.x, np.array([4.0, 2.0]) + np.argwhere(np.ones((3, 3)))])
    x, number = np.unique(x, axis=0, return_inverse=True)
    number = number.ravel()
    dofs = [
        (n[:, None] * 2 + np.arange(2)).ravel()
        for n in (number[: len(hinge.x)], number[len(hinge.x) :])
    ]
    problem = hand_torn.tear(
        [other, K_0], dofs, x, hand_torn.kernel(x, 2), fixed(x).ravel(), pattern=None
    )
    values = hand_torn.random_values(problem)
    ksp = feti(problem.A, feti_type=kind, feti_interior=interior, ksp_rtol=1e-11)
    reason, u = hand_torn.solve(ksp, problem, values)
    agree(reason > 0, ksp.getPythonContext().message)
    equal(u, problem.solve(values), 1e-8)
    hinge.destroy()
    problem.destroy()


def test_many_loose_bodies(torn_bricks, parts):
    problem = torn_bricks([(0, 0), (5, 0), (10, 0), (15, 0), (20, 0), (25, 0)], (1, 1), 2, face)
    check(parts, problem.A, 15, r"\(2 of 6.*\(4 of 6.*; 2 more parts are free")


def test_error_is_a_reason_on_all_processes(torn_bricks, feti):
    problem = torn_bricks(APART, (2, 2), 2, face)
    ksp = feti(problem.A)
    reason, _ = hand_torn.solve(ksp, problem, hand_torn.random_values(problem))
    agree(reason == Reason.DIVERGED_PCSETUP_FAILED)
    agree(ksp.getPythonContext().singular and "dimension 3" in ksp.getPythonContext().message)


# ---- no false alarm -------------------------------------------------------------------------

HARD = {
    "jumps of the stiffness": {
        "subdomains": (3, 3), "cells": (2, 2), "stiffness": lambda i: 1e8 ** (i % 2),
    },
    "jumps downwards": {
        "subdomains": (4, 1), "cells": (2, 2), "stiffness": lambda i: 1e-8**i,
    },
    "slender": {"subdomains": (40, 1), "cells": (6, 1)},
    "slender row of subdomains": {"subdomains": (120, 1), "cells": (2, 1)},
    "solid beam": {"subdomains": (16, 1, 1), "cells": (6, 1, 1), "components": 3},
    "held in two nodes": {
        "subdomains": (3, 2), "cells": (3, 3), "fixed": lambda x: origin(x) | origin(x - [0, 1]),
    },
    "weak springs": {
        "subdomains": (3, 2), "cells": (3, 3), "fixed": nowhere,
        "change": lambda K, dofs: [
            np.fill_diagonal(k, k.diagonal() + 1e-9 * k.diagonal()) for k in K
        ],
    },
    "far from the origin": {"subdomains": (3, 2), "cells": (3, 3)},
}  # fmt: skip


@every_type
@every_interior
@pytest.mark.parametrize("grid", HARD.values(), ids=HARD)
def test_hard_problems_are_not_singular(grid, kind, interior, torn_grid, parts):
    system = parts(torn_grid(**{"components": 2, **grid}).A, type=kind, interior=interior)
    agree(system.coarse.total >= 0)
