# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Order of elimination by nested dissection: METIS (Karypis and Kumar 1998) or PETSc.

METIS is called in the library that PETSc is linked with. Without that library, PETSc's own
dissection orders the nodes, and a factorisation takes about 1.5 times as many operations.
"""

from __future__ import annotations

import ctypes

from petsc4py import PETSc

import numpy as np

from dolfinx_feti.runtime.arrays import Indices, Numbers
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.runtime.petsc_library import c_function

#: METIS_NOPTIONS of metis.h, the length of the array of options.
METIS_OPTIONS = 40

#: Return value METIS_OK of metis.h.
METIS_OK = 1

#: Seed of the random numbers in the test of symmetry. An arbitrary number.
SEED = 1998


def nested_dissection(ptr: Indices, adjacent: Indices, interior: Indices) -> Indices:
    """Return the nodes of the interior in the order of their elimination.

    METIS needs a symmetric graph. PETSc orders any other, such as that of a symmetric matrix that
    stores some zeros on one side of the diagonal only.

    Args:
        ptr: Place of the first neighbour of each node, (nodes + 1,).
        adjacent: Neighbours of all nodes, (ptr[nodes],).
        interior: Nodes that are eliminated, ascending, (m_I,).

    Returns:
        A permutation of the interior, (m_I,).
    """
    place_in_interior = np.full(len(ptr) - 1, -1, dtype=np.int32)
    place_in_interior[interior] = np.arange(len(interior))
    row = np.repeat(place_in_interior, np.diff(ptr))
    column = place_in_interior[adjacent]
    is_edge = (row >= 0) & (column >= 0) & (row != column)
    row = row[is_edge]
    column = column[is_edge]
    if len(row) == 0:
        return interior
    begin = np.searchsorted(row, np.arange(len(interior) + 1))  # rows ascend, like the interior
    order = None
    if _is_symmetric(row, column, len(interior)):
        order = _metis_order(begin, column)
    if order is None:
        order = _petsc_order(begin, column)
    return interior[order]


def _is_symmetric(row: Indices, column: Indices, n: int) -> bool:
    """Return True if (j, i) is among the pairs for each pair (i, j), all below n.

    The sums of products of random 64-bit numbers over all (i, j) and over all (j, i) agree, modulo
    2⁶⁴. If the graph is not symmetric, they agree with a probability of about 2⁻⁶⁴.
    """
    x, y = np.random.default_rng(SEED).integers(2**63, size=(2, n), dtype=np.uint64)
    return bool(np.sum(x[row] * y[column]) == np.sum(x[column] * y[row]))


def _metis_order(ptr: Numbers, adjacent: Indices) -> Indices | None:
    """Order the nodes of a graph by METIS.

    Args:
        ptr: Place of the first neighbour of each node, (n + 1,).
        adjacent: Neighbours. The graph is symmetric and has no loops; METIS may not return
            otherwise.

    Returns:
        The order, (n,); None if PETSc is not linked with METIS, or METIS fails.
    """
    node_nd = c_function("METIS_NodeND", (ctypes.c_void_p,) * 7)
    set_default_options = c_function("METIS_SetDefaultOptions", (ctypes.c_void_p,))
    if node_nd is None or set_default_options is None:
        return None
    # METIS is compiled with integers of 32 or 64 bits. It sets its options to −1 by default, which
    # fills the whole array in the second case only.
    options = np.zeros(METIS_OPTIONS, dtype=np.int64)
    set_default_options(options.ctypes.data)
    integer = np.int64 if np.all(options == -1) else np.int32
    n = np.array([len(ptr) - 1], dtype=integer)
    begin = ptr.astype(integer)
    neighbours = adjacent.astype(integer)
    order, inverse = np.empty((2, len(ptr) - 1), dtype=integer)  # a permutation and its inverse
    status = node_nd(
        n.ctypes.data,
        begin.ctypes.data,
        neighbours.ctypes.data,
        None,  # weights of the nodes
        None,  # default options
        order.ctypes.data,
        inverse.ctypes.data,
    )
    is_permutation = status == METIS_OK and np.array_equal(np.sort(order), np.arange(len(order)))
    return order.astype(np.int32) if is_permutation else None


def _petsc_order(ptr: Numbers, adjacent: Indices) -> Indices:
    """Order the nodes of a graph by PETSc, (n,); arguments as in :func:`_metis_order`."""
    n = len(ptr) - 1
    csr = (ptr.astype(PETSc.IntType), adjacent.astype(PETSc.IntType), np.ones(len(adjacent)))
    with Lifetime() as owned:
        graph = owned.own(PETSc.Mat().createAIJ((n, n), csr=csr, comm=PETSc.COMM_SELF))
        rows, columns = graph.getOrdering("nd")
        owned.own(rows)
        owned.own(columns)
        return np.asarray(rows.indices.astype(np.int32))
