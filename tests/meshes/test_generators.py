# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Files and command lines of tubes; what generators refuse."""

from __future__ import annotations

import re
import sys

import numpy as np
import pytest
from collective import COMM, agree, raises
from mesh_files import watertight
from wall_files import ROOT

from dolfinx_feti.meshes import cube, ellipsoid, files, octant, tube, vessel
from dolfinx_feti.meshes.tags import SURFACE_TAGS
from dolfinx_feti.wall.wallfile import read_wall_arrays

pytestmark = pytest.mark.serial


@pytest.mark.parametrize("quarter", [False, True])
def test_tube(tmp_path, quarter):
    """The boundary of a tube is closed, and a quarter ends exactly in its planes."""
    n = 4 if quarter else 16
    path = tmp_path / "t.msh"
    quality = tube.write_tube(path, length=2.0, quarter=quarter, through=(2, 1), around=n, along=7)
    wall = read_wall_arrays(path)
    agree(quality.cells == 3 * 2 * 3 * n * 7 and quality.minimum > 0.3, quality)
    watertight(wall)
    for axis, name in enumerate(("symmetry_x", "symmetry_y")):
        corners = wall.facets[wall.facet_tags == SURFACE_TAGS[name]]
        agree((len(corners) > 0) == quarter and np.all(wall.points[corners][..., axis] == 0))


def test_finer_tubes_have_more_cells(tmp_path):
    """A smaller element size gives more cells."""
    made = [tube.write_tube(tmp_path / "t.msh", size=s).cells for s in (0.4, 0.26, 0.13)]
    agree(made[0] < made[1] < made[2] and 15_000 < made[2] < 25_000, made)


def test_files_are_whole_or_not_there(tmp_path, monkeypatch):
    """If writing fails, the old file is unchanged, and no partial one is left."""
    path = tmp_path / "t.msh"
    path.write_text("mine")

    def full(*args, **kwargs):
        raise OSError("no space left on device")

    monkeypatch.setattr(files.np, "savetxt", full)
    with raises(OSError, "no space"):
        tube.write_tube(path, size=0.4)
    agree(path.read_text() == "mine" and [p.name for p in tmp_path.iterdir()] == ["t.msh"])


def test_command_line_makes_the_example(tmp_path, monkeypatch):
    """The command of README.md creates meshes/example.msh."""
    readme = (ROOT / "meshes/README.md").read_text(encoding="utf-8")
    command = re.search(r"python3 -m meshes\.tube meshes/example\.msh (.*)`", readme)
    monkeypatch.setattr(sys, "argv", ["prog", str(tmp_path / "new/t.msh"), *command[1].split()])
    tube.main()
    made = (tmp_path / "new/t.msh").read_bytes()
    example = ROOT / "meshes/example.msh"
    agree(made == example.read_bytes() and made.startswith(b"$MeshFormat\n2.2 "))
    agree(len(made) < 100_000)
    words = "prog t.msh --size 0.4 --quarter --through 1 1".split()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", words)
    tube.main()
    agree("symmetry_x" in read_wall_arrays(tmp_path / "t.msh").surface_names)


@pytest.mark.parametrize(
    ("module", "words", "said"),
    [
        (tube, ["--size", "-1"], "argument --size: '-1' is not a positive number"),
        (tube, ["--around", "0"], "argument --around: '0' is not a number 1, 2, 3"),
        (vessel, ["--thickness", "nan"], "argument --thickness: 'nan' is not a positive number"),
        (vessel, ["--through", "1", "x"], "argument --through: 'x' is not a number 1, 2, 3"),
    ],
)
def test_wrong_words(tmp_path, monkeypatch, capsys, module, words, said):
    """Wrong command line arguments exit with status 2 and a message, and write nothing."""
    monkeypatch.setattr(sys, "argv", ["prog", str(tmp_path / "w.msh"), *words])
    with pytest.raises(SystemExit) as caught:
        module.main()
    assert caught.value.code == 2
    assert said in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("create", "options", "message"),
    [
        (tube.write_tube, {"length": 0.0}, "length=0.0"),
        (tube.write_tube, {"size": float("inf")}, "size=inf"),
        (tube.write_tube, {"through": (1, 0)}, r"through=\(1, 0\)"),
        (tube.write_tube, {"around": 2}, "around=2"),
        (tube.write_tube, {"around": 0}, "around=0"),
        (tube.write_tube, {"along": -1}, "along=-1"),
        (vessel.write_vessel, {"size": 0.0}, "size=0.0"),
        (vessel.write_vessel, {"size": float("nan")}, "size=nan"),
        (vessel.write_vessel, {"thickness": -1.0}, "thickness=-1.0"),
        (vessel.write_vessel, {"scale": 0.0}, "scale=0.0"),
        (vessel.write_vessel, {"layers": {"wall": 0.0}}, "the share 0.0 of 'wall'"),
        (vessel.write_vessel, {"layers": {"lumen": 1.0}}, "'lumen' is the name of a surface"),
        (vessel.write_vessel, {"layers": {}}, "layers is empty: name a layer"),
        (vessel.write_vessel, {"layers": {"wall": 1.0}, "through": (1, 1)}, "of the 1 layers"),
        (vessel.write_vessel, {"through": (0, 1)}, r"through=\(0, 1\)"),
    ],
)
def test_wrong_values(tmp_path, create, options, message):
    """Wrong arguments are refused, and an existing file is not changed."""
    path = tmp_path / "v.msh"
    path.write_text("mine")
    with raises(ValueError, message):
        create(path, **options)
    agree(path.read_text() == "mine" and [p.name for p in tmp_path.iterdir()] == ["v.msh"])


def test_other_formats_are_refused(tmp_path):
    """A file name that ends neither in .xdmf nor in .msh is refused, before a wall is made."""
    with raises(ValueError, r"t\.vtu.*ends in \.xdmf or \.msh"):
        tube.write_tube(tmp_path / "t.vtu", size=0.4)
    with raises(ValueError, r"v\.vtu.*ends in \.xdmf or \.msh"):
        vessel.write_vessel(tmp_path / "v.vtu", surface=tmp_path / "missing.stl")
    agree(not list(tmp_path.iterdir()))


@pytest.mark.parametrize(
    ("create", "right", "name"),
    [
        (ellipsoid.create_ellipsoid, {"n": 1, "through": 1}, "n"),
        (ellipsoid.create_ellipsoid, {"n": 1, "through": 1}, "through"),
        (octant.create_octant, {"divisions": 1, "through": 1}, "divisions"),
        (octant.create_octant, {"divisions": 1, "through": 1}, "through"),
        (cube.create_cube, {"subcubes": 1, "cells": 1}, "subcubes"),
        (cube.create_cube, {"subcubes": 1, "cells": 1}, "cells"),
    ],
)
def test_numbers_below_one_are_refused(create, right, name):
    """One number at a time is zero."""
    with raises(ValueError, f"{name} = 0: .*1 or more"):
        create(COMM, **right | {name: 0})
