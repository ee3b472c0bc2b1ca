# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A wall from a mesh and its tags, such as dolfinx makes of a Gmsh model in memory."""

from __future__ import annotations

from dataclasses import replace

from mpi4py import MPI

import numpy as np

import dolfinx

from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.wall.wall import Group, Groups, Wall, checked_groups, named_tags

__all__ = ["create_wall"]


def create_wall(
    mesh: dolfinx.mesh.Mesh,
    cell_tags: dolfinx.mesh.MeshTags | None,
    facet_tags: dolfinx.mesh.MeshTags,
    names: Groups | None = None,
) -> Wall:
    """Make a wall of a mesh and its tags. Collective.

    The first three arguments are the first three things that dolfinx's ``model_to_mesh`` returns,
    the last one is ``physical_groups`` of what it returns from dolfinx 0.10 on.

    Args:
        mesh: Tetrahedra or hexahedra [mm].
        cell_tags: The layer of each cell; None for one layer, called ``wall``.
        facet_tags: Surfaces.
        names: Dimension and tag of each name, such as ``{"lumen": (2, 3), "media": (3, 1)}``, from
            the first process that has any. Other tags are called ``layer_7`` and ``surface_7``; a 0
            without a name counts as no tag.

    Raises:
        TypeError: An argument is no mesh, no tags, or no names.
        ValueError: Tags are of another dimension or mesh, a cell has none, or no facet has one. On
            all processes.
    """
    cells = _one_layer(mesh) if cell_tags is None else cell_tags
    wall = Wall(mesh, cells, facet_tags, layers={}, surfaces={})  # checks them
    for dim in (0, 3):
        mesh.topology.create_connectivity(2, dim)
    known = mesh.comm.allgather(on_all(lambda: checked_groups(names or {}), mesh.comm))
    groups: list[Group] = next((found for found in known if found), [])
    if cell_tags is None:
        groups = [("wall", 3, 1), *(group for group in groups if group[1] != 3)]
    layers = _named(groups, cells, mesh.comm)
    surfaces = _named(groups, facet_tags, mesh.comm)
    n = mesh.topology.index_map(3).size_local
    owned = cells.values[cells.indices < n]
    missing = mesh.comm.allreduce(n - int(np.isin(owned, list(layers.values())).sum()))
    if missing:
        raise ValueError(f"cell_tags leave {missing} cells without a layer: tag all of them.")
    if not surfaces:
        raise ValueError("facet_tags mark no surface: tag the facets that loads and supports need.")
    return replace(wall, layers=layers, surfaces=surfaces)


def _one_layer(mesh: dolfinx.mesh.Mesh) -> dolfinx.mesh.MeshTags:
    """Tag all cells with 1."""
    cells = mesh.topology.index_map(mesh.topology.dim)
    everywhere = np.arange(cells.size_local + cells.num_ghosts, dtype=np.int32)
    return dolfinx.mesh.meshtags(mesh, mesh.topology.dim, everywhere, np.ones_like(everywhere))


def _named(groups: list[Group], tags: dolfinx.mesh.MeshTags, comm: MPI.Comm) -> dict[str, int]:
    """Return the names of all tags that occur, but for 0. Collective."""
    present = {int(tag) for part in comm.allgather(np.unique(tags.values)) for tag in part}
    return named_tags(
        {name: tag for name, dim, tag in groups if dim == tags.dim}, present, tags.dim
    )
