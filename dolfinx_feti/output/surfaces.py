# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Triangles of the surface of a body, with values of fields at their corners, for pictures.

Each facet is divided at the nodes of a quadratic element: a triangle into 4, a quadrilateral into 8
triangles. Positions and fields are evaluated there in the cell of the facet, without interpolation.
Where facets meet, a field has the mean of their values. In two dimensions the cells take the place
of the facets.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

import basix
import dolfinx
import ufl
from ufl.core.expr import Expr

from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.runtime.arrays import Array, Integers, Mask, Numbers
from dolfinx_feti.runtime.collective import bounding_box, on_all

__all__ = ["Surface", "gather_surface"]

#: Distance of points that count as one, over the extent of the body. Rounding errors are 1e-16 of
#: it, the edges of ten million cells 5e-3.
SAME_POINT = 1e-8

#: Shift of the cells of size SAME_POINT in which points are sorted: coordinates such as 2⁻⁹ must
#: not be on their boundary. Any number that is no short binary or decimal fraction would do.
SHIFT = 0.381966

#: Pairs of corners whose mean is a node of a triangle: its corners, and the middles of its edges.
TRIANGLE_NODES = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))

#: The four triangles of a triangle with these nodes.
TRIANGLES = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])

#: The eight triangles of a quadrilateral with 3 × 3 nodes, row by row.
QUADRILATERALS = np.array(
    [triangle for i in (0, 1, 3, 4) for triangle in ([i, i + 1, i + 4], [i, i + 4, i + 3])]
)


@dataclass(frozen=True, slots=True)
class Surface:
    """Triangles of a surface.

    Attributes:
        points: Corners of the triangles in the deformed body, (n, 3).
        triangles: Points of each triangle, outside on the left-hand turn, (t, 3).
        values: Values of the field at the points, (n,), or (n, 3) of vectors.
        part: Number of the part of the body that each triangle bounds, (t,).
        is_plane: Whether the body is a domain of the plane.
    """

    points: Array
    triangles: Numbers
    values: Array
    part: Numbers
    is_plane: bool


def gather_surface(
    mesh: dolfinx.mesh.Mesh,
    values: Expr | None,
    displacement: Expr | None,
    *,
    part: Integers | None = None,
    mask: Mask | None = None,
    is_continuous: bool = True,
) -> Surface | None:
    """Return the surface of a body, or of each of its parts. Collective.

    Args:
        mesh: The body: triangles, quadrilaterals, tetrahedra or hexahedra.
        values: A scalar or vector on it; None for zeros.
        displacement: Displacement of the points; None for zero.
        part: Number of the part of each owned cell, (n_cells,), whose cells are on one process.
            Each part has its own surface.
        mask: Owned cells of the body; all if None.
        is_continuous: Whether faces that meet share their points, with the mean of their values.

    Returns:
        The surface on the first process; None on all others.
    """
    comm = mesh.comm
    cells, faces = on_all(lambda: _boundary(mesh, part, mask), comm)
    nodes, triangles = _reference_triangles(mesh)
    X = ufl.SpatialCoordinate(mesh)
    x = X if displacement is None else X + displacement
    expressions = [X, x] if values is None else [X, x, values]
    sampled = [_evaluate(expression, mesh, cells, nodes) for expression in expressions]
    is_plane = mesh.geometry.dim == 2
    here = triangles[faces]  # nodes of the triangles of each face, (n_faces, t, 3)
    which = np.arange(len(cells))[:, None, None]
    corners = [samples[which, here] for samples in sampled]  # (n_faces, t, 3, size)
    part_of_face: Numbers = np.zeros(len(cells), dtype=np.int64)
    if part is not None:
        part_of_face = part[cells].astype(np.int64)
    part_of_triangle = np.repeat(part_of_face, here.shape[1])
    if not is_plane:
        inside = sampled[1].mean(axis=1)[:, None, :]  # a point in each cell
        turned = _is_turned(corners[1], inside)
        for array in corners:
            array[turned] = array[turned][:, ::-1]
    flat = [array.reshape(-1, array.shape[-1]) for array in corners]
    gathered = comm.gather((part_of_triangle, *flat))
    low, high = bounding_box(mesh.geometry.x, comm)
    if gathered is None:
        return None
    of_all, *flat = (np.concatenate(arrays) for arrays in zip(*gathered, strict=True))
    if not is_continuous:
        triangles_of_face = here.shape[1]
        face_of_triangle = np.arange(len(of_all)) // triangles_of_face
        surface = _merged(face_of_triangle, flat, SAME_POINT * float((high - low).max()), is_plane)
        return replace(surface, part=of_all)
    return _merged(of_all, flat, SAME_POINT * float((high - low).max()), is_plane)


def _boundary(
    mesh: dolfinx.mesh.Mesh, part: Integers | None, mask: Mask | None
) -> tuple[Numbers, Numbers]:
    """Return cell and local face of the boundary of the body, or of each part, (n,) each.

    A face that bounds a cell of the body on one side alone is on the boundary. In two dimensions
    the face of a cell is the cell itself.
    """
    topology = mesh.topology
    tdim = topology.dim
    n_cells = topology.index_map(tdim).size_local
    cells: Numbers = np.arange(n_cells, dtype=np.int64)
    if mask is not None:
        cells = cells[mask]
    if tdim == 2:
        return cells, np.zeros(len(cells), dtype=np.int64)
    topology.create_entities(tdim - 1)
    topology.create_connectivity(tdim, tdim - 1)
    facets = topology.connectivity(tdim, tdim - 1).array.astype(np.int64)
    n_facets = dolfinx.cpp.mesh.cell_num_entities(topology.cell_type, tdim - 1)
    facets = facets.reshape(-1, n_facets)[cells]
    if part is None:
        count = dolfinx.la.vector(topology.index_map(tdim - 1))
        np.add.at(count.array, facets.ravel(), 1.0)
        count.scatter_reverse(dolfinx.la.InsertMode.add)
        count.scatter_forward()
        is_boundary = count.array[facets] < 1.5
    else:
        of_part = np.column_stack([np.repeat(part[cells], n_facets), facets.ravel()])
        _, inverse, counts = np.unique(of_part, axis=0, return_inverse=True, return_counts=True)
        is_boundary = counts[inverse.ravel()].reshape(facets.shape) == 1
    row, face = np.nonzero(is_boundary)
    return cells[row], face


def _reference_triangles(mesh: dolfinx.mesh.Mesh) -> tuple[Array, Numbers]:
    """Return the nodes of a quadratic element, (nodes, tdim), and the triangles of its faces.

    The second result holds the nodes of the triangles of each face, (faces, t, 3).
    """
    cell = getattr(basix.CellType, mesh.topology.cell_name())
    element = basix.create_element(basix.ElementFamily.P, cell, 2)
    nodes = np.asarray(element.points, dtype=np.float64)
    vertices = np.asarray(basix.geometry(cell), dtype=np.float64)
    triangles = []
    for face in basix.topology(cell)[2]:
        corners = vertices[face]
        if len(face) == 3:
            places = [corners[[i, j]].mean(axis=0) for i, j in TRIANGLE_NODES]
            of_face = TRIANGLES
        else:
            edges = corners[1] - corners[0], corners[2] - corners[0]
            places = [
                corners[0] + 0.5 * (i * edges[0] + j * edges[1]) for j in range(3) for i in range(3)
            ]
            of_face = QUADRILATERALS
        distance = np.linalg.norm(nodes[None] - np.array(places)[:, None], axis=2)
        triangles.append(distance.argmin(axis=1)[of_face])
    return nodes, np.array(triangles, dtype=np.int64)


def _evaluate(expression: Expr, mesh: dolfinx.mesh.Mesh, cells: Integers, nodes: Array) -> Array:
    """Return an expression at reference points of cells, (n, nodes, size), with size 3 of vectors.

    Vectors in the plane get a third component of zero. Collective.
    """
    size = int(np.prod(expression.ufl_shape, dtype=np.int64))
    compiled = Compiler(mesh.comm).expression(expression, nodes)
    values: Array = np.zeros((len(cells), len(nodes), size))
    if len(cells):
        unique, inverse = np.unique(cells, return_inverse=True)
        of_cells = np.asarray(compiled.eval(mesh, unique.astype(np.int32)))
        values = of_cells.reshape(len(unique), len(nodes), size)[inverse.ravel()]
    if size == 2:
        values = np.concatenate([values, np.zeros((*values.shape[:2], 1))], axis=2)
    return values


def _is_turned(x: Array, inside: Array) -> Mask:
    """Return the triangles, (n, t), whose normal points to a point of their cell.

    Args:
        x: Corners of the triangles, (n, t, 3, 3).
        inside: A point in the cell of each triangle, (n, 1, 3).
    """
    normal = np.cross(x[:, :, 1] - x[:, :, 0], x[:, :, 2] - x[:, :, 0])
    outward = x.mean(axis=2) - inside
    return np.asarray(np.einsum("nti,nti->nt", normal, outward) < 0.0)


def _merged(numbers: Numbers, corners: list[Array], tolerance: float, is_plane: bool) -> Surface:
    """Return the surface whose triangles share their points, inside of each part.

    Args:
        numbers: Part of each triangle, (t,).
        corners: Reference and deformed positions of the corners, (3 t, 3) each, and values,
            (3 t, size).
        tolerance: Distance of reference positions that are one point.
        is_plane: See :class:`Surface`.
    """
    X, x, *rest = corners
    keys = np.column_stack(
        [np.repeat(numbers, 3), np.floor(X / tolerance + SHIFT).astype(np.int64)]
    )
    _, inverse = np.unique(keys, axis=0, return_inverse=True)
    inverse = inverse.ravel()
    count = np.bincount(inverse)
    points = _means(x, inverse, count)
    values = _means(rest[0], inverse, count) if rest else np.zeros((len(count), 1))
    if values.shape[1] == 1:
        values = values[:, 0]
    return Surface(points, inverse.reshape(-1, 3), values, numbers, is_plane)


def _means(values: Array, which: Integers, count: Integers) -> Array:
    """Return the mean of the rows of each point, (points, size)."""
    sums = [np.bincount(which, column) for column in values.T]
    return np.asarray(np.stack(sums, axis=1) / count[:, None])
