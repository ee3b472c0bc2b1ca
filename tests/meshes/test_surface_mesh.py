# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Surfaces of triangles: read from files, remeshed, and grown to prisms."""

from __future__ import annotations

import numpy as np
import pytest
from cases import each
from collective import agree, equal, small
from mesh_files import pipe, watertight, write_stl

from dolfinx_feti.meshes import surface
from dolfinx_feti.meshes.layers import Rim, create_sheets, grow_wall
from dolfinx_feti.meshes.quality import measure_quality
from dolfinx_feti.meshes.remesh import remesh
from dolfinx_feti.meshes.surface import find_edges, read_stl, triangle_angles
from dolfinx_feti.meshes.tags import SURFACE_TAGS

pytestmark = pytest.mark.serial


@pytest.mark.parametrize("name", ["p.stl", "p.stl.gz", "binary.stl"])
def test_surfaces_are_read(tmp_path, name):
    """Surfaces of triangles are read from each format."""
    x, t = pipe()
    y, s = read_stl(write_stl(tmp_path / name, x, t, binary=name == "binary.stl"))
    agree(y.shape == x.shape and s.shape == t.shape)
    # the points are numbered anew
    key = [np.lexsort(np.round(p[r].mean(axis=1), 5).T) for p, r in ((x, t), (y, s))]
    equal(x[t[key[0]]].mean(axis=1), y[s[key[1]]].mean(axis=1), 1e-6)


#: A point, and the nearest point of the triangle (0, 0), (1, 0), (0, 1) in the plane z = 0.
NEAREST = {
    "above": ((0.25, 0.25, 1.0), (0.25, 0.25, 0.0)),
    "beyond the longest edge": ((1.0, 1.0, 0.5), (0.5, 0.5, 0.0)),
    "beyond a short edge": ((0.5, -1.0, 0.5), (0.5, 0.0, 0.0)),
    "beyond the right angle": ((-1.0, -1.0, 0.5), (0.0, 0.0, 0.0)),
    "beyond a sharp corner": ((3.0, -1.0, 0.5), (1.0, 0.0, 0.0)),
}


@each(("point", "expected"), NEAREST)
def test_nearest_point_of_a_triangle(point, expected):
    """The nearest point lies in the triangle, on an edge or at a vertex, as known by hand."""
    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    found = surface._nearest_on_triangles(np.array(point), *corners)
    equal(found, expected, 1e-15)


def test_remeshing_makes_good_triangles():
    """Remeshed triangles are of good quality."""
    x, t = pipe(n=60, m=9)
    y, s = remesh(x, t, size=0.9)
    length = np.linalg.norm(np.diff(y[find_edges(s).ends], axis=1)[:, 0], axis=1)
    small(length.mean() / 0.9 - 1, 0.1)
    agree(np.degrees(triangle_angles(y, s)).min() > 25)
    equal(np.unique(y[find_edges(s).rim.ravel(), 2]), [0, 10], 1e-12)


def test_quality_of_known_tetrahedra():
    """The quality is 1 for a regular tetrahedron, 0 for a flat and negative for an inverted one."""
    regular = np.array([[0, 0, 0], [1, 1, 0], [1, 0, 1], [0, 1, 1]], dtype=float)
    flat = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], dtype=float)
    expected = {
        1.0: (regular, [0, 1, 3, 2]),
        -1.0: (regular, [0, 1, 2, 3]),
        0.0: (flat, [0, 1, 2, 3]),
    }
    for q, (x, corners) in expected.items():
        small(measure_quality(x, np.array([corners])).minimum - q, 1e-12)


def test_prisms_match_for_any_numbering():
    """Neighbouring prisms split their common face alike, for any numbering."""
    x, t = pipe(n=9, m=4)
    number = np.random.default_rng(7043).permutation(len(x))
    y = np.empty_like(x)
    y[number] = x
    s = number[t]
    edges = find_edges(s).rim
    rim = Rim(edges, np.full(len(edges), SURFACE_TAGS["opening_1"]))
    sheets = create_sheets({"media": 1.0, "adventitia": 1.0}, (1, 2))
    wall = grow_wall(y, y * [1.3, 1.3, 1], s, sheets=sheets, rim=rim)
    agree(measure_quality(wall.points, wall.cells).minimum > 0)
    watertight(wall)
