# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Triangles of the surface of a body, with values of fields at their corners, for pictures.

Each facet is divided at the nodes of a quadratic element: a triangle into 4 triangles, a
quadrilateral into 8. Positions and fields are evaluated at these nodes, in the cell of the facet,
without interpolation. At a node that several facets share, a field has the mean of their values. In
two dimensions the cells take the place of the facets.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

import basix
import dolfinx
import ufl
from ufl.core.expr import Expr

from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.runtime.arrays import Array, Integers, Mask, Numbers
from dolfinx_feti.runtime.collective import bounding_box, on_all

__all__ = ["BodySurface", "gather_surface"]

#: Distance up to which points count as one, over the extent of the body. Rounding errors are 1e-16
#: of it, edges of cells 5e-3 in a mesh of ten million cells.
SAME_POINT_RTOL = 1e-8

#: Shift of coordinates, in units of the tolerance, before they are rounded down. Coordinates such
#: as 2⁻⁹ are multiples or halves of the tolerance: without a shift, or with one of 0.5, rounding
#: errors would separate equal points. Any number that is no short binary or decimal fraction would
#: do.
ROUNDING_SHIFT = 0.381966

#: Pairs of corners whose mean is a node of a triangle: its corners, and the middles of its edges.
TRIANGLE_NODES = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))

#: The four triangles of a triangle with these nodes.
TRIANGLES = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])

#: The eight triangles of a quadrilateral with 3 × 3 nodes, row by row.
QUADRILATERALS = np.array(
    [triangle for i in (0, 1, 3, 4) for triangle in ([i, i + 1, i + 4], [i, i + 4, i + 3])]
)


@dataclass(frozen=True, slots=True)
class BodySurface:
    """Triangles of the surface of a body.

    Attributes:
        points: Corners of the triangles in the deformed body, (n, 3).
        triangles: Points of each triangle, counterclockwise as seen from outside, (t, 3).
        values: Values of the field at the points, (n,), or (n, 3) of vectors.
        part: Number of the part of the body that each triangle bounds, (t,).
        is_plane: Whether the body is a domain of the plane.
    """

    points: Array
    triangles: Numbers
    values: Array
    part: Numbers
    is_plane: bool


@dataclass(frozen=True, slots=True)
class _Triangles:
    """Triangles of a surface, before equal corners are merged.

    Attributes:
        X: Corners in the reference body, (t, 3, 3).
        x: Corners in the deformed body, (t, 3, 3).
        values: Values of the field at the corners, (t, 3, components).
        part: Number of the part of the body, (t,).
        face: Number of the face that the triangle is part of, (t,).
    """

    X: Array
    x: Array
    values: Array
    part: Numbers
    face: Numbers

    def turned(self, mask: Mask) -> _Triangles:
        """Return the triangles with reversed normals where the mask is set.

        Args:
            mask: Mask of the triangles whose corners are reversed, (t,).
        """
        is_turned = mask[:, None, None]
        return replace(
            self,
            X=np.where(is_turned, self.X[:, ::-1], self.X),
            x=np.where(is_turned, self.x[:, ::-1], self.x),
            values=np.where(is_turned, self.values[:, ::-1], self.values),
        )


def gather_surface(
    mesh: dolfinx.mesh.Mesh,
    values: Expr | None,
    displacement: Expr | None,
    *,
    part: Integers | None = None,
    mask: Mask | None = None,
    is_continuous: bool = True,
) -> BodySurface | None:
    """Return the surface of a body, or of each of its parts. Collective.

    Args:
        mesh: The body: triangles, quadrilaterals, tetrahedra or hexahedra.
        values: A scalar or vector on it; None for zeros.
        displacement: Displacement of the points; None for zero.
        part: Number of the part of each owned cell, (n_cells,). All cells of a part are on one
            process, and each part has its own surface. All cells are one part if None.
        mask: Owned cells of the body; all if None.
        is_continuous: Whether adjacent faces share points, with the mean of their values there.

    Returns:
        The surface on the first process; None on all others.
    """
    here = _triangles(mesh, values, displacement, part, mask)
    low, high = bounding_box(mesh.geometry.x, mesh.comm)
    gathered = mesh.comm.gather(here)
    if gathered is None:
        return None
    triangles = _join(gathered)
    group = triangles.part if is_continuous else triangles.face
    tolerance = SAME_POINT_RTOL * float((high - low).max())
    return _with_shared_points(triangles, group, tolerance, is_plane=mesh.geometry.dim == 2)


def _triangles(
    mesh: dolfinx.mesh.Mesh,
    values: Expr | None,
    displacement: Expr | None,
    part: Integers | None,
    mask: Mask | None,
) -> _Triangles:
    """Return the triangles of this process, for the arguments of gather_surface. Collective."""
    cells, faces = on_all(lambda: _boundary(mesh, part, mask), mesh.comm)
    nodes, triangles_of_faces = _reference_triangles(mesh)
    nodes_of_triangles = triangles_of_faces[faces]  # (n_faces, triangles of a face, 3)
    n_faces, per_face, _ = nodes_of_triangles.shape
    face = np.arange(n_faces)

    def at_corners(expression: Expr) -> Array:
        """Return an expression at all corners, (n_faces, triangles of a face, 3, size)."""
        at_nodes = _evaluate(expression, mesh, cells, nodes)
        return at_nodes[face[:, None, None], nodes_of_triangles]

    position = ufl.SpatialCoordinate(mesh)
    X = at_corners(position)
    x = X if displacement is None else at_corners(position + displacement)
    field: Array = np.zeros((*nodes_of_triangles.shape, 1))
    if values is not None:
        field = at_corners(values)
    part_of_face: Numbers = np.zeros(n_faces, dtype=np.int64)
    if part is not None:
        part_of_face = part[cells].astype(np.int64)
    triangles = _Triangles(
        X=X.reshape(-1, 3, 3),
        x=x.reshape(-1, 3, 3),
        values=field.reshape(-1, 3, field.shape[3]),
        part=np.repeat(part_of_face, per_face),
        face=np.repeat(face, per_face),
    )
    if mesh.geometry.dim == 2:
        return triangles
    moved = position if displacement is None else position + displacement
    inside = _evaluate(moved, mesh, cells, nodes).mean(axis=1)  # a point in each cell
    return triangles.turned(_has_inward_normal(triangles.x, np.repeat(inside, per_face, axis=0)))


def _join(gathered: Sequence[_Triangles]) -> _Triangles:
    """Join the triangles of all processes, and number their faces consecutively."""
    faces = []
    n_faces = 0
    for triangles in gathered:
        faces.append(n_faces + triangles.face)
        n_faces += int(triangles.face.max(initial=-1)) + 1
    return _Triangles(
        X=np.concatenate([triangles.X for triangles in gathered]),
        x=np.concatenate([triangles.x for triangles in gathered]),
        values=np.concatenate([triangles.values for triangles in gathered]),
        part=np.concatenate([triangles.part for triangles in gathered]),
        face=np.concatenate(faces),
    )


def _boundary(
    mesh: dolfinx.mesh.Mesh, part: Integers | None, mask: Mask | None
) -> tuple[Numbers, Numbers]:
    """Return cell and local face of the boundary of the body, or of each part, (n,) each.

    A face is on the boundary if it has a cell of the body, or of the part, on one side only. In two
    dimensions the face of a cell is the cell itself.
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
        cells_of_facet = dolfinx.la.vector(topology.index_map(tdim - 1))
        np.add.at(cells_of_facet.array, facets.ravel(), 1.0)
        cells_of_facet.scatter_reverse(dolfinx.la.InsertMode.add)
        cells_of_facet.scatter_forward()
        is_boundary = cells_of_facet.array[facets] < 1.5  # one cell, not two
    else:
        # without communication: all cells of a part are on this process
        of_part = np.column_stack([np.repeat(part[cells], n_facets), facets.ravel()])
        _, inverse, counts = np.unique(of_part, axis=0, return_inverse=True, return_counts=True)
        is_boundary = counts[inverse.ravel()].reshape(facets.shape) == 1
    index, face = np.nonzero(is_boundary)
    return cells[index], face


def _reference_triangles(mesh: dolfinx.mesh.Mesh) -> tuple[Array, Numbers]:
    """Return the nodes of a quadratic element, and the triangles that its faces consist of.

    Returns:
        The nodes in the reference cell, (nodes, tdim), and the nodes of the triangles of each face,
        (faces, triangles of a face, 3).
    """
    cell = getattr(basix.CellType, mesh.topology.cell_name())
    element = basix.create_element(basix.ElementFamily.P, cell, 2)
    nodes = np.asarray(element.points, dtype=np.float64)
    vertices = np.asarray(basix.geometry(cell), dtype=np.float64)
    triangles = []
    for face in basix.topology(cell)[2]:
        corners = vertices[face]
        if len(face) == 3:
            points = [corners[[i, j]].mean(axis=0) for i, j in TRIANGLE_NODES]
            of_face = TRIANGLES
        else:
            edges = corners[1] - corners[0], corners[2] - corners[0]
            points = [
                corners[0] + 0.5 * (i * edges[0] + j * edges[1]) for j in range(3) for i in range(3)
            ]
            of_face = QUADRILATERALS
        distance = np.linalg.norm(nodes[None] - np.array(points)[:, None], axis=2)
        triangles.append(distance.argmin(axis=1)[of_face])
    return nodes, np.array(triangles, dtype=np.int64)


def _evaluate(expression: Expr, mesh: dolfinx.mesh.Mesh, cells: Integers, nodes: Array) -> Array:
    """Return an expression at reference points of cells, (n, nodes, size). Collective.

    The size is 1 for scalars and 3 for vectors; the third component is zero in the plane.
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


def _has_inward_normal(x: Array, inside: Array) -> Mask:
    """Return a mask of the triangles whose normal points into their cell, (t,).

    Args:
        x: Corners of the triangles, (t, 3, 3).
        inside: A point in the cell of each triangle, (t, 3).
    """
    normal = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    outward = x.mean(axis=1) - inside
    return np.asarray(np.einsum("ti,ti->t", normal, outward) < 0.0)


def _with_shared_points(
    triangles: _Triangles, group: Numbers, tolerance: float, *, is_plane: bool
) -> BodySurface:
    """Merge the corners of triangles that coincide, within each group of triangles.

    Args:
        triangles: The triangles.
        group: Number of the group of each triangle, (t,).
        tolerance: Distance up to which reference positions count as one point.
        is_plane: Whether the body is a domain of the plane.
    """
    X = triangles.X.reshape(-1, 3)
    rounded = np.floor(X / tolerance + ROUNDING_SHIFT).astype(np.int64)
    keys = np.column_stack([np.repeat(group, 3), rounded])
    _, point_of_corner = np.unique(keys, axis=0, return_inverse=True)
    point_of_corner = point_of_corner.ravel()
    points = _means(triangles.x.reshape(-1, 3), point_of_corner)
    values = _means(triangles.values.reshape(-1, triangles.values.shape[2]), point_of_corner)
    if values.shape[1] == 1:
        values = values[:, 0]
    return BodySurface(points, point_of_corner.reshape(-1, 3), values, triangles.part, is_plane)


def _means(rows: Array, point: Integers) -> Array:
    """Return the mean of the rows, (corners, size), of each point, (points, size)."""
    count = np.bincount(point)
    sums = [np.bincount(point, column) for column in rows.T]
    return np.asarray(np.stack(sums, axis=1) / count[:, None])
