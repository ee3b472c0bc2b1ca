# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Opening angles on a wall: the tube, whose radii are known, also after it has moved."""

from __future__ import annotations

import numpy as np
import pytest
from collective import COMM, agree, equal, raises, small
from wall_files import EXAMPLE

import ufl

from dolfinx_feti.output import cell_values
from dolfinx_feti.wall import Wall, read_wall
from dolfinx_feti.wall.opening import Opening
from meshes.bricks import create_brick_tube

ANGLES = {"media": 120.0, "adventitia": 60.0}


@pytest.fixture(scope="module")
def wall() -> Wall:
    return read_wall(EXAMPLE, COMM)


def mean_of(values: np.ndarray) -> float:
    return COMM.allreduce(float(values.sum())) / COMM.allreduce(values.size)


def test_tube(wall):
    """Curvature 1/ρ up to what a coarse mesh leaves; G keeps the volume; layers differ."""
    opening = Opening(wall, ANGLES)
    x = wall.mesh.geometry.x
    n = wall.mesh.topology.index_map(3).size_local
    curvature = opening.curvature.x.array[:n]
    small(mean_of(curvature) - 1 / 0.9, 0.2)
    equal(cell_values(ufl.det(opening.G), wall.mesh), np.ones(n), 1e-12)
    before, scale = curvature.copy(), 1.5
    x *= scale
    opening.update()
    x /= scale
    equal(opening.curvature.x.array[:n] * scale, before, 1e-9)


def test_stretch_around_is_that_of_a_tube():
    """Of a quarter, in cells at the planes of symmetry, too."""
    shape = {"length": 0.18, "size": 0.18, "around": 4, "along": 1, "through": (3, 1)}
    wall = create_brick_tube(COMM, quarter=True, **shape)
    opening = Opening(wall, ANGLES, {"media": 1.1, "adventitia": 1.0})
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


def test_inside_is_pressed_and_outside_pulled(wall):
    """λ = 1/|G ê₀| grows through each layer; without an angle it is one."""
    opening = Opening(wall, ANGLES)
    e0 = opening.directions[0]
    λ = cell_values(1 / ufl.inner(e0, opening.G * e0), wall.mesh)
    t = cell_values(opening.potentials[0], wall.mesh)
    for tag in wall.layers.values():
        cells = wall.cell_tags.find(tag)
        cells = cells[cells < len(λ)]
        inside, outside = (np.sign(t[cells] - opening.middle.x.array[cells]) == s for s in (-1, 1))
        agree((λ[cells][inside] <= 1).all() and (λ[cells][outside] >= 1).all())
    agree(COMM.allreduce(float(np.ptp(λ))) > 0.02)
    opening.angle.x.array[:] = 0.0
    equal(
        cell_values(opening.G, wall.mesh).reshape(-1, 9),
        np.tile(np.eye(3).ravel(), (len(λ), 1)),
        1e-12,
    )


def test_bad_input(wall):
    with raises(ValueError, "angle = 360"):
        Opening(wall, {"media": 360.0, "adventitia": 0.0})
    with raises(ValueError, "values are given for media"):
        Opening(wall, {"media": 10.0})
    with raises(ValueError, "stretch = 0"):
        Opening(wall, ANGLES, {"media": 0.0, "adventitia": 1.0})
