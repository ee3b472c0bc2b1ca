# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A wall as arrays of one process, as files and mesh generators have it, and its distribution.

PETSc's log shows the phases ``WallPartition`` and ``WallTags``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from mpi4py import MPI

import numpy as np

import basix.ufl
import dolfinx
import dolfinx.io
import ufl

from dolfinx_feti.runtime.arrays import Array, Numbers
from dolfinx_feti.runtime.collective import on_root_only
from dolfinx_feti.runtime.events import event
from dolfinx_feti.runtime.scotch import repeatable_partitions
from dolfinx_feti.wall.checks import CELLS
from dolfinx_feti.wall.wall import Wall

__all__ = ["WallArrays", "create_on_root", "distribute"]


@dataclass(frozen=True, slots=True)
class WallArrays:
    """A wall that is not distributed: points, cells and tagged facets.

    One process has all of it.

    Attributes:
        points: Coordinates, (n, 3), in millimetres or in the unit of a file.
        cells: Nodes of the cells in dolfinx's order, (m, nodes); ``checks.CELLS`` lists the types.
        cell_tags: Tag of the layer of each cell, (m,).
        facets: Nodes of the tagged facets in dolfinx's order, (k, nodes of a facet).
        facet_tags: Tag of the surface of each of these facets, (k,).
        layer_names: Tags of the layers by name.
        surface_names: Tags of the surfaces by name.
    """

    points: Array
    cells: Numbers
    cell_tags: Numbers
    facets: Numbers
    facet_tags: Numbers
    layer_names: dict[str, int]
    surface_names: dict[str, int]


def create_on_root(create: Callable[[], WallArrays], comm: MPI.Comm) -> WallArrays:
    """Create a wall on the first process; the others get its names, without points and cells.

    Args:
        create: Creates the wall; called on the first process only.
        comm: Communicator.

    Returns:
        Arrays for :func:`distribute`.

    Raises:
        Exception: The error of ``create``, on all processes.

    Note:
        Collective.
    """
    on_first = on_root_only(create, comm)
    empty: WallArrays | None = None
    if on_first is not None:
        empty = replace(
            on_first,
            points=on_first.points[:0],
            cells=on_first.cells[:0],
            cell_tags=on_first.cell_tags[:0],
            facets=on_first.facets[:0],
            facet_tags=on_first.facet_tags[:0],
        )
    empty_on_all: WallArrays = comm.bcast(empty, root=0)
    return empty_on_all if on_first is None else on_first


def distribute(arrays: WallArrays, comm: MPI.Comm, *, scale: float = 1.0) -> Wall:
    """Create the distributed mesh and the tags of a wall. Collective.

    The arrays are not checked. ``read_wall`` checks those of a file (``checks``); a mesh generator
    tests its own.

    Args:
        arrays: The wall on the first process, and one without cells and facets on the others, see
            :func:`create_on_root`.
        comm: Communicator of the mesh.
        scale: Number of millimetres in the unit of the points.
    """
    used = np.unique(arrays.cells)
    number = np.full(len(arrays.points), -1)  # points of no cell have no number
    number[used] = np.arange(len(used))
    cells = number[arrays.cells]
    facets = number[arrays.facets]
    cell_type = CELLS[arrays.cells.shape[1]]
    element = basix.ufl.element(
        "Lagrange", cell_type.shape, cell_type.order, shape=(3,), dtype=np.float64
    )
    with event("WallPartition"), repeatable_partitions():
        x = scale * arrays.points[used]
        mesh = dolfinx.mesh.create_mesh(comm, cells, x=x, e=ufl.Mesh(element))
    with event("WallTags"):
        cell_tags = _distribute_tags(mesh, 3, cells, arrays.cell_tags)
        facet_tags = _distribute_tags(mesh, 2, facets, arrays.facet_tags)
    return Wall(mesh, cell_tags, facet_tags, arrays.layer_names, arrays.surface_names)


def _distribute_tags(
    mesh: dolfinx.mesh.Mesh, dim: int, entities: Numbers, values: Numbers
) -> dolfinx.mesh.MeshTags:
    """Distribute the tags of cells or facets. Collective.

    Args:
        mesh: The mesh.
        dim: 3 for cells, 2 for facets.
        entities: Nodes of the entities, by their numbers in the input of the mesh, (n, nodes).
        values: Their tags, (n,).
    """
    entities = np.ascontiguousarray(entities)
    mesh.topology.create_entities(dim)
    local, local_values = dolfinx.io.distribute_entity_data(
        mesh, dim, entities, values.astype(np.int32)
    )
    mesh.topology.create_connectivity(dim, 0)
    mesh.topology.create_connectivity(dim, 3)
    links = dolfinx.graph.adjacencylist(local)
    return dolfinx.mesh.meshtags_from_entities(mesh, dim, links, local_values.astype(np.int32))
