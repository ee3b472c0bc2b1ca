# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Walls from files, of any format, distributed to all processes.

PETSc's log shows the phases: ``WallRead``, ``WallPartition`` (the mesh is distributed) and
``WallTags`` (layers and surfaces are).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from mpi4py import MPI

import numpy as np

import basix.ufl
import dolfinx
import dolfinx.io
import ufl

from dolfinx_feti.mechanics.values import require_positive
from dolfinx_feti.runtime.arrays import Numbers
from dolfinx_feti.runtime.collective import on_first
from dolfinx_feti.runtime.events import event
from dolfinx_feti.wall.checks import CELLS, check_cells, check_faces, check_rows
from dolfinx_feti.wall.wall import Group, Groups, Wall, checked_groups
from dolfinx_feti.wall.wallfile import RawWall, read_raw_wall
from dolfinx_feti.wall.xdmf import is_parallel, read_parallel

__all__ = ["distribute", "read_wall"]


def read_wall(
    path: Path | str, comm: MPI.Comm, *, scale: float = 1.0, names: Groups | None = None
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
    require_positive(scale=scale)
    path = Path(path)
    if on_first(lambda: path.is_file() and is_parallel(path), comm):
        return read_parallel(path, comm, scale=scale)
    read: list[RawWall] = []  # on the first process
    with event("WallRead"):
        on_first(
            lambda: read.append(_renamed(read_raw_wall(path), checked_groups(names or {}))), comm
        )
        raw = _share(read[0] if read else None, comm)
        check_rows(path, raw.points, raw.cells, [raw.facets], comm)
        check_faces(path, raw.cells, raw.facets, comm)
    wall = distribute(raw, comm, scale=scale)
    check_cells(path, wall, alike=True)
    return wall


def _renamed(raw: RawWall, groups: Sequence[Group]) -> RawWall:
    """Give names to numbers, in place of those of the file."""

    def named(dim: int, tags: Numbers, theirs: dict[str, int]) -> dict[str, int]:
        mine = {name: tag for name, of, tag in groups if of == dim}
        both = {n: t for n, t in theirs.items() if t not in mine.values()} | mine
        return {name: tag for name, tag in both.items() if np.any(tags == tag)}

    layers = named(3, raw.layers, raw.layer_names)
    return replace(raw, layer_names=layers, surface_names=named(2, raw.surfaces, raw.surface_names))


def _share(raw: RawWall | None, comm: MPI.Comm) -> RawWall:
    """Return what a process has of a wall, nothing but the names unless it has read it."""
    empty = None
    if raw is not None:
        names = ("points", "cells", "layers", "facets", "surfaces")
        empty = replace(raw, **{name: getattr(raw, name)[:0] for name in names})
    none: RawWall = comm.bcast(empty, root=0)
    return none if raw is None else raw


def distribute(raw: RawWall | None, comm: MPI.Comm, *, scale: float = 1.0) -> Wall:
    """Create the distributed mesh and its tags of a wall that the first process has. Collective.

    ``scale`` is the number of millimetres in the unit of its points.
    """
    raw = _share(raw, comm)
    used, number = np.unique(raw.cells), np.full(len(raw.points), -1)
    number[used] = np.arange(len(used))  # without the points of no cell
    cells, facets = number[raw.cells], number[raw.facets]
    cell, order, _ = CELLS[raw.cells.shape[1]]
    element = basix.ufl.element("Lagrange", cell, order, shape=(3,), dtype=np.float64)
    with event("WallPartition"):
        x = scale * raw.points[used]
        mesh = dolfinx.mesh.create_mesh(comm, cells, x=x, e=ufl.Mesh(element))
    with event("WallTags"):
        layers, surfaces = _tags(mesh, 3, cells, raw.layers), _tags(mesh, 2, facets, raw.surfaces)
    return Wall(mesh, layers, surfaces, raw.layer_names, raw.surface_names)


def _tags(
    mesh: dolfinx.mesh.Mesh, dim: int, entities: Numbers, values: Numbers
) -> dolfinx.mesh.MeshTags:
    """Distribute the tags of entities, each given by its points in the file."""
    entities, values = np.ascontiguousarray(entities), values.astype(np.int32)
    mesh.topology.create_entities(dim)
    local, local_values = dolfinx.io.distribute_entity_data(mesh, dim, entities, values)
    mesh.topology.create_connectivity(dim, 0)
    mesh.topology.create_connectivity(dim, 3)
    links = dolfinx.graph.adjacencylist(local)
    return dolfinx.mesh.meshtags_from_entities(mesh, dim, links, local_values.astype(np.int32))
