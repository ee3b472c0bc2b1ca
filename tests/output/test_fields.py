# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Output for ParaView: read back by other libraries than dolfinx, and refused before the work."""

from __future__ import annotations

import errno
import os
import tempfile
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt
import pytest
from collective import COMM, agree, equal, raises, whole
from problems import cube, with_bubbles
from wall_files import on_first
from walls import create_mesh

import basix.ufl
import dolfinx
import ufl

from dolfinx_feti.output import (
    FieldWriter,
    cell_values,
    create_patches,
    recovered_field,
    writable_folder,
)
from dolfinx_feti.runtime.compat import interpolation_points

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
    adios2 = pytest.importorskip("adios2")
    fields = {"displacement", "divergence", "layer"}

    def steps_on_first() -> list[dict[str, Array]]:
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

    return on_first(steps_on_first)


def read_xdmf(path: Path) -> list[dict[str, Array]]:
    """Read all steps with an XML parser and h5py: vertices, centroids of the cells, values."""
    h5py = pytest.importorskip("h5py")

    def steps_on_first() -> list[dict[str, Array]]:
        found: dict[float, dict[str, Array]] = {}
        with h5py.File(path.with_suffix(".h5")) as file:
            x, cells = (file[f"Mesh/mesh/{name}"][:] for name in ("geometry", "topology"))
            for grid in ElementTree.parse(path).iterfind(".//Grid[Attribute]"):
                t, field = float(grid.find("Time").get("Value")), grid.find("Attribute")
                mesh = {"t": t, "points": x, "centroids": x[cells].mean(axis=1)}
                values = file[field.find("DataItem").text.split(":")[1]][:]
                found.setdefault(t, mesh)[field.get("Name")] = values
        return [found[t] for t in sorted(found)]

    return on_first(steps_on_first)


def read(path: Path) -> list[dict[str, Array]]:
    return read_vtx(path) if path.suffix == ".bp" else read_xdmf(path)


# -- what is written


@needs_adios2
def test_vtx(u, tmp_path):
    """Each cell has its own points, and all fields stand on them."""
    path = write(tmp_path / "wall", u, TIMES, "vtx")
    agree(path == tmp_path / "wall.bp")
    steps = read_vtx(path)
    equal([step["t"] for step in steps], TIMES)
    for step in steps:
        x, t = step["points"].T, step["t"]
        agree(x.shape[1] >= 4 * u.function_space.mesh.topology.index_map(3).size_global)
        equal(step["displacement"], displacement(x, t).T, ROUNDING)
        equal(step["divergence"][:, 0], divergence(x, t), ROUNDING)
        equal(step["layer"][:, 0], layer(step["centroids"].T), ROUNDING)


def test_xdmf(u, tmp_path):
    """Continuous fields stand at the vertices, the others in the cells."""
    path = write(tmp_path / "wall", u, TIMES, "xdmf")
    agree(path == tmp_path / "wall.xdmf")
    steps = read_xdmf(path)
    equal([step["t"] for step in steps], TIMES)
    for step in steps:
        x, centroids, t = step["points"].T, step["centroids"].T, step["t"]
        agree(centroids.shape[1] == u.function_space.mesh.topology.index_map(3).size_global)
        equal(step["displacement"], displacement(x, t).T, ROUNDING)
        equal(step["divergence"][:, 0], divergence(centroids, t), ROUNDING)
        equal(step["layer"][:, 0], layer(centroids))


def test_the_kind_follows_from_dolfinx(u, tmp_path):
    suffix = ".bp" if dolfinx.has_adios2 else ".xdmf"
    with FieldWriter(tmp_path / "new/wall", [u]) as writer:
        writer.write(0.0)
    agree(writer.path == tmp_path / f"new/wall{suffix}" and writer.path.exists())


@pytest.mark.parametrize("kind", KINDS)
def test_a_later_run_replaces_the_file(u, tmp_path, kind):
    for times in (TIMES, TIMES[1:]):
        path = write(tmp_path / "wall", u, times, kind)
    equal([step["t"] for step in read(path)], TIMES[1:])


@pytest.mark.parametrize("kind", KINDS)
def test_the_file_is_closed_after_an_error(u, tmp_path, kind):
    """What was written before can be read."""
    with raises(ArithmeticError, "no equilibrium"):
        with FieldWriter(tmp_path / "wall", [u], kind=kind) as writer:
            writer.write(2.0)
            raise ArithmeticError("no equilibrium")
    equal([step["t"] for step in read(writer.path)], [2.0])


# -- data at quadrature points


def at_points(mesh: dolfinx.mesh.Mesh, degree: int, name: str = "S") -> dolfinx.fem.Function:
    """Return 1 + x₀ − 2 x₁ at quadrature points."""
    cell = mesh.topology.cell_name()
    element = basix.ufl.quadrature_element(cell, value_shape=(), degree=degree)
    S = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, element), name=name)
    x = ufl.SpatialCoordinate(mesh)
    at = interpolation_points(S.function_space)
    S.interpolate(dolfinx.fem.Expression(1 + x[0] - 2 * x[1], at))
    return S


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
@pytest.mark.parametrize("cell", ["triangle", "quadrilateral", "tetrahedron", "hexahedron"])
@pytest.mark.parametrize("kind", KINDS)
def test_data_at_quadrature_points_are_projected(tmp_path, kind, cell, degree):
    """A linear field is projected to itself; by one point, or to a constant, to its mean."""
    shape = getattr(dolfinx.mesh.CellType, cell)
    mesh = cube(2 if cell in ("triangle", "quadrilateral") else 3, 2, shape)
    S, x = at_points(mesh, degree), ufl.SpatialCoordinate(mesh)
    with FieldWriter(tmp_path / "o", [S], {"twice": 2 * S * (1 + x[0]) / (1 + x[0])}, kind=kind) as writer:
        S.x.array[:] *= 3.0  # after the writer was made
        writer.write(0.0)
        exact = dolfinx.fem.Function(writer._copies[0].function_space)
        exact.interpolate(lambda x: 3 * (1 + x[0] - 2 * x[1]))
        mean = np.mean(exact.x.array[exact.function_space.dofmap.list], axis=1, keepdims=True)
        for copy, factor in zip(writer._copies, (1, 2), strict=True):
            dofs = copy.function_space.dofmap.list
            wanted = exact.x.array[dofs] if degree > 1 else np.broadcast_to(mean, dofs.shape)
            equal(copy.x.array[dofs], factor * wanted, 100 * ROUNDING)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("kind", KINDS)
def test_data_at_quadrature_points_are_written_there(u, tmp_path, kind, dim):
    """Read back: points and values, step after step, beside the fields of the cells."""
    mesh = cube(dim, 2)
    S = at_points(mesh, 3)
    v = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("Lagrange", 1)), name="v")
    fields = {"S e": S * ufl.as_vector([1, 2, 3])}
    with FieldWriter(tmp_path / "o", [v, S], fields, kind=kind, quadrature="points") as writer:
        for t in TIMES:
            writer.write(t)
            S.x.array[:] *= 2.0
    agree(writer.points == tmp_path / "o_points.xdmf" and writer.path.exists())
    grids = ElementTree.parse(writer.points).findall(".//Grid[Attribute]")
    equal([float(grid.find("Time").get("Value")) for grid in grids], TIMES)
    for k, grid in enumerate(grids):
        x, s, se = (heavy(tmp_path, item) for item in grid.iter("DataItem"))
        agree(len(x) == S.function_space.dofmap.index_map.size_global)
        equal(s[:, 0], 2**k * (1 + x[:, 0] - 2 * x[:, 1]), 2**k * ROUNDING)
        equal(se, s * [1, 2, 3], 2**k * ROUNDING)
        agree(not k or dim == 3 or len(np.unique(x.round(9), axis=0)) == len(x))


def heavy(folder: Path, item: ElementTree.Element) -> Array:
    """Return the numbers of a DataItem."""
    shape = [int(n) for n in item.get("Dimensions").split()]
    start = int(item.get("Seek"))
    return np.fromfile(folder / item.text, "<f8", np.prod(shape), offset=start).reshape(shape)


def test_data_at_vertices_and_on_facets(tmp_path):
    """A submesh of facets is shown as a mesh, one of vertices as points."""
    mesh = cube(3, 2)
    for dim, name in ((0, "points"), (2, "facets")):
        mesh.topology.create_entities(dim)
        mesh.topology.create_connectivity(dim, 3)
        mine = np.arange(mesh.topology.index_map(dim).size_local, dtype=np.int32)
        part = dolfinx.mesh.create_submesh(mesh, dim, mine)[0]
        f = dolfinx.fem.Function(dolfinx.fem.functionspace(part, ("DG", min(dim, 1))), name="f")
        f.interpolate(lambda x: x[0] - x[2])
        with FieldWriter(tmp_path / name, [f]) as writer:
            writer.write(0.0)
        agree(writer.path.exists())
    grid = ElementTree.parse(tmp_path / "points_points.xdmf").find(".//Grid[Attribute]")
    x, values = (heavy(tmp_path, item) for item in grid.iter("DataItem"))
    agree(len(x) == 27)
    equal(values[:, 0], x[:, 0] - x[:, 2], ROUNDING)


def test_cell_values_of_data_at_quadrature_points_are_means():
    mesh = cube(3, 2)
    centroids = cell_values(ufl.SpatialCoordinate(mesh), mesh)
    equal(
        cell_values(2 * at_points(mesh, 2), mesh),
        2 * (1 + centroids[:, 0] - 2 * centroids[:, 1]),
        ROUNDING,
    )


def test_no_copies_of_data_at_other_points():
    """Four quadrature points are not the four vertices, for a recovered field, either."""
    mesh = cube(3, 2)
    patches = create_patches(mesh, degree=4)
    other = at_points(mesh, 5)
    with raises(ValueError, "data at .* quadrature points, but is evaluated at .* others"):
        recovered_field(2 * other, patches)
    same = recovered_field(2 * at_points(mesh, 4), patches)
    exact = dolfinx.fem.Function(same.function_space)
    exact.interpolate(lambda x: 2 * (1 + x[0] - 2 * x[1]))
    equal(same.x.array, exact.x.array, 100 * ROUNDING)


# -- elements and cells

ELEMENTS = {
    "P1": ("Lagrange", 1, ()),
    "P2 vector": ("Lagrange", 2, (3,)),
    "P2 tensor": ("Lagrange", 2, (3, 3)),
    "symmetric": ("Lagrange", 2, (3, 3), True),
    "six": ("Lagrange", 1, (6,)),
    "DG0": ("DG", 0, ()),
    "DG2 tensor": ("DG", 2, (3, 3)),
    "N1curl": ("N1curl", 1),
    "RT": ("RT", 1),
    "CR": ("CR", 1),
}


def element_of(name: str) -> object:
    if name == "bubble":
        return with_bubbles(cube(3, 1))
    family, degree, *shape = ELEMENTS[name]
    if len(shape) == 2:
        return basix.ufl.element(family, "tetrahedron", degree, shape=shape[0], symmetry=shape[1])
    return (family, degree, *shape)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("kind", KINDS)
def test_every_element_on_straight_and_curved_cells(tmp_path, kind, order):
    """Constant fields are written as such, by one writer."""
    mesh = curved(3, 1, order)
    functions = []
    for name in (*ELEMENTS, "bubble"):
        f = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, element_of(name)), name=name)
        f.x.array[:] = 2.0
        if name in ("N1curl", "RT", "bubble"):  # degrees of freedom that are no values
            size = int(np.prod(f.ufl_shape))
            f.interpolate(lambda x, size=size: np.full((size, x.shape[1]), 2.0))
        functions.append(f)
    with FieldWriter(tmp_path / "o", functions, {"two": ufl.as_ufl(2.0)}, kind=kind) as writer:
        writer.write(0.0)
        for copy in writer._copies:
            equal(copy.x.array, np.full_like(copy.x.array, 2.0), 100 * ROUNDING)
    agree(writer.path.exists())


def curved(dim: int, n: int, order: int) -> dolfinx.mesh.Mesh:
    """Return the unit cube with a geometry of some order."""
    straight = cube(dim, n)
    V = dolfinx.fem.functionspace(straight, ("Lagrange", order, (dim,)))
    x = V.tabulate_dof_coordinates()[: V.dofmap.index_map.size_local, :dim]
    cells = V.dofmap.list[: straight.topology.index_map(dim).size_local]
    nodes = V.dofmap.index_map.local_to_global(cells.ravel()).reshape(cells.shape)
    element = basix.ufl.element("Lagrange", straight.topology.cell_name(), order, shape=(dim,))
    return dolfinx.mesh.create_mesh(straight.comm, nodes.astype(np.int64), x=x, e=element)


# -- what is refused


def refused_field(mesh: dolfinx.mesh.Mesh, name: str) -> tuple[list, dict]:
    """Return functions and expressions of which one cannot be written."""
    first = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("Lagrange", 1)), name="first")
    x = ufl.SpatialCoordinate(mesh)
    match name:
        case "mixed":
            parts = [basix.ufl.element("Lagrange", "tetrahedron", k) for k in (2, 1)]
            mixed = dolfinx.fem.functionspace(mesh, basix.ufl.mixed_element(parts))
            return [first, dolfinx.fem.Function(mixed, name="mixed")], {}
        case "another mesh":
            return [first], {"e": ufl.SpatialCoordinate(cube(3, 1))[0]}
        case "facets":
            return [first], {"e": x[0] * ufl.FacetNormal(mesh)}
        case "argument":
            return [first], {"e": ufl.TestFunction(first.function_space)}
        case "two rules":
            return [first], {"e": at_points(mesh, 2) * at_points(mesh, 3)}
        case "derivative":
            return [first], {"e": ufl.grad(at_points(mesh, 2))}
    return [first, first], {}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "name, message",
    [
        ("mixed", r"'mixed' cannot be written: its space is mixed; write its parts, f.sub\(0\)"),
        ("another mesh", "'e' cannot be written: it lives on another mesh than the first"),
        ("facets", "'e' cannot be written: The expression holds .*, which lives on facets"),
        ("argument", "'e' cannot be written: it holds a test or trial function"),
        ("two rules", r"'e' cannot be written: The expression combines data at \d+ and at \d+ other"),
        ("derivative", "'e' cannot be written: "),
        ("twice", r"named \['first', 'first'\]: give at least one function, and distinct"),
    ],
)
def test_refused_when_the_writer_is_made(tmp_path, kind, name, message):
    with raises(ValueError, message):
        FieldWriter(tmp_path / "wall", *refused_field(cube(3, 1), name), kind=kind)
    agree(not list(tmp_path.iterdir()))


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
    with raises(ValueError, message):
        FieldWriter(tmp_path / "wall", **{"functions": [u], **options})
    agree(not list(tmp_path.iterdir()))


@pytest.mark.parametrize("kind", KINDS)
def test_place_below_a_file(u, tmp_path, kind):
    on_first(lambda: (tmp_path / "notes").write_text("mine"))
    with raises(
        OSError, r"folder .*notes/run cannot be written \(Not a directory\): choose another"
    ):
        FieldWriter(tmp_path / "notes/run/wall", [u], kind=kind)
    agree((tmp_path / "notes").read_text() == "mine")


@needs_adios2
def test_vtx_where_a_file_is(u, tmp_path):
    """ADIOS2 itself would raise on one process, and leave the others waiting."""
    on_first(lambda: (tmp_path / "wall.bp").write_text("mine"))
    with raises(OSError, r"wall.bp cannot be written \(File exists\)"):
        FieldWriter(tmp_path / "wall", [u], kind="vtx")
    agree((tmp_path / "wall.bp").read_text() == "mine")


@pytest.mark.parametrize("suffix", [".xdmf", ".h5"])
def test_xdmf_where_a_folder_is(u, tmp_path, suffix):
    """The library itself would write nothing without a word, or end all processes."""
    on_first((tmp_path / f"wall{suffix}").mkdir)
    with raises(OSError, rf"file .*wall{suffix} cannot be written \(Is a directory\)"):
        FieldWriter(tmp_path / "wall", [u], kind="xdmf")


# -- writable_folder


def test_a_folder_is_made_with_those_above_it(tmp_path):
    wanted = tmp_path / "a/b"
    for path in (wanted, str(wanted)):  # twice: it may be there
        agree(writable_folder(path, COMM) == wanted)
    agree(wanted.is_dir() and not list(wanted.iterdir()))


@pytest.mark.parametrize("path", ["notes", "notes/below"])
def test_no_folder_in_place_of_a_file(tmp_path, path):
    on_first(lambda: (tmp_path / "notes").write_text("mine"))
    with raises(OSError, rf"folder .*{path} cannot be written \(.*\): choose another one"):
        writable_folder(tmp_path / path, COMM)
    agree((tmp_path / "notes").read_text() == "mine")


def test_a_full_disk_reaches_all(tmp_path, monkeypatch):
    """Only the first process meets it."""

    def full(**_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    if COMM.rank == 0:
        monkeypatch.setattr(tempfile, "TemporaryFile", full)
    with raises(OSError, r"cannot be written \(No space left on device\)"):
        writable_folder(tmp_path, COMM)


# -- cell_values


@pytest.mark.parametrize("dim", [2, 3])
def test_cell_values_are_those_at_the_centroids(dim):
    mesh = cube(dim, 3)
    n = mesh.topology.index_map(dim).size_local
    centroids = dolfinx.mesh.compute_midpoints(mesh, dim, np.arange(n, dtype=np.int32))[:, :dim]
    x = ufl.SpatialCoordinate(mesh)
    equal(cell_values(x, mesh), centroids, ROUNDING)
    equal(cell_values(x[0] * x[1], mesh), centroids[:, 0] * centroids[:, 1], ROUNDING)


def test_cell_values_where_a_process_has_no_cell():
    corners = np.vstack([np.zeros(3), np.eye(3)])
    mesh = create_mesh(COMM, corners, np.arange(4)[None])
    values = cell_values(ufl.SpatialCoordinate(mesh), mesh)
    agree(values.shape == (mesh.topology.index_map(3).size_local, 3))
    equal(whole(values), np.full((1, 3), 0.25), ROUNDING)
