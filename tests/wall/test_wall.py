# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Walls from files: equal tags on any number of processes, formats, and clear errors."""

from __future__ import annotations

import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from broken_walls import BROKEN, EXAMPLE
from collective import COMM, agree, equal, raises, small, whole
from ufl_values import scalar
from wall_files import ROOT, centroids, on_first

import dolfinx
import ufl

from dolfinx_feti.meshes.files import write_msh
from dolfinx_feti.meshes.tags import LAYER_TAGS, SURFACE_TAGS
from dolfinx_feti.meshes.walls import open_wall
from dolfinx_feti.wall import area, by_layer, facets, openings, read_case, read_wall
from dolfinx_feti.wall.fibres import fibre_frame
from dolfinx_feti.wall.wall import plane
from dolfinx_feti.wall.wallfile import read_wall_arrays

GROUPS = {name: (3, tag) for name, tag in LAYER_TAGS.items()}
GROUPS |= {name: (2, tag) for name, tag in SURFACE_TAGS.items()}
AROUND = 14
LENGTH = 1.0
RADII = np.array([0.71, 0.97, 1.10])
ANGLE = 2 * np.pi / AROUND


@pytest.fixture(scope="module")
def wall():
    return read_wall(EXAMPLE, COMM)


@pytest.fixture(scope="module")
def raw():
    """The example as arrays, on every process."""
    return on_first(lambda: read_wall_arrays(EXAMPLE))


def read_changed(tmp_path, arrays, names=None):
    """Write changed arrays, perhaps with other names of groups, as a wall, and read it."""
    if names is not None:
        arrays = replace(arrays, layer_names=names, surface_names=names)
    on_first(lambda: write_msh(tmp_path / "wall.msh", arrays))
    return read_wall(tmp_path / "wall.msh", COMM)


# -- what a wall is


def test_every_cell_has_its_layer(wall):
    """Each cell has the tag of the layer at its radius."""
    tags = wall.cell_tags
    n = wall.mesh.topology.index_map(3).size_local
    mine = tags.values[tags.indices < n]
    equal(tags.indices[tags.indices < n], np.arange(n))
    agree(COMM.allreduce(n) == 336)
    x = centroids(wall)[:n]
    inside = np.linalg.norm(x[:, :2], axis=1) < RADII[1] * np.cos(ANGLE / 2)
    equal(mine == wall.layers["media"], inside)


def test_every_exterior_facet_has_its_surface(wall):
    """Each exterior facet has the tag of the surface at its position."""
    wall.mesh.topology.create_connectivity(2, 3)
    exterior = dolfinx.mesh.exterior_facet_indices(wall.mesh.topology)
    tagged = wall.facet_tags.indices
    equal(np.sort(tagged[np.isin(tagged, exterior)]), np.sort(exterior))
    side = 2 * np.sin(ANGLE / 2) * AROUND * LENGTH
    ring = AROUND * np.sin(ANGLE) / 2
    for name, r in (("lumen", RADII[0]), ("outer", RADII[2])):
        x = dolfinx.mesh.compute_midpoints(wall.mesh, 2, facets(wall, name))
        agree(np.all(np.abs(np.linalg.norm(x[:, :2], axis=1) / r - 1) < 0.05), name)
        equal(area(wall, name), side * r, 1e-9)
    for name, z in (("opening_1", 0.0), ("opening_2", LENGTH)):
        agree(plane(wall, name) == (2, z), name)
        equal(area(wall, name), ring * (RADII[2] ** 2 - RADII[0] ** 2), 1e-9)
    with raises(ValueError, "'lumen' lies in no plane normal to x, y or z .*turn the mesh, or"):
        plane(wall, "lumen")


@pytest.mark.parametrize(("step", "is_plane"), [(1e-8, True), (1e-5, False)])
def test_plane_up_to_rounding_of_single_precision(step, is_plane):
    """An opening counts as plane up to single-precision rounding of its points."""
    stepped = read_wall(EXAMPLE, COMM)
    x = stepped.mesh.geometry.x
    x[np.isclose(x[:, 2], 0.0) & (x[:, 0] > 0.0), 2] += step
    if is_plane:
        axis, z = plane(stepped, "opening_1")
        agree(axis == 2)
        small(z, step)
        return
    with raises(ValueError, "'opening_1' lies in no plane"):
        plane(stepped, "opening_1")


def test_names(wall):
    """The example has its layers and surfaces under their names."""
    agree(wall.layers == {"media": 1, "adventitia": 2} and len(wall.names) == 6)
    agree(wall.names == {name: GROUPS[name][1] for name in wall.names})
    with raises(ValueError, "no surface 'lume'; it has lumen, outer"):
        facets(wall, "lume")


def test_openings_are_sorted_by_number(wall):
    """Openings are sorted by their number, not as text."""
    names = ["opening_10", "opening_2", "lumen", "opening_1", "opening_arch"]
    other = replace(wall, surfaces={name: k for k, name in enumerate(names)})
    agree(openings(other) == ["opening_1", "opening_2", "opening_10", "opening_arch"])


def test_values_by_layer(wall):
    """``by_layer`` sets one value for each layer, and requires all layers."""
    f = by_layer(wall, {"media": 3.0, "adventitia": 0.3})
    r = np.linalg.norm(centroids(wall)[:, :2], axis=1)
    equal(f.x.array, np.where(r < RADII[1] * np.cos(ANGLE / 2), 3.0, 0.3))
    with raises(ValueError, "layers media, adventitia"):
        by_layer(wall, {"media": 3.0})


def test_scale(tmp_path, raw):
    """``scale=`` converts lengths, and has to be positive."""
    on_first(lambda: write_msh(tmp_path / "m.msh", replace(raw, points=raw.points / 1000)))
    metres = read_wall(tmp_path / "m.msh", COMM, scale=1000)
    equal(area(metres, "lumen"), area(read_wall(EXAMPLE, COMM), "lumen"), 1e-9)
    for scale in (0.0, -1.0, float("nan")):
        with raises(ValueError, "scale ="):
            read_wall(EXAMPLE, COMM, scale=scale)


# -- formats


@pytest.mark.parametrize("suffix", ["vtu", "xdmf", "vtk"])
def test_the_readmes_meshio_example(tmp_path, monkeypatch, wall, raw, suffix):
    """The meshio example of README.md, with the example's arrays, writes the example's wall."""
    pytest.importorskip("meshio")
    readme = (ROOT / "meshes/README.md").read_text(encoding="utf-8")
    code = re.findall(r"```python\n(.*?)```", readme, re.DOTALL)[1]
    code = re.sub(r"(points, .*surfaces = )\.\.\..*", r"\1arrays", code).replace(
        ".vtu", f".{suffix}"
    )
    arrays = (raw.points, raw.cells, raw.cell_tags, raw.facets, raw.facet_tags)
    monkeypatch.chdir(tmp_path)
    on_first(lambda: exec(code, {"arrays": arrays}))
    other = read_wall(tmp_path / f"own_wall.{suffix}", COMM, names=GROUPS)
    agree(other.names == wall.names)
    equal([area(other, n) for n in wall.surfaces], [area(wall, n) for n in wall.surfaces], 1e-9)
    count = [len(whole(w.cell_tags.find(1))) for w in (wall, other)]
    agree(count[0] == count[1], count)


@pytest.mark.parametrize(("suffix", "name"), [("mesh", "medit:ref"), ("vtu", "tag")])
def test_one_number_for_cells_and_triangles(tmp_path, wall, raw, suffix, name):
    """Names tell apart cells and triangles with one number, from formats with one kind of tag."""
    meshio = pytest.importorskip("meshio")
    path = tmp_path / f"wall.{suffix}"
    cells = [("tetra", raw.cells), ("triangle", raw.facets)]
    data = {name: [raw.cell_tags, raw.facet_tags]}
    on_first(lambda: meshio.Mesh(raw.points, cells, cell_data=data).write(path))
    agree(read_wall(path, COMM, names=GROUPS).names == wall.names)
    with raises(TypeError, r"names\['lumen'\] is 3: give Mapping\[str, tuple\[int, int\]\]"):
        read_wall(path, COMM, names={"lumen": 3})


def test_names_with_other_numbers(tmp_path, raw):
    """Layers and surfaces are identified by name, whatever their numbers."""
    names = {"media": 2, "adventitia": 1, "lumen": 4, "outer": 3, "opening_1": 11, "clamp": 12}
    other = read_changed(tmp_path, raw, names)
    agree(other.names == names)
    agree(openings(other) == ["opening_1"])


@pytest.mark.parametrize("names", [{"wall": 1}, {"intima": 1, "media": 2, "fat": 21}])
def test_any_number_of_layers(tmp_path, raw, names):
    """Layers and surfaces may have any number and names."""
    layers = np.array(list(names.values()))[np.arange(len(raw.cells)) % len(names)]
    inside = {"inside": SURFACE_TAGS["lumen"]}
    other = read_changed(tmp_path, replace(raw, cell_tags=layers), names | inside | {"unused": 99})
    agree((other.layers, other.surfaces) == (names, inside), other.names)
    count = [len(whole(other.cell_tags.find(tag))) for tag in names.values()]
    agree(sum(count) >= len(raw.cells) and min(count) > 0, count)


def test_numbers_that_have_no_names(tmp_path, raw):
    """Groups without a name are named by their number, not by an anatomical name."""
    layers = np.where(raw.cell_tags == 1, 1, 7)
    surfaces = np.where(raw.facet_tags == 4, 400, raw.facet_tags)
    other = read_changed(tmp_path, replace(raw, cell_tags=layers, facet_tags=surfaces), {})
    agree(other.layers == {"layer_1": 1, "layer_7": 7}, other.layers)
    agree(other.surfaces == {f"surface_{k}": k for k in (3, 11, 12, 400)}, other.surfaces)


def test_loose_points_do_no_harm(tmp_path, wall, raw):
    """Points without a cell are ignored."""
    points = np.vstack([[[9.0, 9, 9]], raw.points, [[8.0, 8, 8]]])
    moved = replace(raw, points=points, cells=raw.cells + 1, facets=raw.facets + 1)
    other = read_changed(tmp_path, moved)
    n = [w.mesh.geometry.index_map().size_global for w in (wall, other)]
    agree(n[0] == n[1] == len(raw.points), n)
    equal(area(other, "outer"), area(wall, "outer"), 1e-12)


def test_gmsh_is_left_running(wall):
    """A user's own Gmsh session survives reading a file."""
    gmsh = pytest.importorskip("gmsh")

    def run():
        gmsh.initialize(readConfigFiles=False, interruptible=False)
        try:
            gmsh.option.setNumber("General.Terminal", 0)
            gmsh.model.add("mine")
            read_wall_arrays(EXAMPLE)
            return gmsh.model.list(), gmsh.model.getCurrent()
        finally:
            gmsh.finalize()

    models, current = on_first(run)
    agree("mine" in models and current == "mine", (models, current))


def write_quarter(path: Path, *, order: int, hexahedra: bool) -> Path:
    """Mesh a quarter tube with Gmsh, with four cells around."""
    gmsh = pytest.importorskip("gmsh")
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    model = gmsh.model
    model.add("quarter")
    section = model.occ.addRectangle(
        RADII[0], 0.0, 0.0, RADII[2] - RADII[0], LENGTH
    )  # in the plane z = 0
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
            name = "lumen" if np.hypot(x, z) < (RADII[0] + RADII[2]) / 2 * 0.9 else "outer"
        model.addPhysicalGroup(dim, [tag], -1, name)
    model.mesh.generate(3)
    model.mesh.setOrder(order)
    gmsh.write(str(path))
    gmsh.finalize()
    return path


@pytest.mark.processes(1, 2)
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("hexahedra", [False, True])
def test_wall_of_gmsh(tmp_path, order, hexahedra):
    """Volumes and areas of Gmsh's walls are those of chords or parabolas.

    Chords miss a circle by (angle)²/6 of its area, parabolas by (angle)⁴/480.
    """
    pytest.importorskip("gmsh")
    path = COMM.bcast(tmp_path / "quarter.msh")
    on_first(lambda: str(write_quarter(path, order=order, hexahedra=hexahedra)))
    wall = read_wall(path, COMM)
    nodes = {(1, False): 4, (2, False): 10, (1, True): 8, (2, True): 27}[order, hexahedra]
    mesh = wall.mesh
    agree(mesh.geometry.cmap.dim == nodes)
    volume = scalar(dolfinx.fem.Constant(mesh, 1.0) * ufl.dx)
    angle = np.pi / 8
    factor = np.sin(angle) / angle if order == 1 else 1.0
    tolerance = 1e-9 if order == 1 else angle**4 / 100
    segment = np.pi / 4 * (RADII[2] ** 2 - RADII[0] ** 2) * factor
    small(volume / (segment * LENGTH) - 1.0, tolerance)
    agree(openings(wall) == ["opening_1", "opening_2"])
    small(area(wall, "opening_1") / segment - 1.0, tolerance)
    chord = 2 * np.sin(angle / 2) / angle if order == 1 else 1.0
    small(area(wall, "lumen") / (np.pi / 2 * RADII[0] * LENGTH * chord) - 1.0, tolerance)
    small(area(wall, "symmetry_x") / ((RADII[2] - RADII[0]) * LENGTH) - 1.0, 1e-9)
    axis, place = plane(wall, "symmetry_x")
    agree(axis == 0)
    small(place, 1e-9)
    x = dolfinx.mesh.compute_midpoints(
        mesh, 3, np.arange(mesh.topology.index_map(3).size_local, dtype=np.int32)
    )
    radial = x * [1, 0, 1] / np.hypot(x[:, 0], x[:, 2])[:, None]
    found = fibre_frame(wall).transmural.x.array.reshape(-1, 3)[: len(x)]
    small(1.0 - np.abs(np.sum(radial * found, axis=1)).min(initial=1.0), 1e-2)


@pytest.mark.processes(1, 2)
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("hexahedra", [False, True])
def test_quality_of_a_wall_of_gmsh(tmp_path, order, hexahedra):
    """Cells, quality and volume are those that Gmsh measures with straight edges."""
    gmsh = pytest.importorskip("gmsh")
    path = COMM.bcast(tmp_path / "quarter.msh")
    on_first(lambda: str(write_quarter(path, order=order, hexahedra=hexahedra)))

    def measure_in_gmsh() -> tuple[np.ndarray, np.ndarray]:
        gmsh.initialize(readConfigFiles=False, interruptible=False)
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.open(str(path))
        gmsh.model.mesh.setOrder(1)
        cells = gmsh.model.mesh.getElements(3)[1][0]
        qualities = gmsh.model.mesh.getElementQualities(cells, "minSICN")
        volumes = gmsh.model.mesh.getElementQualities(cells, "volume")
        gmsh.finalize()
        return qualities, volumes

    qualities, volumes = on_first(measure_in_gmsh)
    _, quality = open_wall(path, COMM, size=None, folder=path.parent)
    agree(quality.cells == len(qualities), quality)
    agree(quality.cell_name == ("hexahedra" if hexahedra else "tetrahedra"), quality)
    agree(f"{quality.cells} {quality.cell_name}" in str(quality), quality)
    small(quality.minimum - qualities.min(), 1e-6)
    small(quality.mean - qualities.mean(), 1e-6)
    small(quality.volume / volumes.sum() - 1.0, 1e-9)


# -- what is refused, on all processes


@pytest.mark.parametrize(("package", "name"), [("gmsh", "wall.msh"), ("meshio", "wall.vtu")])
def test_missing_package(tmp_path, monkeypatch, package, name):
    """Without gmsh or meshio the error names the package and how to install it."""
    on_first(lambda: (tmp_path / name).write_text(""))
    monkeypatch.setitem(sys.modules, package, None)
    with raises(ModuleNotFoundError, f"package {package}, .*pip install {package}"):
        read_wall(tmp_path / name, COMM)


@pytest.mark.parametrize("name", BROKEN)
def test_broken(tmp_path, name):
    """A broken file is an error of one line that names the file."""
    file = BROKEN[name]
    path = on_first(lambda: file.write_into(tmp_path))
    with pytest.raises((ValueError, OSError)) as caught:
        (read_case if path.suffix == ".toml" else read_wall)(path, COMM)
    agree(name in str(caught.value), caught.value)
    with raises(type(caught.value), file.match):
        raise caught.value


def test_disk_errors_reach_all(tmp_path, monkeypatch):
    """An error that the first process meets while reading is raised on each."""

    def broken(path):
        raise PermissionError(f"{path} may not be read")

    monkeypatch.setattr("dolfinx_feti.wall.wallfile.read_wall_arrays", broken)
    with raises(PermissionError, "may not be read"):
        read_wall(EXAMPLE, COMM)
