# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A wall from a mesh and its tags, such as dolfinx makes of a Gmsh model in memory.

Names are those of the physical groups: with dolfinx 0.9 the model still has them, from 0.10 on they
come along with the mesh. A mesh of another origin has tags that are named by hand.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import replace
from typing import Protocol

from mpi4py import MPI

import numpy as np

import dolfinx

from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.wall.wall import Group, Groups, Wall, checked_groups, named_tags

__all__ = ["create_wall"]


class Model(Protocol):
    """What is asked of ``gmsh.model``."""

    def getPhysicalGroups(self) -> list[tuple[int, int]]:  # noqa: N802
        """Return dimension and tag of each group."""

    def getPhysicalName(self, dim: int, tag: int) -> str:  # noqa: N802
        """Return the name of a group."""


def create_wall(
    mesh: dolfinx.mesh.Mesh,
    cell_tags: dolfinx.mesh.MeshTags | None,
    facet_tags: dolfinx.mesh.MeshTags,
    names: Groups | Model | None = None,
) -> Wall:
    """Make a wall of a mesh and its tags. Collective.

    The first three arguments are the first three things that dolfinx's ``model_to_mesh`` returns::

        wall = create_wall(*gmshio.model_to_mesh(gmsh.model, comm, 0), gmsh.model)  # dolfinx 0.9

        data = dolfinx.io.gmsh.model_to_mesh(gmsh.model, comm, 0)  # from 0.10 on
        wall = create_wall(*data[:3], data.physical_groups)

    Args:
        mesh: Tetrahedra or hexahedra [mm].
        cell_tags: The layer of each cell; None for one layer, called ``wall``.
        facet_tags: Surfaces.
        names: Dimension and tag of each name, such as ``{"lumen": (2, 3), "media": (3, 1)}``; or
            ``gmsh.model``, as long as it is open on one of the processes. Other tags are called
            ``layer_7`` and ``surface_7``; a 0 without a name counts as no tag.

    Raises:
        TypeError: An argument is no mesh, or no tags.
        ValueError: Tags are of another dimension or mesh, a cell has none, no facet has one, or
            ``names`` are something else. On all processes.
    """
    cells = _one_layer(mesh) if cell_tags is None else cell_tags
    wall = Wall(mesh, cells, facet_tags, layers={}, surfaces={})  # checks them
    for dim in (0, 3):
        mesh.topology.create_connectivity(2, dim)
    groups = _groups(names, mesh.comm)
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
    dim = mesh.topology.dim
    cells = mesh.topology.index_map(dim)
    everywhere = np.arange(cells.size_local + cells.num_ghosts, dtype=np.int32)
    return dolfinx.mesh.meshtags(mesh, dim, everywhere, np.ones_like(everywhere))


def _groups(names: Groups | Model | None, comm: MPI.Comm) -> list[Group]:
    """Return the groups of all processes; those of a model from one that has it open."""
    mine = on_all(lambda: _known(names), comm)
    known = [groups for groups in comm.allgather(mine) if groups is not None]
    if not known and comm.allreduce(names is not None, op=MPI.LOR):
        raise ValueError(
            "names is a Gmsh model that no process has open: call create_wall before "
            "gmsh.finalize(), or give dimension and tag of each name."
        )
    return known[0] if known else []


def _known(names: Groups | Model | None) -> list[Group] | None:
    """Return the groups that this process knows; None if it was given none, or a closed model."""
    if names is None:
        return None
    if not isinstance(names, Mapping):
        if not hasattr(names, "getPhysicalGroups"):
            raise ValueError(
                f"names is {names!r}: give gmsh.model, or dimension and tag of each name as in "
                "{'lumen': (2, 3)}."
            )
        if not importlib.import_module(names.__module__).isInitialized():
            return None
        groups = [(names.getPhysicalName(*pair), *pair) for pair in names.getPhysicalGroups()]
        return [group for group in groups if group[0]]
    return checked_groups(names)


def _named(groups: list[Group], tags: dolfinx.mesh.MeshTags, comm: MPI.Comm) -> dict[str, int]:
    """Return the names of all tags that occur, but for 0. Collective."""
    present = {int(tag) for part in comm.allgather(np.unique(tags.values)) for tag in part}
    return named_tags(
        {name: tag for name, dim, tag in groups if dim == tags.dim}, present, tags.dim
    )
