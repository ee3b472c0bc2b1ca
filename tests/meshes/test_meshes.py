# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The generators of walls: quality, tags, watertightness, volumes; and what they refuse."""

from __future__ import annotations

import gzip
import re
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from collective import agree, equal, raises, small
from wall_files import ROOT, on_first

from dolfinx_feti.wall.wallfile import NUMBERS, read_raw_wall
from meshes import tube, vessel, wall_mesh
from meshes.layers import grow, sheets
from meshes.remesh import remesh
from meshes.surface import Guide, find_edges, read_stl, triangle_angles
from meshes.wall_mesh import TAGS, WallMesh, measure_quality, write_msh

pytestmark = pytest.mark.serial

THICKNESS, MEDIA = 1.0, 2 / 3


@pytest.fixture(scope="module")
def artery(tmp_path_factory):
    """The vessel of the demo, with its file."""
    path = on_first(lambda: tmp_path_factory.mktemp("vessel") / "vessel.msh")
    quality = on_first(lambda: vessel.create_vessel(path))
    return SimpleNamespace(quality=quality, wall=on_first(lambda: read_raw_wall(path)))


def faces(cells):
    return np.sort(cells[:, [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]].reshape(-1, 3), axis=1)


def areas(wall):
    """Area of each surface [mm²]."""
    a, b, c = np.moveaxis(wall.points[wall.facets], 1, 0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    return {n: area[wall.surfaces == t].sum() for n, t in wall.surface_names.items()}


def volumes(wall):
    """Volume of each layer [mm³]."""
    volume = np.abs(np.linalg.det(wall.points[wall.cells[:, 1:]] - wall.points[wall.cells[:, :1]]))
    return {n: volume[wall.layers == t].sum() / 6 for n, t in wall.layer_names.items()}


def watertight(wall):
    """Assert that the facets are the faces of one cell alone, each of them once."""
    found, count = np.unique(faces(wall.cells), axis=0, return_counts=True)
    agree(count.max() == 2)
    equal(np.unique(np.sort(wall.facets, axis=1), axis=0), found[count == 1])
    agree(len(wall.facets) == np.sum(count == 1))


def pipe(n=24, m=12, radius=3.0, length=10.0):
    """A straight lumen with open ends, triangles facing outwards."""
    axis, t, _ = tube._lumen(n, m, quarter=False)
    return axis * [radius, radius, length], t


def write_stl(path, x, t, *, binary):
    if binary:
        record = np.zeros(len(t), dtype=[("n", "<f4", 3), ("x", "<f4", (3, 3)), ("a", "<u2")])
        record["x"] = x[t]
        path.write_bytes(b"\0" * 80 + np.uint32(len(t)).tobytes() + record.tobytes())
        return path
    corner = "\n".join(
        "facet\nouter loop\n{}\nendloop\nendfacet".format(
            "\n".join("vertex {:.9g} {:.9g} {:.9g}".format(*p) for p in x[s])
        )
        for s in t
    )
    text = f"solid pipe\n{corner}\nendsolid pipe\n".encode()
    path.write_bytes(gzip.compress(text) if path.suffix == ".gz" else text)
    return path


# -- the vessel


def test_vessel_is_good(artery):
    """About 40 000 tetrahedra, none of them bad; the histogram counts them all."""
    quality = artery.quality
    agree(36_000 < quality.cells < 44_000, quality)
    agree(quality.minimum >= 0.2, quality)
    agree(sum(quality.histogram) == quality.cells and quality.histogram[:2] == (0, 0), quality)
    agree("quality" in str(quality) and "0.2: " in str(quality))


def test_vessel_is_watertight(artery):
    watertight(artery.wall)


def test_vessel_has_its_names(artery):
    agree(set(artery.wall.layer_names) == {"media", "adventitia"})
    openings = {f"opening_{k}" for k in (1, 2, 3)}
    agree(set(artery.wall.surface_names) == {"lumen", "outer"} | openings)


def test_vessel_openings_are_rings(artery):
    """Mean radii of 4.3, 3.5 and 2.9 mm, from the wide one to the narrow one."""
    area = areas(artery.wall)
    rings = np.array([area[f"opening_{k}"] for k in (1, 2, 3)])
    radii = np.array([4.342, 3.503, 2.946])
    equal(rings, np.pi * ((radii + THICKNESS) ** 2 - radii**2), 0.05)


def test_vessel_has_the_thickness(artery):
    """Volume = mean of inner and outer area times thickness; media below 2/3, being inside."""
    area, volume = areas(artery.wall), volumes(artery.wall)
    mean = (area["lumen"] + area["outer"]) / 2
    small(sum(volume.values()) / (mean * THICKNESS) - 1, 0.02)
    share = volume["media"] / sum(volume.values())
    agree(0.60 < share < MEDIA, share)


def test_vessel_does_not_overlap_itself(artery):
    """No point of the outer wall is much nearer to the lumen than the thickness."""
    wall = artery.wall
    t = wall.facets[wall.surfaces == TAGS["lumen"]]
    outer = wall.points[np.unique(wall.facets[wall.surfaces == TAGS["outer"]])]
    distance = np.linalg.norm(outer - Guide(wall.points, t).project(outer, candidates=60), axis=1)
    agree(distance.min() > 0.85 * THICKNESS, distance.min())
    agree(distance.max() < 1.25 * THICKNESS, distance.max())


def test_vessel_lies_on_the_surface(artery):
    """The lumen's points lie on the given surface, and its area is the given one."""
    wall = artery.wall
    x, t = read_stl(vessel.find_surface())
    lumen = wall.facets[wall.surfaces == TAGS["lumen"]]
    points = wall.points[np.unique(lumen)]
    small(np.linalg.norm(points - Guide(x, t).project(points), axis=1).max(), 1e-9)
    a, b, c = np.moveaxis(x[t], 1, 0)
    given = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    small(areas(wall)["lumen"] / given - 1, 0.01)


def test_quality_is_gmshs(artery, tmp_path):
    gmsh = pytest.importorskip("gmsh")
    path = tmp_path / "wall.msh"

    def ask():
        wall = artery.wall
        mesh = WallMesh(wall.points, wall.cells, wall.layers, wall.facets, wall.surfaces)
        write_msh(path, mesh)
        gmsh.initialize(readConfigFiles=False, interruptible=False)
        try:
            gmsh.option.setNumber("General.Terminal", 0)
            gmsh.merge(str(path))
            tags = np.concatenate(gmsh.model.mesh.getElements(3)[1])
            return np.asarray(gmsh.model.mesh.getElementQualities(tags, "minSICN"))
        finally:
            gmsh.finalize()

    q = on_first(ask)
    equal([q.min(), q.mean()], [artery.quality.minimum, artery.quality.mean], 1e-8)


def test_vessel_is_the_same_every_time(tmp_path):
    paths = [tmp_path / name for name in ("a.msh", "b.msh")]
    made = [on_first(lambda p=p: vessel.create_vessel(p, size=2.2).cells) for p in paths]
    agree(made[0] == made[1] and paths[0].read_bytes() == paths[1].read_bytes())


def test_layers_of_several_elements(tmp_path):
    def make():
        stl = write_stl(tmp_path / "pipe.stl", *pipe(), binary=True)
        vessel.create_vessel(tmp_path / "v.msh", surface=stl, size=1.0, media=0.5, through=(3, 2))
        return read_raw_wall(tmp_path / "v.msh")

    wall = on_first(make)
    watertight(wall)
    count = [np.sum(wall.layers == TAGS[name]) for name in ("media", "adventitia")]
    agree(2 * count[0] == 3 * count[1], count)
    R = 3.0
    exact = [np.pi * 10 * ((R + 0.5) ** 2 - R**2), np.pi * 10 * ((R + 1) ** 2 - (R + 0.5) ** 2)]
    equal(list(volumes(wall).values()), exact, 0.03)


@pytest.mark.parametrize("name", ["p.stl", "p.stl.gz", "binary.stl"])
def test_surfaces_are_read(tmp_path, name):
    x, t = pipe()

    def make():
        return read_stl(write_stl(tmp_path / name, x, t, binary=name == "binary.stl"))

    y, s = on_first(make)
    agree(y.shape == x.shape and s.shape == t.shape)
    # the points are numbered anew
    key = [np.lexsort(np.round(p[r].mean(axis=1), 5).T) for p, r in ((x, t), (y, s))]
    equal(x[t[key[0]]].mean(axis=1), y[s[key[1]]].mean(axis=1), 1e-6)


@pytest.mark.parametrize("turned", [False, True])
def test_surface_may_face_either_way(tmp_path, turned):
    x, t = pipe()

    def make():
        stl = write_stl(tmp_path / "p.stl", x, t[:, ::-1] if turned else t, binary=True)
        return vessel.create_vessel(tmp_path / "v.msh", surface=stl, size=1.2).volume

    equal(on_first(make), np.pi * 10 * (4**2 - 3**2), 0.03)


def test_remeshing_makes_good_triangles():
    x, t = pipe(n=60, m=9)
    y, s = remesh(x, t, size=0.9)
    length = np.linalg.norm(np.diff(y[find_edges(s).ends], axis=1)[:, 0], axis=1)
    small(length.mean() / 0.9 - 1, 0.1)
    agree(np.degrees(triangle_angles(y, s)).min() > 25)
    equal(np.unique(y[find_edges(s).rim.ravel(), 2]), [0, 10], 1e-12)


# -- what the vessel refuses


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"size": 0.0}, "size=0.0"),
        ({"size": float("nan")}, "size=nan"),
        ({"thickness": -1.0}, "thickness=-1.0"),
        ({"media": 1.0}, "media=1.0"),
        ({"through": (0, 1)}, r"through=\(0, 1\)"),
        ({"size": 3.0, "thickness": 3.0}, "quality of .* less than 0.1"),
    ],
)
def test_vessel_refuses(tmp_path, options, message):
    path = tmp_path / "v.msh"
    on_first(lambda: path.write_text("mine"))
    with raises(ValueError, message):
        on_first(lambda: vessel.create_vessel(path, **options))
    agree(path.read_text() == "mine" and [p.name for p in tmp_path.iterdir()] == ["v.msh"])


def test_missing_surface_names_the_remedies(tmp_path):
    with raises(FileNotFoundError, "apt install gmsh-doc.*pip install gmsh.*--surface"):
        vessel.find_surface([tmp_path])


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda x, t: t[:0], "no triangle"),
        (lambda x, t: np.vstack([t[:1, ::-1], t[1:]]), "face one way"),
        (lambda x, t: np.vstack([t, t[:1, [1, 0, 2]], [[t[0, 0], t[0, 1], len(x) - 1]]]), "repair"),
    ],
    ids=["empty", "turned", "doubled"],
)
def test_bad_surfaces_are_refused(tmp_path, spoil, message):
    x, t = pipe()

    def make():
        stl = write_stl(tmp_path / "p.stl", x, spoil(x, t), binary=True)
        vessel.create_vessel(tmp_path / "v.msh", surface=stl)

    with raises(ValueError, message):
        on_first(make)


def test_closed_surface_is_refused(tmp_path):
    x = np.array([[0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 0, 9]], dtype=float)
    t = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])

    def make():
        stl = write_stl(tmp_path / "p.stl", x, t, binary=False)
        vessel.create_vessel(tmp_path / "v.msh", surface=stl, size=2.0)

    with raises(ValueError, "closed"):
        on_first(make)


def test_files_are_whole_or_not_there(tmp_path, monkeypatch):
    path = tmp_path / "t.msh"
    on_first(lambda: path.write_text("mine"))

    def full(*args, **kwargs):
        raise OSError("no space left on device")

    monkeypatch.setattr(wall_mesh.np, "savetxt", full)
    with raises(OSError, "no space"):
        on_first(lambda: tube.create_tube(path, size=0.4))
    agree(path.read_text() == "mine" and [p.name for p in tmp_path.iterdir()] == ["t.msh"])


# -- the tube


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


# -- files and commands


def test_example_is_what_the_generator_makes(tmp_path):
    """README.md names the command for meshes/example.msh."""
    readme = (ROOT / "meshes/README.md").read_text(encoding="utf-8")
    command = re.search(r"python3 -m meshes\.tube meshes/example\.msh (.*)`", readme)
    words = command[1].split()
    options = {k.removeprefix("--"): float(v) for k, v in zip(words[::2], words[1::2], strict=True)}
    on_first(lambda: tube.create_tube(tmp_path / "t.msh", **options))
    example = ROOT / "meshes/example.msh"
    agree((tmp_path / "t.msh").read_bytes() == example.read_bytes())
    agree(example.stat().st_size < 100_000)


@pytest.mark.parametrize(
    ("module", "words"),
    [(tube, ["--size", "0.4", "--quarter", "--through", "1", "1"]), (vessel, ["--size", "2.4"])],
    ids=["tube", "vessel"],
)
def test_command_lines(tmp_path, monkeypatch, module, words):
    monkeypatch.setattr(sys, "argv", ["prog", str(tmp_path / "new" / "w.msh"), *words])
    on_first(module.main)
    agree((tmp_path / "new" / "w.msh").read_text().startswith("$MeshFormat\n2.2 "))


def test_tags_are_the_readers():
    """Generators and reader agree on numbers without sharing code."""
    agree(TAGS == NUMBERS)


def test_quality_of_known_tetrahedra():
    """1 for the regular one, negative inside out, 0 when flat."""
    regular = np.array([[0, 0, 0], [1, 1, 0], [1, 0, 1], [0, 1, 1]], dtype=float)
    flat = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], dtype=float)
    expected = {
        1.0: (regular, [0, 1, 3, 2]),
        -1.0: (regular, [0, 1, 2, 3]),
        0.0: (flat, [0, 1, 2, 3]),
    }
    for q, (x, corners) in expected.items():
        one = np.array([1])
        mesh = WallMesh(x, np.array([corners]), one, np.zeros((0, 3), dtype=int), one[:0])
        small(measure_quality(mesh).minimum - q, 1e-12)


def test_prisms_match_for_any_numbering():
    """Neighbouring columns cut the side between them alike, whatever the numbers are."""
    x, t = pipe(n=9, m=4)
    number = np.random.default_rng(7043).permutation(len(x))
    y = np.empty_like(x)
    y[number] = x
    s = number[t]
    rim = find_edges(s).rim
    tags = np.full(len(rim), TAGS["opening_1"])
    mesh = grow(y, y * [1.3, 1.3, 1], s, through=sheets(0.5, (1, 2)), rim=(rim, tags))
    agree(measure_quality(mesh).minimum > 0)
    watertight(SimpleNamespace(cells=mesh.cells, facets=mesh.facets))
