# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Walls from files of several formats, distributed to all processes.

=============  =====================================  ==========================================
file           cells                                  names of layers and surfaces
=============  =====================================  ==========================================
``*.xdmf``     all; written by ``write_wall``         those of the wall
``*.msh``      tetrahedra, hexahedra; order 1 or 2    physical groups, by ``gmshfile``
other          tetrahedra of order 1                  numbers in cell data, by ``meshiofile``
=============  =====================================  ==========================================

PETSc's log shows the phase ``WallRead``, before those of ``wall_arrays``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from mpi4py import MPI

from dolfinx_feti.runtime.collective import on_root
from dolfinx_feti.runtime.events import event
from dolfinx_feti.runtime.values import require_positive
from dolfinx_feti.wall.checks import check_connectivity, check_faces, check_geometry
from dolfinx_feti.wall.gmshfile import read_gmsh
from dolfinx_feti.wall.meshiofile import read_meshio
from dolfinx_feti.wall.names import Groups, checked_groups, merged_names, tags_with_names
from dolfinx_feti.wall.reading import NAMING_HELP
from dolfinx_feti.wall.wall import Wall
from dolfinx_feti.wall.wall_arrays import WallArrays, create_on_root, distribute
from dolfinx_feti.wall.xdmf import is_written_by_write_wall, read_parallel

__all__ = ["read_wall", "read_wall_arrays"]


def read_wall(
    path: Path | str, comm: MPI.Comm, *, scale: float = 1.0, names: Groups | None = None
) -> Wall:
    """Read a wall and distribute it. All processes read XDMF; one reads any other format.

    Args:
        path: A file of ``write_wall`` (`*.xdmf`); a Gmsh file (`*.msh`) with named physical groups,
            or a file of another format with cell data (`meshes/README.md`).
        comm: Communicator of the mesh.
        scale: Number of millimetres in the file's unit of length (1000 if that is the metre).
        names: Dimension and number of each name, as ``{"lumen": (2, 3), "media": (3, 1)}``, for
            files with numbers only; other numbers are called ``layer_7`` and ``surface_7``.

    Raises:
        FileNotFoundError: There is no such file.
        ModuleNotFoundError: gmsh or meshio is needed and not installed.
        ValueError: The file does not contain a valid wall, or the scale is not positive.

    Note:
        Collective.
    """
    require_positive(scale=scale)
    path = Path(path)
    if on_root(lambda: path.is_file() and is_written_by_write_wall(path), comm):
        return read_parallel(path, comm, scale=scale)
    with event("WallRead"):
        arrays = create_on_root(lambda: _read_with_names(path, names or {}), comm)
        check_connectivity(path, arrays.points, arrays.cells, [arrays.facets], comm)
        check_faces(path, arrays.cells, arrays.facets, comm)
    wall = distribute(arrays, comm, scale=scale)
    check_geometry(path, wall, same_orientation=True)
    return wall


def _read_with_names(path: Path, names: Groups) -> WallArrays:
    """Read a wall; the names of the user replace those of the file with equal tags. Serial."""
    groups = checked_groups(names)
    arrays = read_wall_arrays(path)
    return replace(
        arrays,
        layer_names=merged_names(arrays.layer_names, groups, 3, arrays.cell_tags),
        surface_names=merged_names(arrays.surface_names, groups, 2, arrays.facet_tags),
    )


def read_wall_arrays(path: Path) -> WallArrays:
    """Read a wall from a Gmsh file (`*.msh`), or from another format by meshio. Serial.

    Raises:
        FileNotFoundError: There is no such file.
        ModuleNotFoundError: gmsh or meshio is needed and not installed.
        ValueError: The file is no mesh of a wall, or layers or surfaces have no names.
    """
    if not path.is_file():
        raise FileNotFoundError(f"There is no file {path}: give the path of a mesh of a wall")
    wall = read_gmsh(path) if path.suffix == ".msh" else read_meshio(path)
    layers = tags_with_names(wall.layer_names, wall.cell_tags)
    surfaces = tags_with_names(wall.surface_names, wall.facet_tags)
    missing = []
    if all(name is None for name, _ in layers):
        missing.append("named layer")
    if any(name is None for name, _ in layers):
        missing.append("name for some cells")
    if all(name is None for name, _ in surfaces):
        missing.append("named surface")
    if missing:
        raise ValueError(
            f"The wall in {path} has no {', no '.join(missing)}. Found: layers {_listed(layers)}; "
            f"surfaces {_listed(surfaces)}. {NAMING_HELP}."
        )
    return wall


def _listed(names: Sequence[tuple[str | None, int]]) -> str:
    """Return names and tags for a message."""
    return ", ".join(f"{name or 'nameless'} = {tag}" for name, tag in names) or "none"
