# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Bodies: connected components of the assembled problem without its Dirichlet dofs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse
import scipy.sparse.csgraph

from dolfinx_feti.runtime.arrays import Numbers
from dolfinx_feti.torn.matrix import Torn


@dataclass(frozen=True, slots=True)
class Bodies:
    """The bodies of a torn matrix; they depend on its pattern alone.

    Attributes:
        count: Number of bodies over all processes.
        label: Body of each torn dof, (n,); ``count`` for those with a prescribed value.
        supports: Torn dofs with a prescribed value next to a body, with the body; (pairs, 2).
    """

    count: int
    label: Numbers
    supports: Numbers


def find_bodies(torn: Torn) -> Bodies:
    """Find the connected components. Collective."""
    bs = torn.K.getBlockSize()
    graph = torn.graph
    free = np.any(~torn.dirichlet.reshape(-1, bs), axis=1)
    pieces, label = scipy.sparse.csgraph.connected_components(graph[free][:, free], directed=False)
    piece = np.full(len(free), -1, dtype=np.int64)
    piece[free] = torn.comm.scan(pieces) - pieces + label
    count, merged = _merge(torn, np.repeat(piece, bs), torn.comm.allreduce(pieces))
    body = np.where(piece >= 0, merged[piece], count) if len(merged) else piece + 1
    body_of_dof = np.repeat(body, bs)
    partly = np.flatnonzero(torn.dirichlet & (body_of_dof < count))  # other dofs of the node free
    fixed, neighbour = graph.tocsr()[~free][:, free].nonzero()
    nodes = np.column_stack([np.flatnonzero(~free)[fixed], body[free][neighbour]])
    nodes = np.unique(nodes, axis=0)
    dofs = (nodes[:, :1] * bs + np.arange(bs)).ravel()
    supports = np.hstack([[partly, body_of_dof[partly]], [dofs, np.repeat(nodes[:, 1], bs)]]).T
    return Bodies(count, np.where(torn.dirichlet, count, body_of_dof), supports)


def _merge(torn: Torn, piece: Numbers, pieces: int) -> tuple[int, Numbers]:
    """Join the pieces that hold copies of one dof: number of bodies, and the body of each piece."""
    copies = torn.gather(piece.astype(np.float64)).astype(np.int64)
    degree = torn.multiplicity()
    first = np.repeat(copies[np.cumsum(degree) - degree] if len(degree) else copies, degree)
    pairs = np.unique((first * pieces + copies)[(first >= 0) & (copies >= 0)])
    a, b = np.divmod(np.concatenate(torn.comm.allgather(pairs)), max(pieces, 1))
    joined = scipy.sparse.csr_array((np.ones(len(a)), (a, b)), shape=(pieces, pieces))
    count, label = scipy.sparse.csgraph.connected_components(joined, directed=False)
    return int(count), label.astype(np.int64)
