# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The unit cube of the paper: subcubes of cubic cells, each cell cut into 24 tetrahedra.

A tetrahedron has the centre of its cell, the centre of one of the six faces and an edge of that
face. The mesh's nodes are five lattices of points: corners, centres of the cells, and centres of
the faces across each axis.
"""

from __future__ import annotations

import itertools

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import basix.ufl
import dolfinx

from dolfinx_feti.runtime import compat

__all__ = ["TETRAHEDRA", "create_cube"]

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

CORNERS = np.array(list(itertools.product((0, 1), repeat=3)))
FACES = np.array([(axis, side) for axis in range(3) for side in (0, 1)])

#: Where a lattice begins within a cell: corners, centres, and faces across each axis.
OFFSETS = 0.5 * np.array([(0, 0, 0), (1, 1, 1), (0, 1, 1), (1, 0, 1), (1, 1, 0)])


def _tetrahedra() -> Indices:
    """List the tetrahedra of a cell by its nodes: the centre, 6 faces, 8 corners; (24, 4)."""
    cells = []
    for f, (axis, side) in enumerate(FACES):
        ring = [7 + 4 * c[0] + 2 * c[1] + c[2] for c in CORNERS if c[axis] == side]
        around = [ring[j] for j in (0, 1, 3, 2)]
        cells += [(0, 1 + f, around[j], around[j - 1]) for j in range(4)]
    return np.array(cells)


TETRAHEDRA = _tetrahedra()


def create_cube(
    comm: MPI.Comm, subdomains: int, cells: int
) -> tuple[dolfinx.mesh.Mesh, npt.NDArray[np.int32]]:
    """Mesh the unit cube such that each subcube lies on one process.

    Args:
        comm: Communicator of the mesh; each process gets subcubes next to each other.
        subdomains: Subcubes along an edge of the cube.
        cells: Cubic cells along an edge of a subcube.

    Returns:
        The mesh, and the number of the subcube of each owned tetrahedron, (n_cells,).

    Note:
        Collective.
    """
    mine = _share(subdomains**3, comm)
    number = _node_numbers(_cells(mine, subdomains, cells), subdomains * cells)
    tetrahedra = number[:, TETRAHEDRA].reshape(-1, 4)
    x = _coordinates(subdomains * cells, comm)
    here = compat.adjacency(np.full((len(tetrahedra), 1), comm.rank, dtype=np.int32))
    mesh = dolfinx.mesh.create_mesh(
        comm,
        cells=tetrahedra,
        x=x,
        e=basix.ufl.element("Lagrange", "tetrahedron", 1, shape=(3,)),
        partitioner=lambda *_: here,
    )
    of = mesh.topology.original_cell_index // (len(TETRAHEDRA) * cells**3)
    return mesh, of.astype(np.int32)


def _share(count: int, comm: MPI.Comm) -> Indices:
    """Return this process's part of 0, …, count − 1, in order."""
    ends = [count * rank // comm.size for rank in (comm.rank, comm.rank + 1)]
    return np.arange(*ends)


def _cells(subcubes: Indices, subdomains: int, cells: int) -> Indices:
    """Return the place of each cell of some subcubes, subcube by subcube, (cells, 3)."""
    corner = cells * np.column_stack(np.unravel_index(subcubes, (subdomains,) * 3))
    inside = np.column_stack(np.unravel_index(np.arange(cells**3), (cells,) * 3))
    return (corner[:, None] + inside).reshape(-1, 3)


def _shapes(edge: int) -> list[tuple[int, ...]]:
    """Return the shape of each lattice of a cube of edge³ cells."""
    return [tuple(int(edge + 1 - 2 * start) for start in offset) for offset in OFFSETS]


def _node_numbers(place: Indices, edge: int) -> Indices:
    """Number the nodes of each cell, centre, faces, corners; (cells, 15)."""
    shapes = _shapes(edge)
    first = np.cumsum([0, *(np.prod(shape) for shape in shapes)])

    def number(lattice: int, at: Indices) -> Indices:
        return first[lattice] + np.ravel_multi_index(tuple(at.T), shapes[lattice])

    columns = [number(1, place)]
    columns += [number(2 + axis, place + side * np.eye(3, dtype=int)[axis]) for axis, side in FACES]
    columns += [number(0, place + corner) for corner in CORNERS]
    return np.column_stack(columns)


def _coordinates(edge: int, comm: MPI.Comm) -> Array:
    """Return the coordinates of this process's share of the nodes, (nodes, 3)."""
    shapes = _shapes(edge)
    first = np.cumsum([0, *(np.prod(shape) for shape in shapes)])
    node = _share(first[-1], comm)
    x = np.zeros((len(node), 3))
    for start, shape, offset in zip(first, shapes, OFFSETS, strict=False):
        inside = (node >= start) & (node < start + np.prod(shape))
        x[inside] = np.column_stack(np.unravel_index(node[inside] - start, shape)) + offset
    return x / edge
