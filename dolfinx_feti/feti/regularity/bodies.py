# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Bodies: connected components of the assembled problem without its Dirichlet dofs.

A body without enough supports can move rigidly, and the problem is singular.

A *node* is a block of dofs, of the block size of the matrix. A *piece* is a connected component of
the free nodes of one process; copies of one dof join pieces to bodies.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse
import scipy.sparse.csgraph

from dolfinx_feti.runtime.arrays import Mask, Numbers
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.torn.matrix import Torn


@dataclass(frozen=True, slots=True)
class Supports:
    """Pairs of a torn Dirichlet dof of this process and a body that it supports.

    A dof that supports several bodies occurs once for each.

    Attributes:
        dofs: The torn dofs, (supports,).
        bodies: The bodies, (supports,).
    """

    dofs: Numbers
    bodies: Numbers


@dataclass(frozen=True, slots=True)
class Bodies:
    """The bodies of a torn matrix; they depend on its pattern alone.

    Attributes:
        count: Number of bodies over all processes.
        label: Body of each torn dof of this process, (n,); ``count`` for Dirichlet dofs.
        supports: Which Dirichlet dofs support which bodies.
    """

    count: int
    label: Numbers
    supports: Supports


def find_bodies(torn: Torn) -> Bodies:
    """Return the connected components of the assembled problem. Collective."""
    bs = torn.K.getBlockSize()
    is_free = np.any(~torn.is_dirichlet_copy.reshape(-1, bs), axis=1)  # nodes

    def find_pieces() -> tuple[int, Numbers]:
        """Return the number of pieces of this process, and the piece of each free node."""
        graph = torn.graph[is_free][:, is_free]
        return scipy.sparse.csgraph.connected_components(graph, directed=False)

    local_pieces, label = on_all(find_pieces, torn.comm)
    first = torn.comm.scan(local_pieces) - local_pieces
    piece_of_node = np.full(len(is_free), -1, dtype=np.int64)
    piece_of_node[is_free] = first + label
    pieces = torn.comm.allreduce(local_pieces)
    count, body_of_piece = _join_pieces(torn, np.repeat(piece_of_node, bs), pieces)

    def create() -> Bodies:
        """Return the bodies, from the body of each node."""
        body_of_node = np.full(len(is_free), count, dtype=np.int64)
        body_of_node[is_free] = body_of_piece[piece_of_node[is_free]]
        label = np.where(torn.is_dirichlet_copy, count, np.repeat(body_of_node, bs))
        return Bodies(count, label, _find_supports(torn, is_free, body_of_node))

    return on_all(create, torn.comm)


def _find_supports(torn: Torn, is_free: Mask, body_of_node: Numbers) -> Supports:
    """Find the Dirichlet dofs that support a body.

    A Dirichlet dof of a node with free dofs supports the body of its node. One of a node without
    free dofs supports the bodies of the nodes that K couples to it.

    Args:
        torn: The torn matrix.
        is_free: Mask of the nodes with a free dof, (n / bs,).
        body_of_node: Body of each free node, (n / bs,).
    """
    bs = torn.K.getBlockSize()
    on_free_nodes = np.flatnonzero(torn.is_dirichlet_copy & np.repeat(is_free, bs))

    constrained_nodes = np.flatnonzero(~is_free)
    body_of_free_node = body_of_node[is_free]
    row, neighbour = torn.graph.tocsr()[~is_free][:, is_free].nonzero()
    couplings = np.column_stack([constrained_nodes[row], body_of_free_node[neighbour]])
    node_and_body = np.unique(couplings, axis=0)
    on_constrained_nodes = (node_and_body[:, :1] * bs + np.arange(bs)).ravel()
    return Supports(
        dofs=np.append(on_free_nodes, on_constrained_nodes),
        bodies=np.append(body_of_node[on_free_nodes // bs], np.repeat(node_and_body[:, 1], bs)),
    )


def _join_pieces(torn: Torn, piece: Numbers, pieces: int) -> tuple[int, Numbers]:
    """Join the pieces that have copies of one dof. Collective.

    Args:
        torn: The torn matrix.
        piece: Piece of each torn dof; −1 if its node has no free dof, (n,).
        pieces: Number of pieces over all processes.

    Returns:
        The number of bodies, and the body of each piece of all processes, (pieces,).
    """
    piece_of_copy = torn.gather(piece)
    multiplicity = torn.multiplicity()

    def find_pairs() -> Numbers:
        """Return the pairs of pieces that have copies of one owned dof, (pairs, 2).

        Two copies that are both paired with the first copy are in one body, so these pairs are
        enough.
        """
        has_copies = multiplicity > 0
        first_copy = (np.cumsum(multiplicity) - multiplicity)[has_copies]
        first = np.repeat(piece_of_copy[first_copy], multiplicity[has_copies])
        is_free = (first >= 0) & (piece_of_copy >= 0)
        entries = (np.ones(np.count_nonzero(is_free)), (first[is_free], piece_of_copy[is_free]))
        return np.column_stack(scipy.sparse.csr_array(entries, shape=(pieces, pieces)).nonzero())

    pairs = np.vstack(torn.comm.allgather(on_all(find_pairs, torn.comm)))
    entries = (np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1]))
    graph = scipy.sparse.csr_array(entries, shape=(pieces, pieces))
    count, label = scipy.sparse.csgraph.connected_components(graph, directed=False)
    return int(count), label.astype(np.int64)
