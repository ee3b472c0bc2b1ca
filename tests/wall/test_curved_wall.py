# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Gmsh files of curved cells and of hexahedra: read as walls, their volumes, areas, directions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from collective import COMM, agree, small
from ufl_values import scalar
from wall_files import on_first

import dolfinx
import ufl

from dolfinx_feti.wall import area, openings, read_wall
from dolfinx_feti.wall.fibres import fibre_frame
from dolfinx_feti.wall.wall import plane

gmsh = pytest.importorskip("gmsh")

INNER, OUTER, LENGTH = 0.7, 1.1, 0.5


def write(path: Path, *, order: int, hexahedra: bool) -> Path:
    """Let Gmsh mesh a quarter of a tube, with four cells around it."""
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    model = gmsh.model
    model.add("quarter")
    section = model.occ.addRectangle(INNER, 0.0, 0.0, OUTER - INNER, LENGTH)  # in the plane z = 0
    turned = model.occ.revolve(
        [(2, section)], 0, 0, 0, 0, 1, 0, np.pi / 2, numElements=[4], recombine=hexahedra
    )
    model.occ.synchronize()
    for curve in model.getBoundary([(2, section)], combined=False):
        model.mesh.setTransfiniteCurve(abs(curve[1]), 3)
    model.mesh.setTransfiniteSurface(section)
    if hexahedra:
        model.mesh.setRecombine(2, section)
    volume = next(tag for dim, tag in turned if dim == 3)
    model.addPhysicalGroup(3, [volume], 1, "media")
    for dim, tag in model.getBoundary([(3, volume)], oriented=False):
        x, y, z = model.occ.getCenterOfMass(dim, tag)
        names = {"opening_1": y < 1e-9, "opening_2": y > LENGTH - 1e-9}
        names |= {"symmetry_x": abs(x) < 1e-9, "symmetry_y": abs(z) < 1e-9}
        name = next((name for name, here in names.items() if here), None)
        if name is None:
            name = "lumen" if np.hypot(x, z) < (INNER + OUTER) / 2 * 0.9 else "outer"
        model.addPhysicalGroup(dim, [tag], -1, name)
    model.mesh.generate(3)
    model.mesh.setOrder(order)
    gmsh.write(str(path))
    gmsh.finalize()
    return path


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("hexahedra", [False, True])
def test_wall_of_gmsh(tmp_path, order, hexahedra):
    """Chords miss a circle by (angle)²/6 of its area, parabolas by (angle)⁴/480."""
    path = COMM.bcast(tmp_path / "quarter.msh")
    on_first(lambda: str(write(path, order=order, hexahedra=hexahedra)))
    wall = read_wall(path, COMM)
    nodes = {(1, False): 4, (2, False): 10, (1, True): 8, (2, True): 27}[order, hexahedra]
    mesh = wall.mesh
    agree(mesh.geometry.cmap.dim == nodes)
    volume = scalar(dolfinx.fem.Constant(mesh, 1.0) * ufl.dx)
    angle = np.pi / 8
    factor = np.sin(angle) / angle if order == 1 else 1.0
    tolerance = 1e-9 if order == 1 else angle**4 / 100
    segment = np.pi / 4 * (OUTER**2 - INNER**2) * factor
    small(volume / (segment * LENGTH) - 1.0, tolerance)
    agree(openings(wall) == ["opening_1", "opening_2"])
    small(area(wall, "opening_1") / segment - 1.0, tolerance)
    chord = 2 * np.sin(angle / 2) / angle if order == 1 else 1.0
    small(area(wall, "lumen") / (np.pi / 2 * INNER * LENGTH * chord) - 1.0, tolerance)
    small(area(wall, "symmetry_x") / ((OUTER - INNER) * LENGTH) - 1.0, 1e-9)
    axis, place = plane(wall, "symmetry_x")
    agree(axis == 0)
    small(place, 1e-9)
    x = dolfinx.mesh.compute_midpoints(
        mesh, 3, np.arange(mesh.topology.index_map(3).size_local, dtype=np.int32)
    )
    radial = x * [1, 0, 1] / np.hypot(x[:, 0], x[:, 2])[:, None]
    found = fibre_frame(wall).transmural.x.array.reshape(-1, 3)[: len(x)]
    small(1.0 - np.abs(np.sum(radial * found, axis=1)).min(initial=1.0), 1e-2)
