# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The tube: all its numbers are known; and what its generator refuses."""

from __future__ import annotations

import numpy as np
import pytest
from collective import agree, equal, raises
from mesh_files import areas, volumes, watertight
from wall_files import on_first

from dolfinx_feti.wall.wallfile import read_raw_wall
from meshes import tube
from meshes.wall_mesh import TAGS

pytestmark = pytest.mark.serial


@pytest.mark.parametrize("quarter", [False, True])
def test_tube(tmp_path, quarter):
    """All numbers of a polygonal tube are known."""
    n, L = (4, 2.0) if quarter else (16, 2.0)
    path = tmp_path / "t.msh"

    def make():
        return tube.create_tube(
            path, length=L, quarter=quarter, through=(2, 1), around=n, along=7
        ), read_raw_wall(path)

    quality, wall = on_first(make)
    agree(quality.cells == 3 * 2 * 3 * n * 7 and quality.minimum > 0.3, quality)
    watertight(wall)
    corner = 2 * np.pi / 16
    r = np.array([0.71, 0.97, 1.10])
    segments = n * np.sin(corner) / 2 * r**2  # of the polygons, per radius
    equal(list(volumes(wall).values()), L * np.diff(segments), 1e-9)
    area = areas(wall)
    sides = n * 2 * r * np.sin(corner / 2) * L
    equal([area["lumen"], area["outer"]], sides[[0, 2]], 1e-9)
    equal([area["opening_1"], area["opening_2"]], [segments[2] - segments[0]] * 2, 1e-9)
    agree(("symmetry_x" in area) == ("symmetry_y" in area) == quarter)
    if quarter:
        equal([area["symmetry_x"], area["symmetry_y"]], [L * (r[2] - r[0])] * 2, 1e-9)
        for axis, name in enumerate(("symmetry_x", "symmetry_y")):
            corners = wall.facets[wall.surfaces == TAGS[name]]
            agree(np.all(wall.points[corners][..., axis] == 0))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"length": 0.0}, "length=0.0"),
        ({"size": float("inf")}, "size=inf"),
        ({"through": (1, 0)}, r"through=\(1, 0\)"),
        ({"around": 2}, "around=2"),
        ({"around": 0}, "around=0"),
        ({"along": -1}, "along=-1"),
    ],
)
def test_tube_refuses(tmp_path, options, message):
    with raises(ValueError, message):
        on_first(lambda: tube.create_tube(tmp_path / "t.msh", **options))
    agree(not list(tmp_path.iterdir()))


def test_finer_tubes_have_more_cells(tmp_path):
    made = [
        on_first(lambda s=s: tube.create_tube(tmp_path / "t.msh", size=s).cells)
        for s in (0.4, 0.26, 0.13)
    ]
    agree(made[0] < made[1] < made[2] and 15_000 < made[2] < 25_000, made)
