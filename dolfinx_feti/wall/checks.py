# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Checks of a wall's mesh before dolfinx reads it, which accepts broken meshes and may crash.

Each process has any share of the points, cells and facets; cells and facets are rows of nodes in
dolfinx's order. To detect equal rows, those with the same smallest node are sent to one process.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from mpi4py import MPI

import numpy as np

import basix

from dolfinx_feti.runtime import compat
from dolfinx_feti.runtime.arrays import Array, Integers, Mask, Numbers
from dolfinx_feti.wall.wall import Wall

__all__ = ["CELLS", "check_connectivity", "check_faces", "check_geometry", "orientations"]


class WallCell(NamedTuple):
    """A type of cell that walls have.

    Attributes:
        shape: basix's name of the cell.
        order: Order of the geometry, 1 or 2.
        facet_nodes: Number of nodes of a facet.
    """

    shape: str
    order: int
    facet_nodes: int


#: Types of cells of walls by their number of nodes.
CELLS = {
    4: WallCell("tetrahedron", 1, 3),
    10: WallCell("tetrahedron", 2, 6),
    8: WallCell("hexahedron", 1, 4),
    27: WallCell("hexahedron", 2, 9),
}

#: Volume of a cell over the cube of its largest extent, below which the cell is flat: a margin over
#: the rounding of det ∂x/∂ξ, far below the slivers that mesh generators make.
MIN_RELATIVE_VOLUME = 1e-12

#: Degree of the quadrature at whose points det ∂x/∂ξ of a curved cell or a hexahedron is evaluated,
#: with 3 × 3 × 3 points of a hexahedron. Cells that are inverted only between the points pass.
ORIENTATION_DEGREE = 4

#: Cells whose orientations are computed at a time: a memory bound, some 20 MB for hexahedra.
CHECKED_CELLS_AT_ONCE = 10_000


def check_connectivity(
    mesh_name: object, x: Array, cells: Integers, others: Sequence[Integers], comm: MPI.Comm
) -> None:
    """Check that nodes exist and are finite, and that cells occur once. Collective.

    A cell with the same node twice is refused, too.

    Args:
        mesh_name: Name of the mesh for messages, such as its path.
        x: Points of this process, (n, 3).
        cells: Cells of this process, (m, nodes).
        others: Further tables of nodes, such as facets.
        comm: Communicator.

    Raises:
        ValueError: The mesh has no cells, or one of the checks fails. On all processes.
    """
    cell_name, facet_name = _plural_names(cells)
    n = comm.allreduce(len(x))
    if not comm.allreduce(len(cells)):
        raise ValueError(f"{mesh_name} has no cells")
    tables = [(cell_name, cells), *((facet_name, rows) for rows in others)]
    for name, rows in tables:
        has_missing_point = ((rows < 0) | (rows >= n)).any(axis=1)
        message = f"{name} of {mesh_name} have points that are not in the file"
        _require_none(has_missing_point, message, comm)
    is_infinite = np.any(~np.isfinite(x), axis=1)
    _require_none(is_infinite, f"points of {mesh_name} have coordinates that are not finite", comm)
    sorted_cells = _rows_by_smallest_node(cells, n, comm)
    sorted_cells = sorted_cells[np.lexsort(sorted_cells.T)]
    equals_next_cell = (sorted_cells[1:] == sorted_cells[:-1]).all(axis=1)
    message = f"{cell_name} of {mesh_name} occur twice: put each into one layer"
    _require_none(equals_next_cell, message, comm)
    has_point_twice = (sorted_cells[:, 1:] == sorted_cells[:, :-1]).any(axis=1)
    _require_none(
        has_point_twice, f"{cell_name} of {mesh_name} have no volume: improve the mesh", comm
    )


def check_faces(mesh_name: object, cells: Integers, facets: Integers, comm: MPI.Comm) -> None:
    """Check that a face has at most two cells, and a facet is a face and has one tag. Collective.

    Args:
        mesh_name: Name of the mesh for messages, such as its path.
        cells: Cells of this process, which have passed :func:`check_connectivity`, (m, nodes).
        facets: Tagged facets of this process, which have also passed it, (k, nodes).
        comm: Communicator.

    Raises:
        ValueError: One of the checks fails. On all processes.
    """
    cell_name, facet_name = _plural_names(cells)
    cell_type = CELLS[cells.shape[1]]
    has_other_nodes = facets.shape[1] != cell_type.facet_nodes  # the same on all processes
    if has_other_nodes and comm.allreduce(len(facets)):
        raise ValueError(
            f"{mesh_name} has {cell_name} of order {cell_type.order}, but facets with "
            f"{facets.shape[1]} nodes: a wall has {facet_name} of that order"
        )
    corners = np.array(
        basix.topology(getattr(basix.CellType, cell_type.shape))[2]
    )  # (faces, corners)
    n = 1 + comm.allreduce(int(cells.max(initial=0)), op=MPI.MAX)
    faces_of_cells = _rows_by_smallest_node(
        cells[:, corners].reshape(-1, corners.shape[1]), n, comm
    )
    faces, cells_of_face = np.unique(faces_of_cells, axis=0, return_counts=True)
    message = f"{facet_name} of {mesh_name} are faces of more than two {cell_name}: cells overlap"
    _require_none(cells_of_face > 2, message, comm)
    tagged = _rows_by_smallest_node(facets[:, : corners.shape[1]], n, comm)
    tagged_faces, tags_of_face = np.unique(tagged, axis=0, return_counts=True)
    message = f"{facet_name} of {mesh_name} have two tags: give each of them one surface"
    _require_none(tags_of_face > 1, message, comm)
    n_all = len(np.unique(np.vstack([faces, tagged_faces]), axis=0))
    message = (
        f"tagged {facet_name} of {mesh_name} are not faces of its {cell_name}: mesh both together"
    )
    _require_zero(n_all - len(faces), message, comm)


def check_geometry(mesh_name: object, wall: Wall, *, same_orientation: bool) -> None:
    """Check that cells have a volume and are not inverted. Collective.

    Args:
        mesh_name: Name of the mesh for messages, such as its path.
        wall: The wall.
        same_orientation: Whether the nodes of all cells have to be numbered alike: all or none of
            the cells are mirrored. ``write_wall`` may change the order of nodes.

    Raises:
        ValueError: One of the checks fails. On all processes.
    """
    comm = wall.mesh.comm
    n = wall.mesh.topology.index_map(3).size_local
    cells = compat.geometry_dofmap(wall.mesh)[:n]
    sign, is_flat = orientations(np.asarray(wall.mesh.geometry.x, dtype=np.float64), cells)
    name = f"{_plural_names(cells)[0]} of {mesh_name}"
    _require_none(is_flat, f"{name} have no volume: improve the mesh", comm)
    is_wrong = sign == 0
    if same_orientation:
        negative = comm.allreduce(int(np.sum(sign == -1)))
        positive = comm.allreduce(int(np.sum(sign == 1)))
        sign_of_most = 1 if negative <= positive else -1
        is_wrong = sign != sign_of_most
    remedy = "improve the mesh, or number their nodes as in the other cells"
    message = f"{name} are inverted, in part or against the others: {remedy}"
    _require_none(is_wrong, message, comm)


def orientations(points: Array, cells: Integers) -> tuple[Numbers, Mask]:
    """Return the orientations of cells, and which cells have no volume.

    Args:
        points: Coordinates, (n, 3).
        cells: Nodes of the cells, (cells, nodes).

    Returns:
        The sign of det ∂x/∂ξ in each cell, 0 if it changes in the cell, (cells,); and a mask of the
        cells without volume, (cells,).
    """
    cell_type = CELLS[cells.shape[1]]
    cell = getattr(basix.CellType, cell_type.shape)
    variant = basix.LagrangeVariant.equispaced
    element = basix.create_element(basix.ElementFamily.P, cell, cell_type.order, variant)
    is_affine = cell_type.shape == "tetrahedron" and cell_type.order == 1
    rule = basix.make_quadrature(cell, 0 if is_affine else ORIENTATION_DEGREE)
    ξ, weights = (np.asarray(part, np.float64) for part in rule)
    dφ = np.asarray(element.tabulate(1, ξ), np.float64)[1:, :, :, 0]  # (3, points, nodes)
    sign = np.zeros(len(cells), dtype=np.int64)
    is_flat = np.zeros(len(cells), dtype=bool)
    for first in range(0, len(cells), CHECKED_CELLS_AT_ONCE):
        chunk = slice(first, first + CHECKED_CELLS_AT_ONCE)
        x = points[cells[chunk]]
        det = np.linalg.det(np.einsum("jqn,cni->cqij", dφ, x))  # det ∂x/∂ξ, (cells, points)
        sign[chunk][(det > 0.0).all(axis=1)] = 1
        sign[chunk][(det < 0.0).all(axis=1)] = -1
        largest_extent = np.ptp(x, axis=1).max(axis=1)
        is_flat[chunk] = np.abs(det @ weights) <= MIN_RELATIVE_VOLUME * largest_extent**3
    return sign, is_flat


def _plural_names(cells: Integers) -> tuple[str, str]:
    """Return the plural names of cells and facets."""
    if CELLS[cells.shape[1]].shape == "tetrahedron":
        return "tetrahedra", "triangles"
    return "hexahedra", "quadrilaterals"


def _require_none(is_wrong: Mask, message: str, comm: MPI.Comm) -> None:
    """Raise a ValueError with the number of wrong rows, if there are any. Collective."""
    _require_zero(int(np.sum(is_wrong)), message, comm)


def _require_zero(wrong: int, message: str, comm: MPI.Comm) -> None:
    """Raise a ValueError on all processes with the sum of counts, if it is not zero. Collective."""
    count = comm.allreduce(wrong)
    if count:
        raise ValueError(f"{count} {message}")


def _rows_by_smallest_node(rows: Integers, n: int, comm: MPI.Comm) -> Integers:
    """Sort the nodes in each row, and send rows with the same smallest node to one process.

    Equal rows are then on one process. Collective.

    Args:
        rows: Nodes of the cells or facets of this process, (m, nodes).
        n: A number above all nodes.
        comm: Communicator.

    Returns:
        The rows that this process gets, (k, nodes).
    """
    rows = np.sort(rows, axis=1)
    if comm.size == 1:
        return rows
    process = rows[:, 0] * comm.size // n
    return np.vstack(comm.alltoall([rows[process == rank] for rank in range(comm.size)]))
