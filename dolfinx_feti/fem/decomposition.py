# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Decomposition of the mesh into subdomains, and the torn function space.

.. math:: \overline Ω_0 = \bigcup_i \overline Ω_{0,i}

(eq. 30, Augustin_eq:decomposition). Each process partitions its own cells; every subdomain is
connected through facets. Tearing is a second dof map on the same mesh and element: the pairs
(subdomain, dof) that occur, numbered subdomain by subdomain, so that a form on the torn space
assembles the block-diagonal K of all subdomains.
"""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
import scipy.sparse
import scipy.sparse.csgraph

import dolfinx

from dolfinx_feti.runtime import compat
from dolfinx_feti.runtime.arrays import Array, Indices, Integers, Numbers
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.runtime.events import event

#: Dofs of a subdomain where the user gives no number, measured in ``docs/how_many_subdomains.md``.
DOFS = 2000

#: Rounds in which splinters join neighbouring parts; one is nearly always enough.
ROUNDS = 5


@dataclass(frozen=True, slots=True)
class Decomposition:
    """The subdomain of each owned cell."""

    mesh: dolfinx.mesh.Mesh  #: The mesh.
    subdomain: Indices  #: That of each owned cell, from 0 on each process, (n_cells,).
    count: int  #: Number of subdomains of this process.
    first: int  #: Number of the first of them in the numbering over all processes.


@dataclass(frozen=True, slots=True)
class TornSpace:
    """A function space and its torn counterpart."""

    V: dolfinx.fem.FunctionSpace  # the user's
    V_torn: dolfinx.fem.FunctionSpace  # same mesh and element, torn dofs, on this process alone
    dof: Indices  # local dof (block) of V behind each torn dof (block), (n_blocks,)
    to_global: Numbers  # its global number, (n_blocks,)


def suggested_number(V: dolfinx.fem.FunctionSpace, least: int = 1) -> int:
    """Suggest a number of subdomains over all processes: one for some 2000 dofs, as many on each.

    Within a fifth of the best of nearly all measured bodies (``docs/how_many_subdomains.md``). They
    are at least ``least``, as far as there are cells.
    """
    dofs = V.dofmap.index_map.size_global * V.dofmap.index_map_bs
    topology, processes = V.mesh.topology, V.mesh.comm.size
    cells = topology.index_map(topology.dim).size_global
    return int(min(max(processes * max(1, round(dofs / (DOFS * processes))), least), cells))


@event("FETITear")
def decompose(
    mesh: dolfinx.mesh.Mesh, subdomains: int | Integers, *, seed: int = 0
) -> Decomposition:
    """Cut the mesh into subdomains, in the same way in every run.

    A part that is not connected through facets becomes several subdomains if it is given; of a
    number of parts the splinters, all components but the largest, join their neighbours.

    Args:
        mesh: The mesh, on any number of processes.
        subdomains: Their number over all processes (shared out in proportion to the cells, at
            least one per process), or the part of each owned cell, (n_cells,), of an integer type.
        seed: Zero, or another number for another decomposition: the partitioner then counts the
            cells from one that is drawn with it. Without effect on given parts.

    Raises:
        ValueError: The number of subdomains, the parts, or the seed are out of range, or the parts
            are not those of the cells. Collective; raises on all processes.
        TypeError: The parts are no integers.
    """
    comm, n_cells = mesh.comm, mesh.topology.index_map(mesh.topology.dim).size_local
    cells = np.array(comm.allgather(n_cells), dtype=np.int64)
    on_all(lambda: _check(subdomains, seed, cells, comm.rank), comm)
    graph = compat.facet_graph(mesh.topology, n_cells)
    if isinstance(subdomains, (int, np.integer)):
        part = _partition(graph, int(_shares(int(subdomains), cells)[comm.rank]), seed)
        part = _join_splinters(graph, part)
    else:
        part = _numbered(subdomains)
    subdomain = _facet_components(graph, part)
    count = int(subdomain.max(initial=-1)) + 1
    return Decomposition(mesh, subdomain, count, comm.scan(count) - count)


@event("FETITear")
def tear(V: dolfinx.fem.FunctionSpace, decomposition: Decomposition) -> TornSpace:
    """Give every subdomain its own copy of the dofs of V, scalar or blocked."""
    cells = V.dofmap.list
    owned = cells[: len(decomposition.subdomain)]
    n_dofs = V.dofmap.index_map.size_local + V.dofmap.index_map.num_ghosts
    pair = decomposition.subdomain[:, None].astype(np.int64) * n_dofs + owned
    copies, torn = np.unique(pair, return_inverse=True)
    table = np.zeros(cells.shape, dtype=np.int32)  # cells of other processes are never assembled
    table[: len(owned)] = torn.reshape(owned.shape)
    dof = (copies % n_dofs).astype(np.int32) if n_dofs else copies.astype(np.int32)
    V_torn = compat.create_function_space(V, table, len(copies))
    to_global = V.dofmap.index_map.local_to_global(dof)
    return TornSpace(V, V_torn, dof, to_global)


def cell_sizes(space: TornSpace, n_cells: int) -> Array:
    """Return the greatest diameter of the cells around each torn dof, (n_torn,)."""
    mesh, dofmap = space.V.mesh, space.V_torn.dofmap
    h = mesh.h(mesh.topology.dim, np.arange(n_cells, dtype=np.int32))
    size = np.zeros(len(space.dof))
    np.maximum.at(size, dofmap.list[:n_cells], h[:, None])
    return np.repeat(size, dofmap.index_map_bs)


def _check(subdomains: int | Integers, seed: int, cells: Numbers, rank: int) -> None:
    """Refuse subdomains and a seed that do not fit the cells of each process, (processes,)."""
    if not isinstance(seed, (int, np.integer)) or seed < 0:
        raise ValueError(f"seed is {seed!r}: give zero or a positive integer.")
    part = np.asarray(subdomains)
    if isinstance(subdomains, (int, np.integer)):
        if not 1 <= subdomains <= cells.sum():
            raise ValueError(
                f"subdomains is {subdomains}, but the mesh has {cells.sum()} cells: "
                "choose a number between one and the number of cells, or refine the mesh."
            )
    elif not np.issubdtype(part.dtype, np.integer):
        raise TypeError(
            f"subdomains is an array of type {part.dtype}: give integers, one part per owned cell."
        )
    elif part.shape != (cells[rank],):
        raise ValueError(
            f"subdomains has shape {part.shape} on process {rank}, which owns {cells[rank]} "
            "cells: give one part per owned cell on every process."
        )
    elif part.min(initial=0) < 0:
        raise ValueError(
            f"subdomains has a cell in part {part.min()}: number the parts from zero on."
        )


def _numbered(labels: Integers) -> Indices:
    """Number the labels of cells from 0 on, in their order, (n_cells,)."""
    return np.unique(labels, return_inverse=True)[1].astype(np.int32).reshape(-1)


def _shares(subdomains: int, cells: Numbers) -> Numbers:
    """Return each process's number of subdomains, in proportion to its cells, (processes,).

    Those that are left over by rounding down go to the largest remainders.
    """
    due = subdomains * cells / cells.sum()
    shares = np.floor(due).astype(np.int64)
    shares[np.argsort(shares - due, kind="stable")[: subdomains - shares.sum()]] += 1
    return np.minimum(np.maximum(shares, 1), cells)


def _partition(graph: scipy.sparse.csr_array, parts: int, seed: int) -> Indices:
    """Cut the graph into balanced parts with dolfinx's partitioner."""
    n_cells = graph.shape[0]
    if parts <= 1:
        return np.zeros(n_cells, dtype=np.int32)
    if parts == n_cells:
        return np.arange(n_cells, dtype=np.int32)
    first = np.random.default_rng(seed).integers(1, n_cells) if seed else 0
    cell = np.roll(np.arange(n_cells), first)
    rolled = graph[cell][:, cell]
    rolled.sort_indices()
    links = compat.adjacency(rolled.indices.astype(np.int64), rolled.indptr.astype(np.int32))
    part = np.empty(n_cells, dtype=np.int32)
    part[cell] = dolfinx.graph.partitioner()(MPI.COMM_SELF, parts, links, False).array
    return _numbered(part)


def _join_splinters(graph: scipy.sparse.csr_array, part: Indices) -> Indices:
    """Move each splinter to the neighbouring part with which it shares the most facets."""
    links = graph.tocoo()
    for _ in range(ROUNDS):
        piece = _facet_components(graph, part)
        size, owner = np.bincount(piece), part[np.unique(piece, return_index=True)[1]]
        order = np.lexsort((-size, owner))
        splinter = np.ones(len(size), dtype=bool)
        splinter[order[np.unique(owner[order], return_index=True)[1]]] = False  # the largest stay
        piece_of, part_of = piece[links.row], part[links.col]
        across = splinter[piece_of] & (owner[piece_of] != part_of)
        facets = scipy.sparse.csr_array(
            (np.ones(np.count_nonzero(across)), (piece_of[across], part_of[across])),
            shape=(len(size), len(size)),
        )
        touching = np.flatnonzero(np.diff(facets.indptr))
        if not len(touching):
            break
        owner[touching] = facets[touching].argmax(axis=1).ravel()
        part = owner[piece]
    return part


def _facet_components(graph: scipy.sparse.csr_array, part: Indices) -> Indices:
    """Number the facet-connected components of all parts, in the order of the parts."""
    links = graph.tocoo()
    inside = part[links.row] == part[links.col]
    pieces = scipy.sparse.coo_array(
        (links.data[inside], (links.row[inside], links.col[inside])), shape=graph.shape
    )
    _, label = scipy.sparse.csgraph.connected_components(pieces, directed=False)
    order = part.astype(np.int64) * (label.max(initial=0) + 1) + label
    return _numbered(order)
