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

from mpi4py import MPI

import numpy as np

import basix

from dolfinx_feti.mechanics.materials import ArteryParameters
from dolfinx_feti.meshes.quality import MeshQuality, measure_hexahedra, measure_quality
from dolfinx_feti.meshes.tube import write_tube
from dolfinx_feti.meshes.vessel import write_vessel
from dolfinx_feti.runtime import compat
from dolfinx_feti.runtime.collective import on_root
from dolfinx_feti.wall.case import Case, LayerMaterial
from dolfinx_feti.wall.casefile import read_case
from dolfinx_feti.wall.conditions.condition import Condition
from dolfinx_feti.wall.conditions.prescribed import Clamp
from dolfinx_feti.wall.conditions.pressure import Pressure
from dolfinx_feti.wall.fibres import ANGLES
from dolfinx_feti.wall.wall import Wall, openings
from dolfinx_feti.wall.wallfile import read_wall

__all__ = [
    "GENERATORS",
    "create_tube_wall",
    "generate_wall",
    "open_case",
    "open_wall",
    "wall_quality",
]

#: Generators of walls by name. Each writes a file: its arguments are the path and the keyword
#: ``size``, the wanted length of the edges [mm].
GENERATORS: dict[str, Callable[..., MeshQuality]] = {"vessel": write_vessel, "tube": write_tube}

#: Pressure of a case without a file [mmHg]: a first load step of an artery.
DEFAULT_PRESSURE = 10.0


def open_wall(
    source: str | Path, comm: MPI.Comm, *, size: float | None, folder: Path, scale: float = 1.0
) -> tuple[Wall, MeshQuality]:
    """Read a wall, or generate it and keep its file for the next time.

    Args:
        source: `vessel` or `tube`, or the path of a file.
        comm: Communicator of the mesh.
        size: Length of the elements' edges [mm]; None for the generator's default. Not used for the
            path of a file.
        folder: Folder of generated walls.
        scale: Factor of all coordinates: millimetres in the unit of length of a file, 1 for a
            generated wall.

    Returns:
        The wall, and the quality of its elements.

    Raises:
        Exception: The errors of the generator and of ``read_wall``, on all processes.

    Note:
        Collective.
    """
    path = on_root(lambda: _path_of_wall(source, size, folder), comm)
    wall = read_wall(path, comm, scale=scale)
    return wall, wall_quality(wall)


def open_case(
    file: Path | None, mesh: str | Path, comm: MPI.Comm, *, size: float | None, folder: Path
) -> tuple[Case, Wall, MeshQuality]:
    """Read a case and its wall; without a file, create the case of an artery under 10 mmHg.

    Args:
        file: A TOML file of a wall (``docs/cases.md``), or None.
        mesh: The source of a wall without a file, as in :func:`open_wall`.
        comm: Communicator of the mesh.
        size: Length of the elements' edges [mm]; None for the generator's default. Not used if the
            case or ``mesh`` names a file.
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
        source = case.mesh if case.mesh in GENERATORS else file.parent / case.mesh
        wall, quality = open_wall(source, comm, size=size, folder=folder, scale=case.scale)
    case.check(wall)
    return case, wall, quality


def artery_case(wall: Wall, mesh: str) -> Case:
    """Return the case of an artery under 10 mmHg whose openings are clamped.

    Layers called media and adventitia get the material of :class:`ArteryParameters`, the media of a
    rabbit's carotid artery (Holzapfel, Gasser, Ogden 2000), and the fibre angles of these layers.

    Args:
        wall: The wall.
        mesh: The name of its mesh for the case.
    """
    media = ArteryParameters()
    layers = {
        name: LayerMaterial(media.c, media.k1, media.k2, angle)
        for name, angle in ANGLES.items()
        if name in wall.layers
    }
    conditions: dict[str, tuple[Condition, ...]] = {"lumen": (Pressure(),)}
    for name in openings(wall):
        conditions[name] = (Clamp(),)
    return Case(mesh=mesh, layers=layers, conditions=conditions, pressure=DEFAULT_PRESSURE)


def create_tube_wall(
    comm: MPI.Comm,
    *,
    length: float = 3.0,
    size: float = 0.13,
    quarter: bool = False,
    through: tuple[int, int] | None = None,
    around: int | None = None,
    along: int | None = None,
) -> Wall:
    """Create the two-layer tube of :func:`dolfinx_feti.meshes.tube.write_tube` on all processes.

    It passes through a temporary file (:func:`generate_wall`), as the generator is serial.

    Args:
        comm: Communicator of the mesh.
        length: Length [mm].
        size: Wanted length of the edges [mm]; the numbers below follow from it if not given.
        quarter: Only the part with x ≥ 0 and y ≥ 0.
        through: Elements through the media and through the adventitia.
        around: Elements around the circumference (a quarter of it for the quarter).
        along: Elements along the axis.

    Raises:
        ValueError: An argument is out of its range. On all processes.

    Note:
        Collective.
    """

    def generate(path: Path) -> None:
        write_tube(
            path,
            length=length,
            size=size,
            quarter=quarter,
            through=through,
            around=around,
            along=along,
        )

    return generate_wall(generate, comm)


def generate_wall(generate: Callable[[Path], object], comm: MPI.Comm) -> Wall:
    """Generate a wall on the first process, and distribute it through a temporary file.

    Args:
        generate: Writes an XDMF file.
        comm: Communicator of the mesh.

    Raises:
        Exception: The errors of the generator, on all processes.

    Note:
        Collective.
    """
    with ExitStack() as until_wall_is_read:

        def generate_in_temporary_folder() -> Path:
            folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
            path = Path(until_wall_is_read.enter_context(folder)) / "wall.xdmf"
            generate(path)
            return path

        return read_wall(on_root(generate_in_temporary_folder, comm), comm)


def wall_quality(wall: Wall) -> MeshQuality:
    """Return the quality of a wall's tetrahedra or hexahedra. Collective.

    Edges count as straight: a curved cell is measured by its corners.
    """
    mesh = wall.mesh
    n_owned = mesh.topology.index_map(3).size_local
    nodes = compat.geometry_dofmap(mesh)[:n_owned].astype(np.int64)
    points = np.asarray(mesh.geometry.x, dtype=np.float64)
    if mesh.basix_cell() == basix.CellType.hexahedron:
        local = measure_hexahedra(points, nodes[:, :8])
    else:
        local = measure_quality(points, nodes[:, :4])
    parts = [part for part in mesh.comm.allgather(local) if part.cells]
    cells = sum(part.cells for part in parts)
    return MeshQuality(
        points=mesh.geometry.index_map().size_global,
        cells=cells,
        minimum=min(part.minimum for part in parts),
        mean=sum(part.cells * part.mean for part in parts) / cells,
        histogram=tuple(np.sum([part.histogram for part in parts], axis=0).tolist()),
        volume=sum(part.volume for part in parts),
        cell_name=local.cell_name,
    )


def _path_of_wall(source: str | Path, size: float | None, folder: Path) -> Path:
    """Return the path of a wall's file, after generating it if it is missing or out of date.

    Next to a generated file is another one with a digest of the size and of all Python files of
    this folder. If the digest differs, the wall is out of date. Any change in this folder, even of
    a comment, therefore generates all walls again.

    Args:
        source: Name of a generator, or the path of a file, which is returned.
        size: Length of the elements' edges [mm]; None for the generator's default.
        folder: Folder of generated walls.
    """
    if source not in GENERATORS:
        return Path(source)
    path = folder / (f"{source}.xdmf" if size is None else f"{source}_{size:g}.xdmf")
    code = b"".join(file.read_bytes() for file in sorted(Path(__file__).parent.glob("*.py")))
    digest = hashlib.sha256(code + repr(size).encode()).hexdigest()
    digest_file = path.with_suffix(".sha256")
    is_complete = all(file.is_file() for file in (path, path.with_suffix(".h5"), digest_file))
    if is_complete and digest_file.read_text() == digest:
        return path
    options = {} if size is None else {"size": size}
    GENERATORS[str(source)](path, **options)
    digest_file.write_text(digest)
    return path
