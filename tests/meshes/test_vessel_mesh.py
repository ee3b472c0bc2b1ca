# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The wall of the vessel: quality, tags, volumes, closedness; and surfaces that are refused."""

from __future__ import annotations

import sys
from types import SimpleNamespace

import numpy as np
import pytest
from collective import agree, equal, raises, small
from mesh_files import areas, pipe, volumes, watertight, write_stl

from dolfinx_feti.meshes import vessel
from dolfinx_feti.meshes.surface import SurfaceProjection, read_stl
from dolfinx_feti.meshes.tags import SURFACE_TAGS
from dolfinx_feti.wall.wallfile import read_wall_arrays

pytestmark = pytest.mark.serial

THICKNESS = 1.0
MEDIA = 2 / 3


@pytest.fixture(scope="module")
def artery(tmp_path_factory):
    """The vessel of the demo, with its file."""
    path = tmp_path_factory.mktemp("vessel") / "vessel.msh"
    quality = vessel.write_vessel(path)
    return SimpleNamespace(path=path, quality=quality, wall=read_wall_arrays(path))


def test_vessel_is_good(artery):
    """The vessel has about 40 000 good tetrahedra and a closed boundary."""
    quality = artery.quality
    agree(36_000 < quality.cells < 44_000, quality)
    agree(quality.minimum >= 0.2, quality)
    agree(sum(quality.histogram) == quality.cells and quality.histogram[:2] == (0, 0), quality)
    agree("quality" in str(quality) and "0.2: " in str(quality))
    watertight(artery.wall)


def test_vessel_has_layers_and_openings(artery):
    """The layers have their volumes, and the openings their radii.

    Volume = mean of inner and outer area times thickness; the media has less than 2/3, as it is
    inside. Mean radii of the openings are 4.3, 3.5 and 2.9 mm, in the order of size.
    """
    area = areas(artery.wall)
    volume = volumes(artery.wall)
    openings = [f"opening_{k}" for k in (1, 2, 3)]
    agree(set(volume) == {"media", "adventitia"} and set(area) == {"lumen", "outer", *openings})
    radii = np.array([4.342, 3.503, 2.946])
    rings = np.pi * ((radii + THICKNESS) ** 2 - radii**2)
    equal([area[name] for name in openings], rings, 0.05)
    mean = (area["lumen"] + area["outer"]) / 2
    small(sum(volume.values()) / (mean * THICKNESS) - 1, 0.02)
    share = volume["media"] / sum(volume.values())
    agree(0.60 < share < MEDIA)


def test_vessel_does_not_overlap_itself(artery):
    """No point of the outer wall is much nearer to the lumen than the thickness."""
    wall = artery.wall
    t = wall.facets[wall.facet_tags == SURFACE_TAGS["lumen"]]
    outer = wall.points[np.unique(wall.facets[wall.facet_tags == SURFACE_TAGS["outer"]])]
    distance = np.linalg.norm(
        outer - SurfaceProjection(wall.points, t).project(outer, candidates=60), axis=1
    )
    agree(distance.min() > 0.85 * THICKNESS)
    agree(distance.max() < 1.25 * THICKNESS)


def test_vessel_lies_on_the_surface(artery):
    """The points of the lumen lie on the given surface, and have its area."""
    wall = artery.wall
    x, t = read_stl(vessel.find_surface())
    lumen = wall.facets[wall.facet_tags == SURFACE_TAGS["lumen"]]
    points = wall.points[np.unique(lumen)]
    small(np.linalg.norm(points - SurfaceProjection(x, t).project(points), axis=1).max(), 1e-9)
    a, b, c = np.moveaxis(x[t], 1, 0)
    given = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    small(areas(wall)["lumen"] / given - 1, 0.01)


def test_quality_is_gmshs(artery):
    """The quality of tetrahedra is the one that Gmsh computes."""
    gmsh = pytest.importorskip("gmsh")
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.merge(str(artery.path))
        tags = np.concatenate(gmsh.model.mesh.getElements(3)[1])
        q = np.asarray(gmsh.model.mesh.getElementQualities(tags, "minSICN"))
    finally:
        gmsh.finalize()
    equal([q.min(), q.mean()], [artery.quality.minimum, artery.quality.mean], 1e-8)


@pytest.fixture(scope="module")
def coarse(tmp_path_factory):
    """The file of a coarse vessel."""
    path = tmp_path_factory.mktemp("coarse") / "vessel.msh"
    vessel.write_vessel(path, size=2.4)
    return path


def test_command_line_makes_the_same_vessel(coarse, tmp_path, monkeypatch):
    """The command line generates the same vessel, byte for byte."""
    path = tmp_path / "new" / "w.msh"
    monkeypatch.setattr(sys, "argv", ["prog", str(path), "--size", "2.4"])
    vessel.main()
    agree(path.read_bytes() == coarse.read_bytes())
    agree(path.read_text().startswith("$MeshFormat\n2.2 "))


@pytest.mark.parametrize(
    ("layers", "through", "size"),
    [
        ({"media": 0.5, "adventitia": 0.5}, (3, 2), 1.0),
        ({"intima": 2.0, "media": 5.0, "adventitia": 3.0}, None, 0.8),
    ],
)
def test_layers_of_a_pipe(tmp_path, layers, through, size):
    """Each layer of a pipe lies between its radii, with its number of elements."""
    stl = write_stl(tmp_path / "pipe.stl", *pipe(), binary=True)
    path = tmp_path / "v.msh"
    of = {"thickness": 1.0, "layers": layers, "through": through}
    vessel.write_vessel(path, surface=stl, size=size, **of)
    wall = read_wall_arrays(path)
    watertight(wall)
    volume = volumes(wall)
    R = 3.0 + np.cumsum([0.0, *layers.values()]) / sum(layers.values())
    equal([volume[name] for name in layers], np.pi * 10 * np.diff(R**2), 0.03)
    count = [np.sum(wall.cell_tags == wall.layer_names[name]) for name in layers]
    if through is not None:
        agree(2 * count[0] == 3 * count[1], count)


def test_one_layer_from_a_surface_in_metres(tmp_path, monkeypatch, capsys):
    """The command line grows one named layer on a surface in metres, of either orientation."""
    path = tmp_path / "wall.msh"
    x, t = pipe()
    stl = write_stl(tmp_path / "pipe.stl", x / 1000, t[:, ::-1], binary=True)
    words = f"prog {path} --surface {stl} --scale 1000 --size 1.2 --layers wall --through 2"
    monkeypatch.setattr(sys, "argv", words.split())
    vessel.main()
    wall = read_wall_arrays(path)
    watertight(wall)
    agree(wall.layer_names == {"wall": 101}, wall.layer_names)
    agree(set(wall.surface_names) == {"lumen", "outer", "opening_1", "opening_2"})
    equal(volumes(wall)["wall"], np.pi * 10 * (4**2 - 3**2), 0.03)
    monkeypatch.setattr(sys, "argv", words.replace("wall --through", "outer --through").split())
    with pytest.raises(SystemExit) as end:
        vessel.main()
    said = capsys.readouterr().err.splitlines()
    agree(end.value.code == 2 and len(said) == 1 and "name of a surface" in said[0], said)


def test_wall_too_thick_for_its_crotches_is_refused(coarse, tmp_path):
    """A wall too thick for the crotches of its lumen is refused."""
    wall = read_wall_arrays(coarse)
    t = wall.facets[wall.facet_tags == SURFACE_TAGS["lumen"]]
    stl = write_stl(tmp_path / "lumen.stl", wall.points, t, binary=True)
    with raises(ValueError, "quality of .* less than 0.1"):
        vessel.write_vessel(tmp_path / "v.msh", surface=stl, size=6.0, thickness=4.0)
    agree([p.name for p in tmp_path.iterdir()] == ["lumen.stl"])


def test_missing_surface_names_the_remedies(tmp_path):
    """A missing surface file is an error with its remedies."""
    with raises(FileNotFoundError, "apt install gmsh-doc.*pip install gmsh.*--surface"):
        vessel.find_surface([tmp_path])


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda x, t: t[:0], "no triangle"),
        (lambda x, t: np.vstack([t[:1, ::-1], t[1:]]), "face one way"),
        (lambda x, t: np.vstack([t, t[:1, [1, 0, 2]], [[t[0, 0], t[0, 1], len(x) - 1]]]), "repair"),
        (lambda x, t: [[0, 2, 1], [0, 1, 30], [0, 30, 2], [1, 2, 30]], "closed"),
    ],
    ids=["empty", "turned", "doubled", "closed"],
)
def test_bad_surfaces_are_refused(tmp_path, spoil, message):
    """Surfaces that are not closed, manifold or oriented are refused."""
    x, t = pipe()
    stl = write_stl(tmp_path / "p.stl", x, np.asarray(spoil(x, t)), binary=True)
    with raises(ValueError, message):
        vessel.write_vessel(tmp_path / "v.msh", surface=stl, size=2.0)
