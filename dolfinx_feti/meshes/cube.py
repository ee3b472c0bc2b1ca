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
import math

from mpi4py import MPI

import numpy as np

import basix.ufl
import dolfinx

from dolfinx_feti.runtime import compat
from dolfinx_feti.runtime.arrays import Array, Indices, Numbers
from dolfinx_feti.runtime.values import require_within

__all__ = ["TETRAHEDRA", "create_cube"]

#: Corners of a cell, (8, 3).
CORNERS = np.array(list(itertools.product((0, 1), repeat=3)))

#: Faces of a cell: the axis across them, and 0 for the lower or 1 for the upper one, (6, 2).
FACES = np.array([(axis, side) for axis in range(3) for side in (0, 1)])

#: First point of each lattice in a cell, (5, 3): corners, centres, and faces across each axis.
OFFSETS = 0.5 * np.array([(0, 0, 0), (1, 1, 1), (0, 1, 1), (1, 0, 1), (1, 1, 0)])


def _tetrahedra() -> Numbers:
    """Return the tetrahedra of a cell by its nodes, (24, 4).

    Node 0 is the centre, 1 to 6 are the centres of :data:`FACES`, and 7 to 14 :data:`CORNERS`.
    """
    cells = []
    for f, (axis, side) in enumerate(FACES):
        corners = [7 + i for i, corner in enumerate(CORNERS) if corner[axis] == side]
        around = [corners[j] for j in (0, 1, 3, 2)]  # in the order of the edges of the face
        cells += [(0, 1 + f, around[j], around[j - 1]) for j in range(4)]
    return np.array(cells)


#: Nodes of the tetrahedra of a cell, (24, 4).
TETRAHEDRA = _tetrahedra()


def create_cube(comm: MPI.Comm, subcubes: int, cells: int) -> tuple[dolfinx.mesh.Mesh, Indices]:
    """Create the unit cube's mesh, with each subcube on one process.

    Args:
        comm: Communicator of the mesh; each process gets consecutive subcubes.
        subcubes: Number of subcubes along an edge of the cube, 1 or more.
        cells: Number of cubic cells along an edge of a subcube, 1 or more.

    Returns:
        The mesh, and the number of the subcube of each owned tetrahedron, (n_cells,).

    Raises:
        ValueError: A number is less than 1. On all processes.

    Note:
        Collective.
    """
    require_within(1.0, math.inf, {"subcubes": subcubes, "cells": cells}, remedy="1 or more")
    edge = subcubes * cells
    numbers = _node_numbers(_cell_positions(_share(subcubes**3, comm), subcubes, cells), edge)
    tetrahedra = numbers[:, TETRAHEDRA].reshape(-1, 4)
    # the process of each tetrahedron: dolfinx keeps the mesh as it is distributed
    destinations = compat.adjacency(np.full((len(tetrahedra), 1), comm.rank, dtype=np.int32))
    mesh = dolfinx.mesh.create_mesh(
        comm,
        cells=tetrahedra,
        x=_coordinates(edge, comm),
        e=basix.ufl.element("Lagrange", "tetrahedron", 1, shape=(3,)),
        partitioner=lambda *_: destinations,
    )
    subcube = mesh.topology.original_cell_index // (len(TETRAHEDRA) * cells**3)
    return mesh, subcube.astype(np.int32)


def _share(count: int, comm: MPI.Comm) -> Numbers:
    """Return this process's part of 0, …, count − 1, in order."""
    first = count * comm.rank // comm.size
    end = count * (comm.rank + 1) // comm.size
    return np.arange(first, end)


def _cell_positions(subcube: Numbers, subcubes: int, cells: int) -> Numbers:
    """Return the position of each cubic cell in the cube, subcube by subcube, (n, 3).

    Positions are counted in cells along each axis.

    Args:
        subcube: Numbers of the subcubes, (k,).
        subcubes: Number of subcubes along an edge of the cube.
        cells: Number of cubic cells along an edge of a subcube.
    """
    corner = cells * np.column_stack(np.unravel_index(subcube, (subcubes,) * 3))
    inside = np.column_stack(np.unravel_index(np.arange(cells**3), (cells,) * 3))
    return (corner[:, None] + inside).reshape(-1, 3)


def _lattices(edge: int) -> tuple[list[tuple[int, ...]], Numbers]:
    """Return how the nodes of a cube of edge³ cells are numbered, lattice by lattice.

    Returns:
        The shape of each of the five lattices, and the number of its first node, followed by the
        number of all nodes, (6,).
    """
    extents = (edge + 1 - 2 * OFFSETS).astype(int)  # a lattice at 1/2 has one point less
    shapes = [tuple(map(int, extent)) for extent in extents]
    return shapes, np.cumsum([0, *(np.prod(shape) for shape in shapes)])


def _node_numbers(position: Numbers, edge: int) -> Numbers:
    """Return the numbers of the nodes of each cell: centre, faces, corners; (cells, 15).

    Args:
        position: Position of each cell, (cells, 3).
        edge: Cells along an edge of the cube.
    """
    shapes, first = _lattices(edge)

    def number(lattice: int, at: Numbers) -> Numbers:
        return first[lattice] + np.ravel_multi_index(tuple(at.T), shapes[lattice])

    columns = [number(1, position)]
    for axis, side in FACES:
        columns.append(number(2 + axis, position + side * np.eye(3, dtype=int)[axis]))
    columns += [number(0, position + corner) for corner in CORNERS]
    return np.column_stack(columns)


def _coordinates(edge: int, comm: MPI.Comm) -> Array:
    """Return the coordinates of this process's share of the nodes, (nodes, 3)."""
    shapes, first = _lattices(edge)
    node = _share(first[-1], comm)
    x = np.zeros((len(node), 3))
    for start, shape, offset in zip(first[:-1], shapes, OFFSETS, strict=True):
        is_in_lattice = (node >= start) & (node < start + np.prod(shape))
        position = np.column_stack(np.unravel_index(node[is_in_lattice] - start, shape))
        x[is_in_lattice] = position + offset
    return x / edge
