# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Cells of a lattice of nodes: bricks with straight or curved edges, or simplices.

A brick of order k has (k + 1)³ nodes. It is a hexahedron, or is cut into six tetrahedra: there are
six paths of three edges from its first corner to the last, and each tetrahedron has the corners on
one of them. A lattice in two dimensions has quadrilaterals or triangles. If it is a side of a
lattice in three dimensions, they are the facets of its cells.
"""

from __future__ import annotations

import itertools

import numpy as np

import basix

from dolfinx_feti.runtime.arrays import Array, Numbers

__all__ = ["lattice_cells"]

#: Bricks by the dimension of the lattice.
BRICKS = {2: basix.CellType.quadrilateral, 3: basix.CellType.hexahedron}

#: Cells that bricks are cut into, by the dimension of the lattice.
SIMPLICES = {2: basix.CellType.triangle, 3: basix.CellType.tetrahedron}


def lattice_cells(numbers: Numbers, order: int, *, simplices: bool) -> Numbers:
    """Return the nodes of all cells of a lattice, (cells, nodes).

    The nodes of a cell are in dolfinx's order. The cells are ordered like the bricks in the
    lattice, in which the last index changes fastest.

    Args:
        numbers: Number of each node, an array with two or three axes. Nodes with one number, such
            as those where a tube closes, become one.
        order: Order of the cells: order + 1 nodes along an edge.
        simplices: Whether each brick is cut into simplices.
    """
    dim = numbers.ndim
    n_bricks = [(n_nodes - 1) // order for n_nodes in numbers.shape]
    first = order * np.stack(np.meshgrid(*map(np.arange, n_bricks), indexing="ij"), axis=-1)
    offsets = np.rint(order * _reference_nodes(dim, order, simplices=simplices)).astype(np.int64)
    positions = first.reshape(-1, 1, 1, dim) + offsets  # (bricks, cells of a brick, nodes, dim)
    return np.asarray(numbers[tuple(np.moveaxis(positions, -1, 0))].reshape(-1, offsets.shape[1]))


def _reference_nodes(dim: int, order: int, *, simplices: bool) -> Array:
    """Return the nodes of the cells of a unit brick, (cells, nodes, dim).

    Each simplex has the corners on a path of edges from the first corner of the brick to the last:
    the steps of the path are a permutation of the axes.
    """
    cell_type = SIMPLICES[dim] if simplices else BRICKS[dim]
    element = basix.create_element(basix.ElementFamily.P, cell_type, order)
    points = np.asarray(element.points, np.float64)
    if not simplices:
        return points[None]
    paths = itertools.permutations(range(dim))
    steps = np.array([np.eye(dim)[list(path)] for path in paths])  # (cells, dim, dim)
    return np.asarray(points @ np.cumsum(steps, axis=1))
