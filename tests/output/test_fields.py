# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Output for ParaView is read back by other libraries; what cannot be written is refused early."""

from __future__ import annotations

import errno
import os
import re
import tempfile
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt
import pytest
from collective import COMM, agree, equal, raises, small, whole
from problems import cube
from wall_files import on_first
from walls import create_mesh

import dolfinx
import ufl

from dolfinx_feti.output import FieldWriter, cell_values, writable_folder

Array = npt.NDArray[np.float64]

TIMES = (0.0, 1.5, 4.0)
ROUNDING = 100 * np.finfo(float).eps

needs_adios2 = pytest.mark.skipif(not dolfinx.has_adios2, reason="dolfinx has no ADIOS2")
KINDS = [pytest.param("vtx", marks=needs_adios2), "xdmf"]


def displacement(x: Array, t: float) -> Array:
    return (1 + t) * np.stack([x[0] ** 2, x[1] * x[2], 1 - x[2]])


def divergence(x: Array, t: float) -> Array:
    return (1 + t) * (2 * x[0] + x[2] - 1)


def layer(x: Array) -> Array:
    return np.where(x[0] < 0.5, 1.0, 2.0)


@pytest.fixture
def u() -> dolfinx.fem.Function:
    V = dolfinx.fem.functionspace(cube(3, 2), ("Lagrange", 2, (3,)))
    return dolfinx.fem.Function(V, name="displacement")


def write(path: Path, u: dolfinx.fem.Function, times: tuple[float, ...], kind: str) -> Path:
    """Write the displacement, its divergence and a number of each cell at these times."""
    Q = dolfinx.fem.functionspace(u.function_space.mesh, ("DG", 0))
    number = dolfinx.fem.Function(Q, name="layer")
    number.interpolate(layer)
    with FieldWriter(path, [u, number], {"divergence": ufl.div(u)}, kind=kind) as writer:
        for t in times:
            u.interpolate(lambda x, t=t: displacement(x, t))
            writer.write(t)
    return writer.path


def read_vtx(path: Path) -> list[dict[str, Array]]:
    """Read all steps with ADIOS2's own reader: points of the cells, their centroids, values."""
    import adios2

    fields = {"displacement", "divergence", "layer"}
    found = []
    with adios2.Stream(str(path), "r") as stream:
        for _ in stream.steps():
            names = fields & set(stream.available_variables()) | {"geometry", "connectivity"}
            parts = []
            for block in range(COMM.size):
                part = {name: stream.read(name, block_id=block) for name in names}
                cells = part.pop("connectivity")[:, 1:]  # the first column counts
                x = part.pop("geometry")
                centroids = np.full_like(x, np.nan)
                centroids[cells] = x[cells].mean(axis=1, keepdims=True)
                parts.append(part | {"points": x, "centroids": centroids})
            step = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
            found.append(step | {"t": float(stream.read("step"))})
    return found


def read_xdmf(path: Path) -> list[dict[str, Array]]:
    """Read all steps with an XML parser and h5py: vertices, centroids of the cells, values."""
    import h5py

    found: dict[float, dict[str, Array]] = {}
    with h5py.File(path.with_suffix(".h5")) as file:
        root = ElementTree.parse(path)
        meshes = [grid.get("Name") for grid in root.findall("./Domain/Grid[@GridType='Uniform']")]
        for grid in root.iterfind(".//Grid[Attribute]"):
            pointer = next(part.get("xpointer") for part in grid if "include" in part.tag)
            place = f"Mesh/{meshes[int(re.findall(r'[0-9]+', pointer)[0]) - 1]}"
            x, cells = (file[f"{place}/{name}"][:] for name in ("geometry", "topology"))
            t = float(grid.find("Time").get("Value"))
            field = grid.find("Attribute")
            mesh = {"t": t, "points": x, "centroids": x[cells].mean(axis=1)}
            values = file[field.find("DataItem").text.split(":")[1]][:]
            found.setdefault(t, mesh)[field.get("Name")] = values
    return [found[t] for t in sorted(found)]


def read(path: Path) -> list[dict[str, Array]]:
    vtx = path.suffix == ".bp"
    pytest.importorskip("adios2" if vtx else "h5py")
    return on_first(lambda: read_vtx(path) if vtx else read_xdmf(path))


# -- what is written


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_written_is_read(u, tmp_path, kind):
    """Other readers find the points and values of each step that was written.

    VTX has points for each cell; in XDMF a discontinuous field has one value for each cell.
    """
    path = write(tmp_path / "wall", u, TIMES, kind)
    agree(path == tmp_path / {"vtx": "wall.bp", "xdmf": "wall.xdmf"}[kind])
    steps = read(path)
    n = u.function_space.mesh.topology.index_map(3).size_global
    equal([step["t"] for step in steps], TIMES)
    for step in steps:
        x = step["points"].T
        centroids = step["centroids"].T
        t = step["t"]
        if kind == "vtx":
            agree(x.shape[1] >= 4 * n)
        else:
            agree(centroids.shape[1] == n)
        equal(step["displacement"], displacement(x, t).T, ROUNDING)
        at = x if kind == "vtx" else centroids
        equal(step["divergence"][:, 0], divergence(at, t), ROUNDING)
        equal(step["layer"][:, 0], layer(centroids), ROUNDING)


@pytest.mark.parametrize("kind", KINDS)
def test_mesh_that_moves(tmp_path, kind):
    """Each step has the points of the mesh at its time."""
    mesh = cube(3, 2)
    v = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("Lagrange", 1)), name="displacement")
    with FieldWriter(tmp_path / "wall", [v], kind=kind) as writer:
        for t in TIMES:
            writer.write(t)
            mesh.geometry.x[:] += 1.0
    for k, step in enumerate(read(writer.path)):
        moved = np.nanmin(step["points"], axis=0) - k
        small(float(np.abs(moved).max()), ROUNDING)  # beside the cube's edge of one


def test_the_kind_follows_from_dolfinx(u, tmp_path):
    """The format is VTX if dolfinx has ADIOS2, and XDMF otherwise."""
    suffix = ".bp" if dolfinx.has_adios2 else ".xdmf"
    with FieldWriter(tmp_path / "new/wall", [u]) as writer:
        writer.write(0.0)
    agree(writer.path == tmp_path / f"new/wall{suffix}" and writer.path.exists())


@pytest.mark.parametrize("kind", KINDS)
def test_a_later_run_replaces_the_file(u, tmp_path, kind):
    """A later run replaces the file."""
    for times in (TIMES, TIMES[1:]):
        path = write(tmp_path / "wall", u, times, kind)
    equal([step["t"] for step in read(path)], TIMES[1:])


@pytest.mark.parametrize("kind", KINDS)
def test_the_file_is_closed_after_an_error(u, tmp_path, kind):
    """After an error in the block of the writer, the written steps can be read."""
    with raises(ArithmeticError, "no equilibrium"):
        with FieldWriter(tmp_path / "wall", [u], kind=kind) as writer:
            writer.write(2.0)
            raise ArithmeticError("no equilibrium")
    equal([step["t"] for step in read(writer.path)], [2.0])


# -- what is refused


@pytest.mark.parametrize(
    "options, message",
    [
        ({"kind": "pvd"}, "kind='pvd': choose 'vtx' or 'xdmf'"),
        ({"kind": "VTX"}, "kind='VTX': choose 'vtx' or 'xdmf'"),
        ({"quadrature": "copy"}, "quadrature='copy': choose 'project' or 'points'"),
        ({"functions": []}, r"named \[\]: give at least one function"),
    ],
)
def test_refused_options(u, tmp_path, options, message):
    """Unknown options and empty lists are refused, and no file is created."""
    with raises(ValueError, message):
        FieldWriter(tmp_path / "wall", **{"functions": [u], **options})
    agree(not list(tmp_path.iterdir()))


def test_tags_and_a_time_that_is_no_number(u, tmp_path):
    """MeshTags as a function, and times that are not finite, are refused."""
    mesh = u.function_space.mesh
    none = np.zeros(0, dtype=np.int32)
    with raises(TypeError, r"functions\[1\] is .*MeshTags.*: give Sequence\[dolfinx.fem"):
        FieldWriter(tmp_path / "wall", [u, dolfinx.mesh.meshtags(mesh, 2, none, none)])
    with FieldWriter(tmp_path / "wall", [u]) as writer:
        for t in (np.nan, np.inf):
            with raises(ValueError, "t=.*: give a finite time"):
                writer.write(t)


@pytest.mark.parametrize(
    ("place", "kind", "match"),
    [
        ("run", "xdmf", r"folder .*run/new cannot be written \(Not a directory\): choose"),
        pytest.param("run", "vtx", r"run/new cannot .*Not a directory", marks=needs_adios2),
        pytest.param("run/wall.bp", "vtx", r"wall.bp cannot .*File exists", marks=needs_adios2),
        ("run/wall.xdmf/", "xdmf", r"file .*wall.xdmf cannot be written \(Is a directory\)"),
        ("run/wall.h5/", "xdmf", r"file .*wall.h5 cannot be written \(Is a directory\)"),
    ],
)
def test_where_something_else_is(u, tmp_path, place, kind, match):
    """A path that is taken by another file or folder is refused on all processes."""

    def put() -> None:
        (tmp_path / place).parent.mkdir(exist_ok=True)
        if place.endswith("/"):
            (tmp_path / place).mkdir()
        else:
            (tmp_path / place).write_text("mine")

    on_first(put)
    with raises(OSError, match):
        FieldWriter(tmp_path / "run" / ("new/wall" if place == "run" else "wall"), [u], kind=kind)
    if not place.endswith("/"):
        agree((tmp_path / place).read_text() == "mine")


def test_a_full_disk_reaches_all(tmp_path, monkeypatch):
    """A full disk on the first process is an error on all."""

    def full(**_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    if COMM.rank == 0:
        monkeypatch.setattr(tempfile, "TemporaryFile", full)
    with raises(OSError, r"cannot be written \(No space left on device\)"):
        writable_folder(tmp_path, COMM)


# -- cell_values


@pytest.mark.parametrize("dim", [2, 3])
def test_cell_values_are_those_at_the_centroids(dim):
    """Cell values are those at the centroids."""
    mesh = cube(dim, 3)
    n = mesh.topology.index_map(dim).size_local
    centroids = dolfinx.mesh.compute_midpoints(mesh, dim, np.arange(n, dtype=np.int32))[:, :dim]
    x = ufl.SpatialCoordinate(mesh)
    equal(cell_values(x, mesh), centroids, ROUNDING)
    equal(cell_values(x[0] * x[1], mesh), centroids[:, 0] * centroids[:, 1], ROUNDING)


def test_cell_values_where_a_process_has_no_cell():
    """A process without cells has no cell values, of the right shape."""
    corners = np.vstack([np.zeros(3), np.eye(3)])
    mesh = create_mesh(COMM, corners, np.arange(4)[None])
    values = cell_values(ufl.SpatialCoordinate(mesh), mesh)
    agree(values.shape == (mesh.topology.index_map(3).size_local, 3))
    equal(whole(values), np.full((1, 3), 0.25), ROUNDING)
