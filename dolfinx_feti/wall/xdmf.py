# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A wall in XDMF and HDF5, which all processes read and write, each its own share of the rows.

The grids are ``mesh``, ``layers`` and ``surfaces``. The XML file contains the names of the tags and
the number of cells that each process has written. If as many processes read the file, they get the
same parts, and the mesh is not partitioned again.
"""

from __future__ import annotations

import json
import os
import shutil
import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import basix.ufl
import dolfinx
import dolfinx.io
import ufl

from dolfinx_feti.runtime.arrays import Array, Integers
from dolfinx_feti.runtime.collective import error_message, on_all, on_root
from dolfinx_feti.runtime.compat import adjacency
from dolfinx_feti.runtime.events import event
from dolfinx_feti.runtime.scotch import repeatable_partitions
from dolfinx_feti.wall.checks import check_connectivity, check_geometry
from dolfinx_feti.wall.wall import Wall

__all__ = ["is_written_by_write_wall", "read_parallel", "write_wall"]

#: Path of the grids in the XML file.
DOMAIN = "/Xdmf/Domain"

#: Name of the element with the tags' names and the numbers of cells, as JSON.
NAMES = "names"

#: Grids of the tags.
TAGS = ("layers", "surfaces")


def is_written_by_write_wall(path: Path) -> bool:
    """Return True if a file was written by :func:`write_wall`. Serial."""
    if path.suffix != ".xdmf":
        return False
    try:
        root = ElementTree.parse(path).getroot()
    except (ElementTree.ParseError, UnicodeDecodeError):
        return False
    return root.find(f"Domain/Information[@Name='{NAMES}']") is not None


def read_parallel(path: Path, comm: MPI.Comm, *, scale: float = 1.0) -> Wall:
    """Read a wall on all processes: each reads a P-th of cells, points and facets. Collective.

    Args:
        path: A file of :func:`write_wall`.
        comm: Communicator of the mesh.
        scale: Number of millimetres in the unit of the points.

    Raises:
        ValueError: The file, or its HDF5 file, is missing, damaged or no valid wall. On all
            processes.
    """
    try:
        return _read(path, comm, scale)
    except (AttributeError, KeyError, RuntimeError, TypeError, ValueError) as error:
        # dolfinx raises errors of these classes for a file that is damaged or missing
        raise ValueError(
            f"{path} cannot be read ({error_message(error)}): its HDF5 file has to lie beside "
            "it; write the wall anew by write_wall"
        ) from error


def _read(path: Path, comm: MPI.Comm, scale: float) -> Wall:
    """Read and check a wall; see :func:`read_parallel`, which converts errors. Collective."""
    with on_all(lambda: dolfinx.io.XDMFFile(comm, path, "r"), comm) as file:
        with event("WallRead"):
            shape, degree = file.read_cell_type("mesh", DOMAIN)
            cells = file.read_topology_data("mesh", DOMAIN)
            x = scale * file.read_geometry_data("mesh", DOMAIN)
            layers, facets = (file.read_topology_data(name, DOMAIN) for name in TAGS)
        information = json.loads(file.read_information(NAMES, DOMAIN))
        layer_names = _integers(information["layers"])
        surface_names = _integers(information["surfaces"])
        element = basix.ufl.element("Lagrange", shape.name, degree, shape=(3,), dtype=x.dtype)
        on_all(lambda: _check_shapes((cells, layers, facets), x, element), comm)
        check_connectivity("the mesh", x, cells, (layers, facets), comm)
        with event("WallPartition"):
            partitioner = _partitioner_of_file(information["parts"], len(cells), comm)
            domain = ufl.Mesh(element)
            with repeatable_partitions():
                mesh = dolfinx.mesh.create_mesh(comm, cells, x=x, e=domain, partitioner=partitioner)
            mesh.topology.create_entities(2)
            mesh.topology.create_connectivity(2, 3)
        with event("WallTags"):
            cell_tags = file.read_meshtags(mesh, "layers")
            facet_tags = file.read_meshtags(mesh, "surfaces")
        wall = Wall(mesh, cell_tags, facet_tags, layer_names, surface_names)
        check_geometry("the mesh", wall, same_orientation=False)
        _check_tags(wall, comm.allreduce(len(facets)))
    return wall


def _integers(names: dict[str, Any]) -> dict[str, int]:
    """Return names with their tags as integers."""
    return {name: int(tag) for name, tag in names.items()}


def _check_shapes(tables: Sequence[Integers], x: Array, element: Any) -> None:
    """Check that tables have the shapes of an element.

    Args:
        tables: Nodes of the cells, of the tagged cells, and of the tagged facets.
        x: Points, (n, 3).
        element: Element of the geometry.

    Raises:
        ValueError: A table has another shape.
    """
    nodes = element.dim // 3
    facet_nodes = len(element.basix_element.entity_closure_dofs[2][0])
    expected: list[tuple[npt.NDArray[Any], int]] = [(x, 3)]
    expected += zip(tables, (nodes, nodes, facet_nodes), strict=True)
    for table, columns in expected:
        if table.ndim != 2 or table.shape[1] != columns:
            raise ValueError("its tables of nodes do not suit the type of its cells")


def _check_tags(wall: Wall, n_facets: int) -> None:
    """Check that tags belong to entities of the wall, and have names. Collective.

    Args:
        wall: The wall.
        n_facets: Number of tagged facets in the file.

    Raises:
        ValueError: A tagged facet is not in the mesh, a layer has no name, or a name has no layer
            or surface. On all processes.
    """
    mesh = wall.mesh
    comm = wall.mesh.comm
    for tags, names in ((wall.cell_tags, wall.layers), (wall.facet_tags, wall.surfaces)):
        owned = tags.values[tags.indices < mesh.topology.index_map(tags.dim).size_local]
        present = {tag for part in comm.allgather(np.unique(owned).tolist()) for tag in part}
        named = set(names.values())
        n_owned = comm.allreduce(len(owned))
        if tags.dim == 2:
            is_incomplete = n_owned < n_facets  # some facets are not in the mesh
        else:
            is_incomplete = bool(present - named)  # some layers have no name
        if is_incomplete or named - present:
            table = "layers" if tags.dim == 3 else "surfaces"
            raise ValueError(f"some of its {table} have no name, or are not in its mesh")


def write_wall(path: Path | str, wall: Wall) -> None:
    """Write a wall for all processes to read, whatever their number. Collective.

    There are two files, `wall.xdmf` and `wall.h5`, in millimetres. They are written under temporary
    names and renamed at the end; missing folders are created.

    Args:
        path: Path of the XDMF file.
        wall: The wall.

    Raises:
        ValueError: The path has another ending than ``.xdmf``. On all processes.
        OSError: The folder cannot be written in. On all processes.
    """
    path = Path(path)
    comm = wall.mesh.comm
    if path.suffix != ".xdmf":
        raise ValueError(f"path={str(path)!r}: give a name that ends in .xdmf")
    folder = on_root(lambda: _create_folder_beside(path), comm)
    grids: list[Any] = [wall.mesh, wall.cell_tags, wall.facet_tags]
    names_of_user = [grid.name for grid in grids]
    try:
        # dolfinx writes a grid under the name of its object: it is changed here, and restored below
        for name, grid in zip(("mesh", *TAGS), grids, strict=True):
            grid.name = name
        with dolfinx.io.XDMFFile(comm, folder / path.name, "w") as file:
            file.write_mesh(wall.mesh)
            for tags in (wall.cell_tags, wall.facet_tags):
                file.write_meshtags(tags, wall.mesh.geometry)
            parts = comm.allgather(wall.mesh.topology.index_map(3).size_local)
            information = {"layers": wall.layers, "surfaces": wall.surfaces, "parts": parts}
            file.write_information(NAMES, json.dumps(information), DOMAIN)
        on_root(lambda: _move(folder, path), comm)
    finally:
        for name, grid in zip(names_of_user, grids, strict=True):
            grid.name = name
        if comm.rank == 0:
            shutil.rmtree(folder, ignore_errors=True)


def _partitioner_of_file(
    parts: Sequence[int], rows: int, comm: MPI.Comm
) -> Callable[..., Any] | None:
    """Return the partitioner that reproduces the parts of a file. Collective.

    Args:
        parts: Number of cells of each process that wrote the file.
        rows: Number of cells that this process has read.
        comm: Communicator of the mesh.

    Returns:
        The partitioner; None for dolfinx's, if another number of processes wrote the file.
    """
    before = np.cumsum([0, *comm.allgather(rows)])
    if comm.size == 1 or comm.size != len(parts) or sum(parts) != before[-1]:
        return None
    row = before[comm.rank] + np.arange(rows)
    process = np.searchsorted(np.cumsum(parts), row, side="right")

    offsets = np.arange(rows + 1, dtype=np.int32)
    return lambda *_: adjacency(process.astype(np.int32), offsets)


def _create_folder_beside(path: Path) -> Path:
    """Create a temporary folder next to a file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    return Path(tempfile.mkdtemp(prefix=f".{path.stem}-", dir=path.parent))


def _move(folder: Path, path: Path) -> None:
    """Move both files from a folder; the XDMF file last, as it refers to the other one."""
    for suffix in (".h5", ".xdmf"):
        os.replace((folder / path.name).with_suffix(suffix), path.with_suffix(suffix))
