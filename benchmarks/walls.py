# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Walls from a file, which is generated first if it is not there yet."""

from __future__ import annotations

from pathlib import Path

from mpi4py import MPI

from dolfinx_feti.collective import on_first
from dolfinx_feti.wall import Wall, read_wall
from dolfinx_feti.wall.wallfile import read_raw_wall
from meshes.tube import create_tube
from meshes.vessel import create_vessel
from meshes.wall_mesh import Quality, WallMesh, measure_quality

__all__ = ["CREATE", "create_wall"]

CREATE = {"vessel": create_vessel, "tube": create_tube}


def create_wall(
    source: str | Path, comm: MPI.Comm, *, size: float | None, folder: Path
) -> tuple[Wall, Quality]:
    """Read a wall; generate it first if its file is not there yet.

    Args:
        source: `vessel` or `tube`, or the path of a file.
        comm: Communicator of the mesh.
        size: Length of the elements' edges [mm]; None for the generator's default.
        folder: Where generated walls are kept.

    Returns:
        The wall, and the quality of its elements.

    Raises:
        Exception: Whatever the generator or the reader finds wrong, on all processes.

    Note:
        Collective.
    """
    path, quality = on_first(lambda: _prepare(source, size, folder), comm)
    return read_wall(path, comm), quality


def _prepare(source: str | Path, size: float | None, folder: Path) -> tuple[Path, Quality]:
    """Return the wall's file, generated if it is not there yet, and its elements' quality."""
    path = Path(source)
    if source in CREATE:
        path = folder / (f"{source}.msh" if size is None else f"{source}_{size:g}.msh")
        if not path.is_file():
            CREATE[source](path, **({} if size is None else {"size": size}))
    raw = read_raw_wall(path)
    mesh = WallMesh(raw.points, raw.cells, raw.layers, raw.facets, raw.surfaces)
    return path, measure_quality(mesh)
