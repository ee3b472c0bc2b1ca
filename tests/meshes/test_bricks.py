# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Tubes from a file and of bricks, straight and curved; the unit cube in subcubes."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from collective import COMM, agree, equal, raises, small, whole
from wall_files import tube_wall

import dolfinx
import ufl

from dolfinx_feti.meshes.bricks import create_brick_tube
from dolfinx_feti.meshes.cube import create_cube


def integrals(mesh: dolfinx.mesh.Mesh, tags: dolfinx.mesh.MeshTags, kind: str) -> dict[int, float]:
    """Return volume or area of each tag."""
    found = {}
    measure = ufl.Measure(kind, mesh, subdomain_data=tags)
    one = dolfinx.fem.Constant(mesh, 1.0)
    for tag in np.unique(np.concatenate(COMM.allgather(np.unique(tags.values)))):
        own = dolfinx.fem.assemble_scalar(dolfinx.fem.form(one * measure(int(tag))))
        found[int(tag)] = COMM.allreduce(own)
    return found


@pytest.mark.parametrize("quarter", [False, True])
@pytest.mark.parametrize(
    ("kind", "order"), [("file", 1), *itertools.product(("hexahedra", "tetrahedra"), (1, 2))]
)
def test_tube(tmp_path, kind, order, quarter):
    """Volumes and areas of tubes are those of polygons or parabolas.

    Polygons of order 1 are those of the chords; parabolas miss a circle by (angle)⁴/480.
    """
    n = 4 if quarter else 16
    L = 1.0
    angle = 2 * np.pi / 16
    if kind == "file":
        counts = {"around": n, "through": (1, 1), "along": 10}
        wall = tube_wall(tmp_path, length=L, quarter=quarter, **counts)
    else:
        shape = {"order": order, "tetrahedra": kind == "tetrahedra"}
        wall = create_brick_tube(COMM, length=L, size=0.1, quarter=quarter, around=n, **shape)
    mesh = wall.mesh
    r = np.array([0.71, 0.97, 1.10])
    segments = n * r**2 * (np.sin(angle) if order == 1 else angle) / 2
    tolerance = 1e-9 if kind == "file" else 1e-12
    if order == 2:
        tolerance = angle**4 / 100
    bricks = n * 10 * (2 if kind == "file" else 4)
    agree(mesh.topology.index_map(3).size_global == bricks * (1 if kind == "hexahedra" else 6))
    volume = integrals(mesh, wall.cell_tags, "dx")
    volumes = [volume[wall.layers[name]] for name in ("media", "adventitia")]
    equal(volumes, L * np.diff(segments), tolerance)
    area = integrals(mesh, wall.facet_tags, "ds")
    sides = n * r * L * (2 * np.sin(angle / 2) if order == 1 else angle)
    expected = {"lumen": sides[0], "outer": sides[2]}
    expected |= dict.fromkeys(("opening_1", "opening_2"), segments[2] - segments[0])
    if quarter:
        expected |= dict.fromkeys(("symmetry_x", "symmetry_y"), L * (r[2] - r[0]))
    agree(set(wall.surfaces) == set(expected))
    equal([area[wall.surfaces[name]] for name in expected], list(expected.values()), tolerance)


def test_growth():
    """With growth, three elements of 1, 2 and 4 parts fill the media."""
    wall = create_brick_tube(
        COMM, length=1.0, size=1.0, quarter=True, around=2, through=(3, 1), growth=8.0, order=1
    )
    radii = COMM.allgather(np.unique(np.round(np.hypot(*wall.mesh.geometry.x[:, :2].T), 12)))
    expected = [*(0.71 + 0.26 * np.array([0, 1, 3, 7]) / 7), 1.10]
    equal(np.unique(np.concatenate(radii)), expected, 1e-11)


@pytest.mark.parametrize("wrong", [{"order": 3}, {"size": -1.0}, {"growth": 0.0}])
def test_wrong_arguments(wrong):
    """Bad sizes and numbers of elements are refused."""
    with raises(ValueError, "give lengths and a growth above zero, and order 1 or 2"):
        create_brick_tube(COMM, **({"length": 1.0, "size": 0.2} | wrong))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"along": 0}, "along=0: take one element or more"),
        ({"around": 2}, "around=2, .*three or more around a whole tube"),
        ({"around": 0, "quarter": True}, "around=0"),
        ({"through": (0, 1)}, r"through=\(0, 1\)"),
        ({"length": float("inf")}, "length=inf is not a positive number"),
    ],
    ids=["along", "around", "around-a-quarter", "through", "length"],
)
def test_numbers_of_elements_that_make_no_tube(wrong, message):
    """Numbers of elements that are too small for a tube are refused."""
    with raises(ValueError, message):
        create_brick_tube(COMM, **({"length": 1.0, "size": 0.2} | wrong))


@pytest.mark.parametrize(("subdomains", "cells"), [(2, 1), (2, 2), (3, 1)])
def test_mesh_fills_the_cube_and_keeps_subcubes_together(subdomains, cells):
    """The mesh fills the unit cube, and each subcube lies on one process."""
    mesh, part = create_cube(COMM, subdomains, cells)
    n = mesh.topology.index_map(3).size_local
    agree(len(part) == n and mesh.topology.index_map(3).num_ghosts == 0)
    volume = COMM.allreduce(dolfinx.fem.assemble_scalar(dolfinx.fem.form(1.0 * ufl.dx(mesh))))
    small(volume - 1.0, 1e-12)
    edge = subdomains * cells
    nodes = (edge + 1) ** 3 + edge**3 + 3 * edge**2 * (edge + 1)
    agree(mesh.topology.index_map(0).size_global == nodes)
    middle = dolfinx.mesh.compute_midpoints(mesh, 3, np.arange(n, dtype=np.int32))
    place = np.floor(subdomains * middle).astype(int)
    equal(np.ravel_multi_index(tuple(place.T), (subdomains,) * 3), part)
    count = np.bincount(whole(part), minlength=subdomains**3)
    agree(np.all(count == 24 * cells**3), count)
    mine = COMM.allgather(set(part.tolist()))
    agree(sum(map(len, mine)) == subdomains**3, mine)  # none on two processes
