# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A wall in XDMF and HDF5, which all processes read and write, each its own share of the rows.

The grids are ``mesh``, ``layers`` and ``surfaces``; what the tags are called, and how many cells
each process has written, is in the light data. As many processes as have written a file take these
parts again, and nothing has to be partitioned.
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

import basix.ufl
import dolfinx
import dolfinx.io
import ufl

from dolfinx_feti.runtime.arrays import Array, Integers
from dolfinx_feti.runtime.collective import on_all, on_first, reason
from dolfinx_feti.runtime.compat import adjacency
from dolfinx_feti.runtime.events import event
from dolfinx_feti.wall.checks import check_cells, check_rows
from dolfinx_feti.wall.wall import Wall

__all__ = ["is_parallel", "read_parallel", "write_wall"]

#: Where the grids stand in the light data, and where names and numbers of cells do.
DOMAIN, NAMES, TAGS = "/Xdmf/Domain", "names", ("layers", "surfaces")


def is_parallel(path: Path) -> bool:
    """Tell whether a file is one that :func:`write_wall` has written. Serial."""
    try:
        root = ElementTree.parse(path).getroot() if path.suffix == ".xdmf" else None
    except (ElementTree.ParseError, UnicodeDecodeError):
        root = None
    return root is not None and root.find(f"Domain/Information[@Name='{NAMES}']") is not None


def read_parallel(path: Path, comm: MPI.Comm, *, scale: float = 1.0) -> Wall:
    """Read a wall on all processes: each reads a P-th of cells, points and facets. Collective."""
    try:
        file = on_all(lambda: dolfinx.io.XDMFFile(comm, path, "r"), comm)
        with file:
            with event("WallRead"):
                shape, degree = file.read_cell_type("mesh", DOMAIN)
                cells = file.read_topology_data("mesh", DOMAIN)
                x = scale * file.read_geometry_data("mesh", DOMAIN)
                layers, facets = (file.read_topology_data(name, DOMAIN) for name in TAGS)
            light = json.loads(file.read_information(NAMES, DOMAIN))
            names = [{name: int(tag) for name, tag in light[kind].items()} for kind in TAGS]
            element = basix.ufl.element("Lagrange", shape.name, degree, shape=(3,), dtype=x.dtype)
            on_all(lambda: _check_shapes((cells, layers, facets), x, element), comm)
            check_rows("the mesh", x, cells, (layers, facets), comm)
            with event("WallPartition"):
                keep = _keep(light["parts"], len(cells), comm)
                domain = ufl.Mesh(element)
                mesh = dolfinx.mesh.create_mesh(comm, cells, x=x, e=domain, partitioner=keep)
                mesh.topology.create_entities(2)
                mesh.topology.create_connectivity(2, 3)
            with event("WallTags"):
                tags = [file.read_meshtags(mesh, name) for name in TAGS]
            wall = Wall(mesh, *tags, *names)
            check_cells("the mesh", wall, alike=False)
            _check_tags(wall, comm.allreduce(len(facets)))
        return wall
    except (AttributeError, KeyError, RuntimeError, TypeError, ValueError) as error:
        raise ValueError(
            f"{path} cannot be read ({reason(error)}): its HDF5 file has to lie beside it; write "
            "the wall anew by write_wall"
        ) from error


def _check_shapes(tables: Sequence[Integers], x: Array, element: Any) -> None:
    """Require rows of nodes of cells, of cells, and of facets, and points in space."""
    nodes = element.dim // 3
    widths = nodes, nodes, len(element.basix_element.entity_closure_dofs[2][0])
    wrong = x.ndim != 2 or x.shape[1] != 3
    if wrong or any(r.ndim != 2 or r.shape[1] != w for r, w in zip(tables, widths, strict=True)):
        raise ValueError("its tables have other shapes than those of its cells")


def _check_tags(wall: Wall, n_facets: int) -> None:
    """Require tags of the wall's cells and facets, all with names. Collective."""
    mesh, comm = wall.mesh, wall.mesh.comm
    for tags, names in ((wall.cell_tags, wall.layers), (wall.facet_tags, wall.surfaces)):
        owned = tags.values[tags.indices < mesh.topology.index_map(tags.dim).size_local]
        present = {tag for part in comm.allgather(np.unique(owned).tolist()) for tag in part}
        named = set(names.values())
        lost = n_facets > comm.allreduce(len(owned)) if tags.dim == 2 else present - named
        if lost or named - present:
            kind = "layers" if tags.dim == 3 else "surfaces"
            raise ValueError(f"its {kind} are not those of its mesh, or of its names")


def write_wall(path: Path | str, wall: Wall) -> None:
    """Write a wall for all processes to read, whatever their number. Collective.

    Two files are written aside and put in place at the end, `wall.h5` beside `wall.xdmf`, in
    millimetres; the folder is made.

    Raises:
        ValueError: The path has another ending than ``.xdmf``. On all processes.
        OSError: The folder cannot be written in. On all processes.
    """
    path, comm = Path(path), wall.mesh.comm
    if path.suffix != ".xdmf":
        raise ValueError(f"path={str(path)!r}: give a name that ends in .xdmf")
    aside = on_first(lambda: _folder_aside(path), comm)
    grids: list[Any] = [wall.mesh, wall.cell_tags, wall.facet_tags]
    called = [grid.name for grid in grids]
    try:
        for name, grid in zip(("mesh", *TAGS), grids, strict=True):
            grid.name = name
        with dolfinx.io.XDMFFile(comm, aside / path.name, "w") as file:
            file.write_mesh(wall.mesh)
            for tags in (wall.cell_tags, wall.facet_tags):
                file.write_meshtags(tags, wall.mesh.geometry)
            parts = comm.allgather(wall.mesh.topology.index_map(3).size_local)
            light = json.dumps({"layers": wall.layers, "surfaces": wall.surfaces, "parts": parts})
            file.write_information(NAMES, light, DOMAIN)
        on_first(lambda: _put_in_place(aside, path), comm)
    finally:
        for name, grid in zip(called, grids, strict=True):
            grid.name = name
        if comm.rank == 0:
            shutil.rmtree(aside, ignore_errors=True)


def _keep(parts: Sequence[int], rows: int, comm: MPI.Comm) -> Callable[..., Any] | None:
    """Return the partitioner that keeps the parts of a file; None if the mesh is to be partitioned.

    ``parts`` are the cells of each process that wrote it, ``rows`` those that this one has read.
    """
    before = np.cumsum([0, *comm.allgather(rows)])
    if comm.size == 1 or comm.size != len(parts) or sum(parts) != before[-1]:
        return None
    row = before[comm.rank] + np.arange(rows)
    process = np.searchsorted(np.cumsum(parts), row, side="right")

    offsets = np.arange(rows + 1, dtype=np.int32)
    return lambda *_: adjacency(process.astype(np.int32), offsets)


def _folder_aside(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    return Path(tempfile.mkdtemp(prefix=f".{path.stem}-", dir=path.parent))


def _put_in_place(aside: Path, path: Path) -> None:
    """Move both files, that which names the other one last."""
    for suffix in (".h5", ".xdmf"):
        os.replace((aside / path.name).with_suffix(suffix), path.with_suffix(suffix))
