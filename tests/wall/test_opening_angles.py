# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Opening angles on a wall: a tube of known radii, also after its mesh has moved."""

from __future__ import annotations

import numpy as np
import pytest
from collective import COMM, equal, raises
from wall_files import EXAMPLE

import ufl

from dolfinx_feti.meshes.bricks import create_brick_tube
from dolfinx_feti.output import cell_values
from dolfinx_feti.wall import Wall, read_wall
from dolfinx_feti.wall.opening_angles import OpeningAngles

ANGLES = {"media": 120.0, "adventitia": 60.0}


@pytest.fixture(scope="module")
def wall() -> Wall:
    """A tube of two layers."""
    return read_wall(EXAMPLE, COMM)


def test_stretch_around_is_that_of_a_tube():
    """The circumferential stretch grows through each layer as in a tube, also in a quarter."""
    shape = {"length": 0.18, "size": 0.18, "around": 4, "along": 1, "through": (3, 1)}
    wall = create_brick_tube(COMM, quarter=True, **shape)
    opening = OpeningAngles(wall, ANGLES, {"media": 1.1, "adventitia": 1.0})
    e0 = opening.directions[0]
    x = ufl.SpatialCoordinate(wall.mesh)
    r, λ = (
        cell_values(each, wall.mesh)
        for each in (ufl.sqrt(x[0] ** 2 + x[1] ** 2), 1 / ufl.inner(e0, opening.G * e0))
    )
    for name, middle, k, stretch in (("media", 0.84, 1.5, 1.1), ("adventitia", 1.035, 1.2, 1.0)):
        cells = wall.cell_tags.find(wall.layers[name])
        ρ = r[cells[cells < len(r)]]
        exact = k * ρ / np.sqrt((k * middle) ** 2 + k * stretch * (ρ**2 - middle**2))
        equal(λ[cells[cells < len(r)]], exact, 1e-3)


def test_moved_and_closed(wall):
    """Curvatures scale with the wall; det G = 1, and G = I without an angle."""
    opening = OpeningAngles(wall, ANGLES)
    x = wall.mesh.geometry.x
    n = wall.mesh.topology.index_map(3).size_local
    before = opening.curvature.x.array[:n].copy()
    scale = 1.5
    equal(cell_values(ufl.det(opening.G), wall.mesh), np.ones(n), 1e-12)
    x *= scale
    opening.update()
    x /= scale
    equal(opening.curvature.x.array[:n] * scale, before, 1e-9)
    opening.angle.x.array[:] = 0.0
    G = cell_values(opening.G, wall.mesh).reshape(-1, 9)
    equal(G, np.tile(np.eye(3).ravel(), (n, 1)), 1e-12)


def test_bad_input(wall):
    """Angles of 360°, missing layers and stretches of zero are refused."""
    with raises(ValueError, "angle = 360"):
        OpeningAngles(wall, {"media": 360.0, "adventitia": 0.0})
    with raises(ValueError, "values are given for media"):
        OpeningAngles(wall, {"media": 10.0})
    with raises(ValueError, "stretch = 0"):
        OpeningAngles(wall, ANGLES, {"media": 0.0, "adventitia": 1.0})
