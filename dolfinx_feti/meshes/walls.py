# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Walls on all processes: read from a file, which the first process generates if necessary.

Generated files are XDMF, which all processes read.
"""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx_feti.meshes.tube import create_tube
from dolfinx_feti.meshes.vessel import create_vessel
from dolfinx_feti.meshes.wall_mesh import Quality, WallMesh, measure_quality
from dolfinx_feti.runtime import compat
from dolfinx_feti.runtime.collective import on_root
from dolfinx_feti.wall.casefile import Case, Tissue, read_case
from dolfinx_feti.wall.conditions.condition import Condition
from dolfinx_feti.wall.conditions.prescribed import Clamp
from dolfinx_feti.wall.conditions.pressure import Pressure
from dolfinx_feti.wall.fibres import ANGLES
from dolfinx_feti.wall.wall import Wall, openings
from dolfinx_feti.wall.wallfile import read_wall

__all__ = ["CREATE", "create_tube_wall", "grow", "open_case", "open_wall", "wall_quality"]

#: Generators of walls by name: each writes a file.
CREATE: dict[str, Callable[..., Quality]] = {"vessel": create_vessel, "tube": create_tube}


def open_wall(
    source: str | Path, comm: MPI.Comm, *, size: float | None, folder: Path, scale: float = 1.0
) -> tuple[Wall, Quality]:
    """Read a wall, or generate it and keep its file for the next time.

    Args:
        source: `vessel` or `tube`, or the path of a file.
        comm: Communicator of the mesh.
        size: Length of the elements' edges [mm]; None for the generator's default.
        folder: Folder of generated walls.
        scale: Millimetres in the unit of length of a file.

    Returns:
        The wall, and the quality of its elements.

    Raises:
        Exception: The errors of the generator and of ``read_wall``, on all processes.

    Note:
        Collective.
    """
    path = on_root(lambda: _prepare(source, size, folder), comm)
    wall = read_wall(path, comm, scale=scale)
    return wall, wall_quality(wall)


def open_case(
    file: Path | None, mesh: str | Path, comm: MPI.Comm, *, size: float | None, folder: Path
) -> tuple[Case, Wall, Quality]:
    """Read a case and its wall; without a file, create the case of an artery under 10 mmHg.

    Args:
        file: A TOML file of a wall (``docs/cases.md``), or None.
        mesh: The source of a wall without a file, as in :func:`open_wall`.
        comm: Communicator of the mesh.
        size: Length of the elements' edges [mm]; None for the generator's default.
        folder: Folder of generated walls.

    Returns:
        The case, its wall, and the quality of the wall's elements.

    Raises:
        Exception: The errors of ``read_case``, :func:`open_wall` and ``Case.check``, on all
            processes.

    Note:
        Collective.
    """
    if file is None:
        wall, quality = open_wall(mesh, comm, size=size, folder=folder)
        case = artery_case(wall, str(mesh))
    else:
        case = read_case(file, comm)
        source = case.mesh if case.mesh in CREATE else file.parent / case.mesh
        wall, quality = open_wall(source, comm, size=size, folder=folder, scale=case.scale)
    case.check(wall)
    return case, wall, quality


def artery_case(wall: Wall, mesh: str) -> Case:
    """Return the case of an artery under 10 mmHg whose openings are clamped.

    Layers called media and adventitia get the media's material of a rabbit's carotid artery
    (Holzapfel, Gasser, Ogden 2000): c = 3 kPa, k₁ = 2.3632 kPa, k₂ = 0.8393.

    Args:
        wall: The wall.
        mesh: The name of its mesh for the case.
    """
    angles = {name: angle for name, angle in ANGLES.items() if name in wall.layers}
    conditions: dict[str, tuple[Condition, ...]] = {"lumen": (Pressure(),)}
    for name in openings(wall):
        conditions[name] = (Clamp(),)
    return Case(
        mesh=mesh,
        layers={name: Tissue(3.0, 2.3632, 0.8393, angle) for name, angle in angles.items()},
        conditions=conditions,
        pressure=10.0,
    )


def create_tube_wall(comm: MPI.Comm, **geometry: Any) -> Wall:
    """Create the mesh of a tube on all processes. Collective.

    Args:
        comm: Communicator of the mesh.
        geometry: Keyword arguments of :func:`dolfinx_feti.meshes.tube.create_tube`.
    """
    return grow(lambda path: create_tube(path, **geometry), comm)


def grow(write: Callable[[Path], object], comm: MPI.Comm) -> Wall:
    """Generate a wall on the first process, and distribute it by a temporary file.

    (:func:`dolfinx_feti.meshes.layers.grow` creates the arrays of such a wall.)

    Args:
        write: Generates an XDMF file.
        comm: Communicator of the mesh.

    Raises:
        Exception: The errors of the generator, on all processes.

    Note:
        Collective.
    """
    with ExitStack() as until_read:

        def write_beside() -> Path:
            folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
            path = Path(until_read.enter_context(folder)) / "wall.xdmf"
            write(path)
            return path

        return read_wall(on_root(write_beside, comm), comm)


def wall_quality(wall: Wall) -> Quality:
    """Return the quality of a wall's tetrahedra. Collective.

    Edges count as straight: a curved tetrahedron is measured by its corners.
    """
    mesh = wall.mesh
    n_owned = mesh.topology.index_map(3).size_local
    corners = compat.geometry_dofmap(mesh)[:n_owned, :4].astype(np.int64)
    points = np.asarray(mesh.geometry.x, dtype=np.float64)
    no_tags = np.zeros(0, dtype=np.int64)
    local = measure_quality(WallMesh(points, corners, no_tags, no_tags, no_tags))
    parts = [part for part in mesh.comm.allgather(local) if part.cells]
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
    """Return the path of a wall's file; generate the file if it is missing or out of date.

    The stamp beside a generated file is a digest of the generators' source and of the size.
    """
    if source not in CREATE:
        return Path(source)
    path = folder / (f"{source}.xdmf" if size is None else f"{source}_{size:g}.xdmf")
    sources = b"".join(file.read_bytes() for file in sorted(Path(__file__).parent.glob("*.py")))
    stamp = path.with_suffix(".sha256")
    digest = hashlib.sha256(sources + repr(size).encode()).hexdigest()
    is_complete = all(file.is_file() for file in (path, path.with_suffix(".h5"), stamp))
    if is_complete and stamp.read_text() == digest:
        return path
    options = {} if size is None else {"size": size}
    CREATE[str(source)](path, **options)
    stamp.write_text(digest)
    return path
