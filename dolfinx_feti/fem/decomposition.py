# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Decomposition of the mesh into subdomains, and the torn function space.

.. math:: \overline Ω_0 = \bigcup_i \overline Ω_{0,i}

(eq. 30 of the paper). Each process partitions its cells; every subdomain is connected through
facets. Tearing is a second dof map on the same mesh and element. Its dofs are the pairs (subdomain,
dof) that occur, numbered subdomain by subdomain. So dolfinx assembles a form on the torn space into
the block-diagonal K of all subdomains.

Dofs are counted in blocks: n_blocks torn blocks of bs dofs each are n_torn = n_blocks · bs torn
dofs of this process.
"""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
import scipy.sparse
import scipy.sparse.csgraph

import dolfinx

from dolfinx_feti.runtime import compat
from dolfinx_feti.runtime.arrays import Array, Indices, Integers, Mask, Numbers
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.runtime.events import event
from dolfinx_feti.runtime.scotch import repeatable_partitions

#: Dofs of a subdomain if the user gives no number, measured in ``docs/how_many_subdomains.md``.
DOFS_PER_SUBDOMAIN = 2000

#: Upper bound of the rounds in which splinters join neighbouring parts. One is nearly always
#: enough; a second one is needed if a splinter has only splinters as neighbours.
MAX_JOIN_ROUNDS = 5


@dataclass(frozen=True, slots=True)
class Decomposition:
    """The subdomain of each owned cell."""

    mesh: dolfinx.mesh.Mesh  #: The mesh.
    subdomain: Indices  #: That of each owned cell, from 0 on each process, (n_cells,).
    count: int  #: Number of subdomains of this process.
    first: int  #: Number of the first of them in the numbering over all processes.


@dataclass(frozen=True, slots=True)
class TornSpace:
    """A function space and its torn counterpart.

    Attributes:
        V: The user's space.
        V_torn: Space with the same mesh and element and the torn dofs of this process.
        local_block: Block of V on this process that each torn block is a copy of, (n_blocks,).
        global_block: The number of that block over all processes, (n_blocks,).
    """

    V: dolfinx.fem.FunctionSpace
    V_torn: dolfinx.fem.FunctionSpace
    local_block: Indices
    global_block: Numbers


def suggested_number(V: dolfinx.fem.FunctionSpace, minimum: int = 1) -> int:
    """Return a number of subdomains over all processes, some 2000 dofs for each. Not collective.

    It is a multiple of the number of processes, unless ``minimum`` or the number of cells decides.
    ``docs/how_many_subdomains.md`` has the bodies and times that were measured: solves took at most
    a fifth longer than with the best number, with few exceptions.

    Args:
        V: The space.
        minimum: Lower bound of the number, if there are as many cells.
    """
    dofs = V.dofmap.index_map.size_global * V.dofmap.index_map_bs
    topology = V.mesh.topology
    processes = V.mesh.comm.size
    cells = topology.index_map(topology.dim).size_global
    per_process = max(1, round(dofs / (DOFS_PER_SUBDOMAIN * processes)))
    return int(min(max(processes * per_process, minimum), cells))


@event("FETITear")
def decompose(
    mesh: dolfinx.mesh.Mesh, subdomains: int | Integers, *, seed: int = 0
) -> Decomposition:
    """Cut the mesh into subdomains, in the same way in every run. Collective.

    A part of the user that is not connected through facets becomes several subdomains. A part of
    the partitioner keeps its largest connected component; its other components, called splinters,
    join neighbouring parts.

    Args:
        mesh: The mesh, on any number of processes.
        subdomains: Number over all processes (divided in proportion to the cells, at least one for
            each process), or the part of each owned cell, (n_cells,), of an integer type.
        seed: Zero, or another number for another decomposition: cells are then passed to the
            partitioner in cyclic order from a random first cell. Parts of the user do not depend on
            it.

    Returns:
        The subdomain of each owned cell.

    Raises:
        ValueError: The number of subdomains, the parts, or the seed are out of range, or the parts
            are not one for each cell; on all processes.
        TypeError: The parts are no integers; on all processes.
    """
    comm = mesh.comm
    n_cells = mesh.topology.index_map(mesh.topology.dim).size_local
    cells = np.array(comm.allgather(n_cells), dtype=np.int64)
    on_all(lambda: _check_arguments(subdomains, seed, cells, comm.rank), comm)
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
    """Return the torn space of V, with a copy of its dofs for every subdomain. No communication.

    Args:
        V: A scalar or blocked space.
        decomposition: Subdomain of each cell.
    """
    cells = V.dofmap.list
    owned = cells[: len(decomposition.subdomain)]
    n_blocks = V.dofmap.index_map.size_local + V.dofmap.index_map.num_ghosts
    pair = decomposition.subdomain[:, None].astype(np.int64) * n_blocks + owned
    copies, torn = np.unique(pair, return_inverse=True)
    table = np.zeros(cells.shape, dtype=np.int32)  # cells of other processes are never assembled
    table[: len(owned)] = torn.reshape(owned.shape)
    # a process without dofs has no copies, and NumPy warns of a division by zero
    local_block = (copies % n_blocks).astype(np.int32) if n_blocks else copies.astype(np.int32)
    V_torn = compat.create_function_space(V, table, len(copies))
    global_block = V.dofmap.index_map.local_to_global(local_block)
    return TornSpace(V, V_torn, local_block, global_block)


def cell_sizes(space: TornSpace) -> Array:
    """Return the largest diameter of the owned cells around each torn dof [mm], (n_torn,)."""
    mesh = space.V.mesh
    dofmap = space.V_torn.dofmap
    n_cells = mesh.topology.index_map(mesh.topology.dim).size_local
    h = mesh.h(mesh.topology.dim, np.arange(n_cells, dtype=np.int32))
    size = np.zeros(len(space.local_block))
    np.maximum.at(size, dofmap.list[:n_cells], h[:, None])
    return np.repeat(size, dofmap.index_map_bs)


def _check_arguments(subdomains: int | Integers, seed: int, cells: Numbers, rank: int) -> None:
    """Check the arguments of :func:`decompose` on this process.

    Args:
        subdomains: Number, or the part of each cell.
        seed: The seed.
        cells: Owned cells of each process, (processes,).
        rank: This process.

    Raises:
        ValueError: One is out of range, or there is not one part for each cell.
        TypeError: The parts are no integers.
    """
    if not isinstance(seed, (int, np.integer)) or seed < 0:
        raise ValueError(f"seed is {seed!r}: give zero or a positive integer.")
    part = np.asarray(subdomains)
    if isinstance(subdomains, (int, np.integer)):
        if not 1 <= subdomains <= cells.sum():
            raise ValueError(
                f"subdomains is {subdomains}, but the mesh has {cells.sum()} cells: "
                "choose a number between one and the number of cells, or refine the mesh."
            )
    elif part.ndim == 0:
        raise TypeError(
            f"subdomains is {subdomains!r}: give a whole number, or one part per owned cell."
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
    """Return the labels of cells renumbered from 0 on, in the same order, (n_cells,)."""
    return np.unique(labels, return_inverse=True)[1].astype(np.int32).reshape(-1)


def _shares(subdomains: int, cells: Numbers) -> Numbers:
    """Return the number of subdomains of each process, in proportion to its cells, (processes,).

    Shares are rounded down; the remaining subdomains go to the largest remainders. A process with
    cells gets at least one, so that the sum may exceed ``subdomains``.
    """
    exact = subdomains * cells / cells.sum()
    shares = np.floor(exact).astype(np.int64)
    by_remainder = np.argsort(shares - exact, kind="stable")
    shares[by_remainder[: subdomains - shares.sum()]] += 1
    return np.minimum(np.maximum(shares, 1), cells)


def _partition(graph: scipy.sparse.csr_array, parts: int, seed: int) -> Indices:
    """Return the part of each cell, (n_cells,), by dolfinx's graph partitioner.

    Args:
        graph: Cells that share a facet, (n_cells, n_cells).
        parts: Number of parts.
        seed: Zero, or a number that determines which cell is the first one.
    """
    n_cells = graph.shape[0]
    if parts <= 1:
        return np.zeros(n_cells, dtype=np.int32)
    if parts == n_cells:
        return np.arange(n_cells, dtype=np.int32)
    first = 0
    if seed:
        first = np.random.default_rng(seed).integers(1, n_cells)
    cell = np.roll(np.arange(n_cells), first)
    rolled = graph[cell][:, cell]
    rolled.sort_indices()  # the parts must not depend on the order of SciPy's product
    links = compat.adjacency(rolled.indices.astype(np.int64), rolled.indptr.astype(np.int32))
    part = np.empty(n_cells, dtype=np.int32)
    with repeatable_partitions():
        part[cell] = dolfinx.graph.partitioner()(MPI.COMM_SELF, parts, links, False).array
    return _numbered(part)


def _join_splinters(graph: scipy.sparse.csr_array, part: Indices) -> Indices:
    """Return parts in which each splinter has joined the part it shares the most facets with.

    Args:
        graph: Cells that share a facet, (n_cells, n_cells).
        part: Part of each cell, (n_cells,).

    Returns:
        The new part of each cell, (n_cells,).
    """
    for _ in range(MAX_JOIN_ROUNDS):
        component = _facet_components(graph, part)
        _, first_cell = np.unique(component, return_index=True)
        part_of_component = part[first_cell]
        is_splinter = _is_splinter(component, part_of_component)
        facets = _facets_to_other_parts(graph, part, component, part_of_component)
        touches_part = np.diff(facets.indptr) > 0
        joining = np.flatnonzero(is_splinter & touches_part)
        if not len(joining):
            break
        part_of_component[joining] = facets[joining].argmax(axis=1).ravel()
        part = part_of_component[component]
    return part


def _is_splinter(component: Indices, part_of_component: Indices) -> Mask:
    """Return a mask of the components that are not the largest one of their part, (components,).

    Args:
        component: Connected component of each cell, (n_cells,).
        part_of_component: Part that each component belongs to, (components,).
    """
    size = np.bincount(component)
    largest_first = np.lexsort((-size, part_of_component))  # part by part
    _, first_of_part = np.unique(part_of_component[largest_first], return_index=True)
    is_splinter = np.ones(len(size), dtype=bool)
    is_splinter[largest_first[first_of_part]] = False
    return is_splinter


def _facets_to_other_parts(
    graph: scipy.sparse.csr_array, part: Indices, component: Indices, part_of_component: Indices
) -> scipy.sparse.csr_array:
    """Return the number of facets between each component and each other part, (components, parts).

    Args:
        graph: Cells that share a facet, (n_cells, n_cells).
        part: Part of each cell, (n_cells,).
        component: Connected component of each cell, (n_cells,).
        part_of_component: Part that each component belongs to, (components,).
    """
    links = graph.tocoo()
    row = component[links.row]
    column = part[links.col]
    is_between = part_of_component[row] != column
    ones = np.ones(np.count_nonzero(is_between))
    shape = (len(part_of_component), int(part.max(initial=-1)) + 1)
    return scipy.sparse.csr_array((ones, (row[is_between], column[is_between])), shape=shape)


def _facet_components(graph: scipy.sparse.csr_array, part: Indices) -> Indices:
    """Return the facet-connected component of each cell, (n_cells,), in the order of the parts."""
    links = graph.tocoo()
    is_in_part = part[links.row] == part[links.col]
    within_parts = scipy.sparse.coo_array(
        (links.data[is_in_part], (links.row[is_in_part], links.col[is_in_part])), shape=graph.shape
    )
    _, label = scipy.sparse.csgraph.connected_components(within_parts, directed=False)
    part_then_label = part.astype(np.int64) * (label.max(initial=0) + 1) + label
    return _numbered(part_then_label)
