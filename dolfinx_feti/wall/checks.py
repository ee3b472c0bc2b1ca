# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Checks of a wall's mesh before dolfinx, which takes a broken one as it is and may crash.

Each process has any share of points, cells and facets, rows of nodes in dolfinx's order. Rows with
the same least node meet on one process.
"""

from __future__ import annotations

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import basix

from dolfinx_feti.runtime import compat
from dolfinx_feti.runtime.arrays import Array, Integers, Mask, Numbers
from dolfinx_feti.wall.wall import Wall

__all__ = ["CELLS", "check_cells", "check_faces", "check_rows", "orientations"]

#: Cell, order of the geometry and nodes of a facet by the number of nodes.
CELLS = {
    4: ("tetrahedron", 1, 3),
    10: ("tetrahedron", 2, 6),
    8: ("hexahedron", 1, 4),
    27: ("hexahedron", 2, 9),
}

#: Volume of a cell, over the cube of its longest edge, that counts as none.
FLAT = 1e-12

#: Cells that are looked at together, to save memory.
MANY = 10_000


def check_rows(
    mesh: object, x: Array, cells: Integers, others: Sequence[Integers], comm: MPI.Comm
) -> None:
    """Require cells that occur once, of finite points that exist, as those of others. Collective.

    ``mesh`` is what messages call the mesh; a ValueError is raised on all processes.
    """
    words, n = _words(cells), comm.allreduce(len(x))
    if not comm.allreduce(len(cells)):
        raise ValueError(f"{mesh} has no cells")
    for what, rows in [(words[0], cells), *((words[1], rows) for rows in others)]:
        lost = ((rows < 0) | (rows >= n)).any(axis=1)
        _refuse(lost, f"{what} of {mesh} have points that are not in the file", comm)
    wrong = ~np.isfinite(x).all(axis=1)
    _refuse(wrong, f"points of {mesh} have coordinates that are not finite", comm)
    rows = _gathered(cells, n, comm)
    rows = rows[np.lexsort(rows.T)]
    twice = (rows[1:] == rows[:-1]).all(axis=1)
    _refuse(twice, f"{words[0]} of {mesh} occur twice: put each into one layer", comm)
    point_twice = (rows[:, 1:] == rows[:, :-1]).any(axis=1)
    _refuse(point_twice, f"{words[0]} of {mesh} have no volume: improve the mesh", comm)


def check_faces(mesh: object, cells: Integers, facets: Integers, comm: MPI.Comm) -> None:
    """Require faces of at most two cells, and facets that are faces, each tagged once. Collective.

    Rows have to have passed :func:`check_rows`.
    """
    (kinds, kind), (cell, order, nodes) = _words(cells), CELLS[cells.shape[1]]
    if facets.shape[1] != nodes and comm.allreduce(len(facets)):
        raise ValueError(
            f"{mesh} has {kinds} of order {order}, but facets with {facets.shape[1]} nodes: a wall "
            f"has {kind} of that order"
        )
    corners = np.array(basix.topology(getattr(basix.CellType, cell))[2])  # (faces, corners)
    n = 1 + comm.allreduce(int(cells.max(initial=0)), op=MPI.MAX)
    every = _gathered(cells[:, corners].reshape(-1, corners.shape[1]), n, comm)
    faces, cells_of_face = np.unique(every, axis=0, return_counts=True)
    crowded = cells_of_face > 2
    _refuse(crowded, f"{kind} of {mesh} are faces of more than two {kinds}: cells overlap", comm)
    tagged = _gathered(facets[:, : corners.shape[1]], n, comm)
    found, count = np.unique(tagged, axis=0, return_counts=True)
    _refuse(count > 1, f"{kind} of {mesh} have two tags: give each of them one surface", comm)
    strays = np.ones(len(np.unique(np.vstack([faces, found]), axis=0)) - len(faces))
    text = f"tagged {kind} of {mesh} are not faces of its {kinds}: mesh both together"
    _refuse(strays, text, comm)


def check_cells(mesh: object, wall: Wall, *, alike: bool) -> None:
    """Require cells with a volume, not turned inside out, and all or none of them mirrored.

    That is asked for if ``alike``. Collective.
    """
    comm, n = wall.mesh.comm, wall.mesh.topology.index_map(3).size_local
    cells = compat.geometry_dofmap(wall.mesh)[:n]
    side, flat = orientations(np.asarray(wall.mesh.geometry.x, dtype=np.float64), cells)
    words = f"{_words(cells)[0]} of {mesh}"
    _refuse(flat, f"{words} have no volume: improve the mesh", comm)
    mirrored = comm.allreduce(int(np.sum(side == -1))), comm.allreduce(int(np.sum(side == 1)))
    wrong = side == 0 if not alike else side != (1 if mirrored[0] <= mirrored[1] else -1)
    text = "improve the mesh, or number their nodes as in the other cells"
    _refuse(wrong, f"{words} are inverted, in part or against the others: {text}", comm)


def orientations(points: Array, cells: Integers) -> tuple[Numbers, Mask]:
    """Return the sign of det ∂x/∂X in each cell, 0 where it changes, and which have no volume."""
    kind, order, _ = CELLS[cells.shape[1]]
    cell = getattr(basix.CellType, kind)
    variant = basix.LagrangeVariant.equispaced
    element = basix.create_element(basix.ElementFamily.P, cell, order, variant)
    degree = 0 if (kind, order) == ("tetrahedron", 1) else 4
    at, weights = (np.asarray(part, np.float64) for part in basix.make_quadrature(cell, degree))
    dφ = np.asarray(element.tabulate(1, at), np.float64)[1:, :, :, 0]  # (3, points, nodes)
    side, flat = np.zeros(len(cells), dtype=np.int64), np.zeros(len(cells), dtype=bool)
    for k in range(0, len(cells), MANY):
        x, part = points[cells[k : k + MANY]], slice(k, k + MANY)
        det = np.linalg.det(np.einsum("jqn,cni->cqij", dφ, x))  # det ∂x/∂X, (cells, points)
        side[part] = (det > 0.0).all(axis=1) * 1 - (det < 0.0).all(axis=1)
        flat[part] = np.abs(det @ weights) <= FLAT * np.ptp(x, axis=1).max(axis=1) ** 3
    return side, flat


def _words(cells: Integers) -> tuple[str, str]:
    """Return what cells and facets are called."""
    tetrahedra = CELLS[cells.shape[1]][0] == "tetrahedron"
    return ("tetrahedra", "triangles") if tetrahedra else ("hexahedra", "quadrilaterals")


def _refuse(wrong: npt.ArrayLike, text: str, comm: MPI.Comm) -> None:
    """Raise a ValueError on all processes that counts what is wrong on any of them."""
    if count := comm.allreduce(int(np.sum(wrong))):
        raise ValueError(f"{count} {text}")


def _gathered(rows: Integers, n: int, comm: MPI.Comm) -> Integers:
    """Return sorted rows of numbers below n, those with the same least one on one process."""
    rows = np.sort(rows, axis=1)
    if comm.size == 1:
        return rows
    place = rows[:, 0] * comm.size // n
    return np.vstack(comm.alltoall([rows[place == rank] for rank in range(comm.size)]))
