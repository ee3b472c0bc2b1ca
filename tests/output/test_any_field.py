# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Fields of every element, at quadrature points, on facets and at vertices, for ParaView."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt
import pytest
from collective import agree, equal, raises
from problems import cube, with_bubbles

import basix.ufl
import dolfinx
import ufl

from dolfinx_feti.meshes.curved import create_curved_mesh
from dolfinx_feti.output import FieldWriter, cell_values, create_patches, recovered_field
from dolfinx_feti.runtime.compat import interpolation_points

Array = npt.NDArray[np.float64]

TIMES = (0.0, 1.5, 4.0)
ROUNDING = 100 * np.finfo(float).eps

needs_adios2 = pytest.mark.skipif(not dolfinx.has_adios2, reason="dolfinx has no ADIOS2")
KINDS = [pytest.param("vtx", marks=needs_adios2), "xdmf"]


# -- data at quadrature points


def written_functions(writer: FieldWriter) -> list[dolfinx.fem.Function]:
    """Return the functions in the file, with the values of the last step."""
    return [copy.function for copy in writer._outputs[0].copies]


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
    """Data at quadrature points are projected: a linear field to itself, or to its mean."""
    shape = getattr(dolfinx.mesh.CellType, cell)
    mesh = cube(2 if cell in ("triangle", "quadrilateral") else 3, 2, shape)
    S = at_points(mesh, degree)
    x = ufl.SpatialCoordinate(mesh)
    with FieldWriter(
        tmp_path / "o", [S], {"twice": 2 * S * (1 + x[0]) / (1 + x[0])}, kind=kind
    ) as writer:
        S.x.array[:] *= 3.0  # after the writer was made
        writer.write(0.0)
        exact = dolfinx.fem.Function(written_functions(writer)[0].function_space)
        exact.interpolate(lambda x: 3 * (1 + x[0] - 2 * x[1]))
        mean = np.mean(exact.x.array[exact.function_space.dofmap.list], axis=1, keepdims=True)
        for copy, factor in zip(written_functions(writer), (1, 2), strict=True):
            dofs = copy.function_space.dofmap.list
            wanted = exact.x.array[dofs] if degree > 1 else np.broadcast_to(mean, dofs.shape)
            equal(copy.x.array[dofs], factor * wanted, 100 * ROUNDING)


@pytest.mark.parametrize("kind", KINDS)
def test_value_that_is_no_number_spoils_its_node_only(tmp_path, kind):
    """An infinite value changes only its own node: 1/x is interpolated except where x = 0."""
    mesh = cube(3, 2)
    v = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("Lagrange", 1)), name="v")
    x = ufl.SpatialCoordinate(mesh)
    with FieldWriter(tmp_path / "o", [v], {"e": 1 / x[0]}, kind=kind) as writer:
        copy = written_functions(writer)[-1]
        V = copy.function_space
        owned = np.arange(V.dofmap.index_map.size_local)
        at = V.tabulate_dof_coordinates()[owned, 0]
        with np.errstate(divide="ignore"):
            equal(copy.x.array[owned][at > 0.1], 1 / at[at > 0.1], 100 * ROUNDING)
            agree(np.isinf(copy.x.array[owned][at < 0.1]).all())


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("kind", KINDS)
def test_data_at_quadrature_points_are_written_there(tmp_path, kind, dim):
    """Points and values at quadrature points can be read back, in each step."""
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
        if k > 0 and dim == 2:
            agree(len(np.unique(x.round(9), axis=0)) == len(x))


def heavy(folder: Path, item: ElementTree.Element) -> Array:
    """Return the numbers of a DataItem."""
    shape = [int(n) for n in item.get("Dimensions").split()]
    start = int(item.get("Seek"))
    return np.fromfile(folder / item.text, "<f8", np.prod(shape), offset=start).reshape(shape)


def test_data_at_vertices_and_on_facets(tmp_path):
    """A submesh of facets is written as a mesh, and one of vertices as points."""
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
    """Cell values of data at quadrature points are their means."""
    mesh = cube(3, 2)
    centroids = cell_values(ufl.SpatialCoordinate(mesh), mesh)
    equal(
        cell_values(2 * at_points(mesh, 2), mesh),
        2 * (1 + centroids[:, 0] - 2 * centroids[:, 1]),
        ROUNDING,
    )


def test_no_copies_of_data_at_other_points():
    """Data at quadrature points are recovered from their own points, and from no others."""
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


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("kind", KINDS)
def test_every_element_on_straight_and_curved_cells(tmp_path, kind, order):
    """Constant fields of every element are written as such, by one writer."""
    mesh = cube(3, 1) if order == 1 else create_curved_mesh(cube(3, 1), lambda x: x)
    functions = []
    for name, element in (ELEMENTS | {"bubble": with_bubbles(mesh)}).items():
        f = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, element), name=name)
        f.x.array[:] = 2.0
        if name in ("N1curl", "RT", "bubble"):  # degrees of freedom that are no values
            size = int(np.prod(f.ufl_shape))
            f.interpolate(lambda x, size=size: np.full((size, x.shape[1]), 2.0))
        functions.append(f)
    with FieldWriter(tmp_path / "o", functions, {"two": ufl.as_ufl(2.0)}, kind=kind) as writer:
        writer.write(0.0)
        for copy in written_functions(writer):
            equal(copy.x.array, np.full_like(copy.x.array, 2.0), 100 * ROUNDING)
    agree(writer.path.exists())


# -- what is refused


def mixed(mesh: dolfinx.mesh.Mesh) -> dolfinx.fem.Function:
    parts = [basix.ufl.element("Lagrange", "tetrahedron", k) for k in (2, 1)]
    return dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, basix.ufl.mixed_element(parts)))


def argument(mesh: dolfinx.mesh.Mesh) -> ufl.Argument:
    return ufl.TestFunction(dolfinx.fem.functionspace(mesh, ("Lagrange", 1)))


X = ufl.SpatialCoordinate
REFUSED = {
    r"its space is mixed; write its parts, f.sub\(0\)": mixed,
    "it lives on another mesh than the first": lambda mesh: X(cube(3, 1))[0],
    "The expression contains .*, which is defined on": lambda m: X(m)[0] * ufl.FacetNormal(m),
    "it holds a test or trial function": argument,
    r"The expression combines data at \d+ and at \d+ other": lambda mesh: (
        at_points(mesh, 2) * at_points(mesh, 3)
    ),
    "": lambda mesh: ufl.grad(at_points(mesh, 2)),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("message", REFUSED)
def test_refused_when_the_writer_is_made(tmp_path, kind, message):
    """Fields that cannot be written are refused when the writer is created."""
    mesh = cube(3, 1)
    first = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("Lagrange", 1)), name="first")
    with raises(ValueError, f"'e' cannot be written: {message}"):
        FieldWriter(tmp_path / "wall", [first], {"e": REFUSED[message](mesh)}, kind=kind)
    with raises(
        ValueError, r"named \['first', 'first'\]: give at least one function, and distinct"
    ):
        FieldWriter(tmp_path / "wall", [first, first], kind=kind)
    agree(not list(tmp_path.iterdir()))
