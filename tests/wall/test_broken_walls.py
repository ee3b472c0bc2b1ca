# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A folder of broken meshes and cases: one error each, on all processes, and no crash."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from broken_walls import BROKEN, EXAMPLE
from collective import COMM, agree, equal, raises, small, whole
from problems import owned
from wall_files import on_first

import dolfinx

from dolfinx_feti.wall import Clamp, Pressure, Slide, apply_conditions, area, read_case, read_wall
from dolfinx_feti.wall.fibres import Frame, fibre_frame
from dolfinx_feti.wall.wallfile import read_raw_wall
from meshes.wall_mesh import write_msh


def test_there_are_thirty():
    agree(len(BROKEN) >= 30, len(BROKEN))


@pytest.mark.parametrize("name", BROKEN)
def test_broken(tmp_path, name):
    """The error names the file, in one line."""
    write, match = BROKEN[name]
    path = on_first(lambda: write(tmp_path))
    read = read_case if path.suffix == ".toml" else read_wall
    with pytest.raises((ValueError, OSError)) as caught:
        read(path, COMM)
    said = str(caught.value)
    agree(name in said, said)
    with raises(type(caught.value), match):
        raise caught.value


@pytest.mark.parametrize("scale", [1e-3, 1e-9, 1e6])
def test_nothing_depends_on_the_unit_of_length(tmp_path, scale):
    """A wall in metres is as good as one in millimetres."""
    path = tmp_path / "wall.msh"
    mesh = on_first(lambda: read_raw_wall(EXAMPLE))
    on_first(lambda: write_msh(path, replace(mesh, points=scale * mesh.points)))
    wall, same = read_wall(path, COMM), read_wall(EXAMPLE, COMM)
    equal(
        np.array([area(wall, n) for n in same.surfaces]) / scale**2,
        [area(same, n) for n in same.surfaces],
        1e-9,
    )
    frames = fibre_frame(wall), fibre_frame(same)
    for e, expected in zip(*(directions(frame) for frame in frames), strict=True):
        small(np.abs(e - expected).max(), 1e-6)
    for each in (wall, same):
        V = dolfinx.fem.functionspace(each.mesh, ("Lagrange", 1, (3,)))
        conditions = {"lumen": Pressure(), "opening_1": Clamp(), "opening_2": Slide()}
        boundary = apply_conditions(each, dolfinx.fem.Function(V), conditions, axis="z")
        agree(boundary.energy is not None, "the pressure has a potential")


def directions(frame: Frame) -> list[np.ndarray]:
    """The vectors of the owned cells, each sorted."""
    parts = (frame.circumferential, frame.longitudinal, frame.transmural)
    return [np.sort(whole(owned(f)).reshape(-1, 3), axis=0) for f in parts]
