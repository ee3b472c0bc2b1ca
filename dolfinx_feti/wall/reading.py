# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Walls from files, of any format, distributed to all processes.

PETSc's log shows the phases: ``WallRead``, ``WallPartition`` (the mesh is distributed) and
``WallTags`` (layers and surfaces are).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from mpi4py import MPI

import numpy as np

import basix.ufl
import dolfinx
import dolfinx.io
import ufl

from dolfinx_feti.mechanics.values import require_within
from dolfinx_feti.runtime.arrays import Numbers
from dolfinx_feti.runtime.collective import on_first
from dolfinx_feti.runtime.events import event
from dolfinx_feti.wall.wall import Group, Groups, Wall, checked_groups
from dolfinx_feti.wall.wallfile import CELLS, RawWall, read_raw_wall
from dolfinx_feti.wall.xdmf import is_parallel, read_parallel

__all__ = ["distribute", "read_wall"]


def read_wall(
    path: Path | str,
    comm: MPI.Comm,
    *,
    scale: float = 1.0,
    names: Groups | None = None,
) -> Wall:
    """Read a wall: on all processes from XDMF, on one from other formats, to be distributed.

    Args:
        path: A file of :func:`~dolfinx_feti.wall.xdmf.write_wall` (`*.xdmf`), which no process
            holds as a whole; a Gmsh file (`*.msh`) with named physical groups, or a file of another
            format with cell data, see :mod:`dolfinx_feti.wall.wallfile`.
        comm: Communicator of the mesh.
        scale: Number of millimetres in the file's unit of length (1000 if that is the metre).
        names: Dimension and number of each name, as ``{"lumen": (2, 3), "media": (3, 1)}``, in a
            file that has numbers only; others are called ``layer_7`` and ``surface_7``.

    Raises:
        FileNotFoundError: There is no such file.
        ModuleNotFoundError: gmsh or meshio is needed and not installed.
        ValueError: The file does not hold a valid wall, or the scale is not positive.

    Note:
        Collective; raises on all processes or on none.
    """
    remedy = "a positive number, the millimetres in the file's unit of length"
    require_within(0.0, math.inf, {"scale": scale}, ends=False, remedy=remedy, sign="=")
    path = Path(path)
    if on_first(lambda: path.is_file() and is_parallel(path), comm):
        return read_parallel(path, comm, scale=scale)
    raw: list[RawWall] = []  # on the first process
    with event("WallRead"):
        on_first(
            lambda: raw.append(_renamed(read_raw_wall(path), checked_groups(names or {}))), comm
        )
    return distribute(raw[0] if raw else None, comm, scale=scale)


def _renamed(raw: RawWall, groups: Sequence[Group]) -> RawWall:
    """Give names to numbers, in place of those of the file."""

    def named(dim: int, tags: Numbers, theirs: dict[str, int]) -> dict[str, int]:
        mine = {name: tag for name, of, tag in groups if of == dim}
        both = {n: t for n, t in theirs.items() if t not in mine.values()} | mine
        return {name: tag for name, tag in both.items() if np.any(tags == tag)}

    layers = named(3, raw.layers, raw.layer_names)
    return replace(raw, layer_names=layers, surface_names=named(2, raw.surfaces, raw.surface_names))


def distribute(raw: RawWall | None, comm: MPI.Comm, *, scale: float = 1.0) -> Wall:
    """Create the distributed mesh and its tags of a wall that the first process has. Collective.

    ``scale`` is the number of millimetres in the unit of its points.
    """
    head = None
    if raw is not None:
        widths = raw.cells.shape[1], raw.facets.shape[1]
        head = (*widths, raw.layer_names, raw.surface_names)
    width, facet_width, layer_names, surface_names = comm.bcast(head, root=0)
    none = np.zeros(0, dtype=np.int64)
    points = np.zeros((0, 3)) if raw is None else scale * raw.points
    cells = np.zeros((0, width), dtype=np.int64) if raw is None else raw.cells
    facets = np.zeros((0, facet_width), dtype=np.int64) if raw is None else raw.facets
    cell, order = CELLS[width]
    element = basix.ufl.element("Lagrange", cell, order, shape=(3,), dtype=np.float64)
    with event("WallPartition"):
        mesh = dolfinx.mesh.create_mesh(comm, cells, x=points, e=ufl.Mesh(element))
    with event("WallTags"):
        layers = _tags(mesh, 3, cells, none if raw is None else raw.layers)
        surfaces = _tags(mesh, 2, facets, none if raw is None else raw.surfaces)
    return Wall(mesh, layers, surfaces, layer_names, surface_names)


def _tags(
    mesh: dolfinx.mesh.Mesh,
    dim: int,
    entities: Numbers,
    values: Numbers,
) -> dolfinx.mesh.MeshTags:
    """Distribute the tags of entities, each given by its points in the file."""
    entities, values = np.ascontiguousarray(entities), values.astype(np.int32)
    mesh.topology.create_entities(dim)
    local, local_values = dolfinx.io.distribute_entity_data(mesh, dim, entities, values)
    mesh.topology.create_connectivity(dim, 0)
    mesh.topology.create_connectivity(dim, 3)
    links = dolfinx.graph.adjacencylist(local)
    return dolfinx.mesh.meshtags_from_entities(mesh, dim, links, local_values.astype(np.int32))
