# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Walls on all processes: read from a file, which the first process generates if need be.

A generated file is one that all processes read.
"""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from mpi4py import MPI

import numpy as np

from dolfinx_feti.runtime import compat
from dolfinx_feti.runtime.collective import on_first
from dolfinx_feti.wall import Case, Clamp, Pressure, Tissue, Wall, openings, read_case, read_wall
from dolfinx_feti.wall.fibres import ANGLES
from meshes.tube import create_tube
from meshes.vessel import create_vessel
from meshes.wall_mesh import Quality, WallMesh, measure_quality

__all__ = ["CREATE", "create_tube_wall", "grow", "open_case", "open_wall", "wall_quality"]

#: Generators of walls by name.
CREATE = {"vessel": create_vessel, "tube": create_tube}


def open_wall(
    source: str | Path, comm: MPI.Comm, *, size: float | None, folder: Path, scale: float = 1.0
) -> tuple[Wall, Quality]:
    """Read a wall; generate it first if its file is not there yet.

    Args:
        source: `vessel` or `tube`, or the path of a file.
        comm: Communicator of the mesh.
        size: Length of the elements' edges [mm]; None for the generator's default.
        folder: Where generated walls are kept.
        scale: Millimetres in the unit of length of a file.

    Returns:
        The wall, and the quality of its elements.

    Raises:
        Exception: Whatever the generator or the reader finds wrong, on all processes.

    Note:
        Collective.
    """
    path = on_first(lambda: _prepare(source, size, folder), comm)
    wall = read_wall(path, comm, scale=scale)
    return wall, wall_quality(wall)


def open_case(
    file: Path | None, mesh: str | Path, comm: MPI.Comm, *, size: float | None, folder: Path
) -> tuple[Case, Wall, Quality]:
    """Read a case and its wall; without a file, an artery with a mesh under 10 mmHg.

    Args:
        file: A TOML file of a wall (``docs/cases.md``), or None.
        mesh: The source of a wall without a file, as in :func:`open_wall`.
        comm: Communicator of the mesh.
        size: Length of the elements' edges [mm]; None for the generator's default.
        folder: Where generated walls are kept.

    Raises:
        Exception: Whatever is wrong with the file or the wall, on all processes.

    Note:
        Collective.
    """
    case, scale = None if file is None else read_case(file, comm), 1.0
    if case is not None:
        mesh = case.mesh if case.mesh in CREATE else file.parent / case.mesh
        scale = case.scale
    wall, quality = open_wall(mesh, comm, size=size, folder=folder, scale=scale)
    if case is None:
        angles = {name: angle for name, angle in ANGLES.items() if name in wall.layers}
        case = Case(
            mesh=str(mesh),
            layers={name: Tissue(3.0, 2.3632, 0.8393, angle) for name, angle in angles.items()},
            conditions={"lumen": (Pressure(),)} | {name: (Clamp(),) for name in openings(wall)},
            pressure=10.0,
        )
    case.check(wall)
    return case, wall, quality


def create_tube_wall(comm: MPI.Comm, **geometry: object) -> Wall:
    """Mesh a tube, see :func:`meshes.tube.create_tube` and :func:`grow`. Collective."""
    return grow(lambda path: create_tube(path, **geometry), comm)


def grow(write: Callable[[Path], object], comm: MPI.Comm) -> Wall:
    """Mesh a wall on the first process and distribute it, without a file that stays.

    Args:
        write: Generates an XDMF file.
        comm: Communicator of the mesh.

    Raises:
        Exception: Whatever the generator finds wrong, on all processes.

    Note:
        Collective.
    """
    with ExitStack() as until_read:

        def write_beside() -> Path:
            folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
            path = Path(until_read.enter_context(folder)) / "wall.xdmf"
            write(path)
            return path

        return read_wall(on_first(write_beside, comm), comm)


def wall_quality(wall: Wall) -> Quality:
    """Return the quality of a wall's tetrahedra; of curved ones, that of their corners.

    Args:
        wall: The wall, of tetrahedra.

    Note:
        Collective.
    """
    mesh = wall.mesh
    nodes = compat.geometry_dofmap(mesh)[: mesh.topology.index_map(3).size_local, :4]
    none = np.zeros(0, dtype=np.int64)
    own = WallMesh(mesh.geometry.x, nodes, none, none, none)
    parts = [part for part in mesh.comm.allgather(measure_quality(own)) if part.cells]
    cells = sum(part.cells for part in parts)
    return Quality(
        points=mesh.geometry.index_map().size_global,
        cells=cells,
        minimum=min(part.minimum for part in parts),
        mean=sum(part.cells * part.mean for part in parts) / cells,
        histogram=tuple(np.sum([part.histogram for part in parts], axis=0).tolist()),
        volume=sum(part.volume for part in parts),
    )


def _prepare(source: str | Path, size: float | None, folder: Path) -> Path:
    """Return the wall's file, generated if it is not there yet as the generators would make it."""
    if source not in CREATE:
        return Path(source)
    path = folder / (f"{source}.xdmf" if size is None else f"{source}_{size:g}.xdmf")
    sources = b"".join(file.read_bytes() for file in sorted(Path(__file__).parent.glob("*.py")))
    stamp, made_by = path.with_suffix(".sha256"), hashlib.sha256(sources + repr(size).encode())
    whole = all(file.is_file() for file in (path, path.with_suffix(".h5"), stamp))
    if not (whole and stamp.read_text() == made_by.hexdigest()):
        CREATE[str(source)](path, **({} if size is None else {"size": size}))
        stamp.write_text(made_by.hexdigest())
    return path
