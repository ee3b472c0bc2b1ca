# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Walls from files, of any format, distributed to all processes.

Cells are tetrahedra; in a Gmsh file also hexahedra, or cells of second order. It names layers and
surfaces by its physical groups, other formats number them in cell data (``meshes/README.md``).
PETSc's log shows the phases ``WallRead``, ``WallPartition`` and ``WallTags``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any

from mpi4py import MPI

import numpy as np

import basix.ufl
import dolfinx
import dolfinx.io
import ufl

from dolfinx_feti.mechanics.values import require_positive
from dolfinx_feti.runtime.arrays import Array, Numbers
from dolfinx_feti.runtime.collective import on_first
from dolfinx_feti.runtime.events import event
from dolfinx_feti.wall.checks import CELLS, check_cells, check_faces, check_rows
from dolfinx_feti.wall.wall import Group, Groups, Wall, checked_groups, named_tags
from dolfinx_feti.wall.xdmf import is_parallel, read_parallel

__all__ = ["RawWall", "distribute", "read_raw_wall", "read_wall"]

#: What a facet is by the number of its nodes.
FACETS = {3: "triangle", 6: "triangle", 4: "quadrilateral", 9: "quadrilateral"}

CELL_DATA = {
    "tetra": ("layer", "gmsh:physical", "medit:ref", "tag"),
    "triangle": ("surface", "gmsh:physical", "medit:ref", "tag"),
}

HELP = "meshes/README.md explains how to name layers and surfaces"


@dataclass(frozen=True, slots=True)
class RawWall:
    """A wall as read from a file."""

    points: Array  #: Coordinates, (n, 3), in the file's unit
    #: Nodes of the cells in dolfinx's order, (m, 4), or as many as in ``checks.CELLS``
    cells: Numbers
    layers: Numbers  #: Tag of each cell, (m,)
    facets: Numbers  #: Nodes of the tagged facets, (k, 3), or as many as those of the cells have
    surfaces: Numbers  #: Tags of the facets, (k,)
    layer_names: dict[str, int]  #: Tags of the layers
    surface_names: dict[str, int]  #: Tags of the surfaces


def read_wall(
    path: Path | str, comm: MPI.Comm, *, scale: float = 1.0, names: Groups | None = None
) -> Wall:
    """Read a wall: on all processes from XDMF, on one from other formats, to be distributed.

    Args:
        path: A file of ``write_wall`` (`*.xdmf`); a Gmsh file (`*.msh`) with named physical groups,
            or a file of another format with cell data (`meshes/README.md`).
        comm: Communicator of the mesh.
        scale: Number of millimetres in the file's unit of length (1000 if that is the metre).
        names: Dimension and number of each name, as ``{"lumen": (2, 3), "media": (3, 1)}``, in a
            file that has numbers only; others are called ``layer_7`` and ``surface_7``.

    Raises:
        FileNotFoundError: There is no such file.
        ModuleNotFoundError: gmsh or meshio is needed and not installed.
        ValueError: The file does not hold a valid wall, or the scale is not positive.

    Note:
        Collective.
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


def read_raw_wall(path: Path) -> RawWall:
    """Read a wall from a Gmsh file (`*.msh`), or one that meshio reads; each cell has a layer."""
    if not path.is_file():
        raise FileNotFoundError(f"There is no file {path}: give the path of a mesh of a wall")
    wall = _read_gmsh(path) if path.suffix == ".msh" else _read_meshio(path)
    missing, texts = [], []
    for kind, names, tags in (
        ("layer", wall.layer_names, wall.layers),
        ("surface", wall.surface_names, wall.surfaces),
    ):
        name_of = {tag: name for name, tag in names.items()}
        present = [(name_of.get(int(tag), "nameless"), tag) for tag in np.unique(tags)]
        listed = ", ".join(f"{name} = {tag}" for name, tag in present)
        texts.append(f"{kind}s {listed or 'none'}")
        missing += [f"named {kind}"] * all(name == "nameless" for name, _ in present)
        missing += ["name for some cells"] * (kind == "layer" and "nameless" in dict(present))
    if missing:
        raise ValueError(
            f"The wall in {path} has no {', no '.join(missing)}. Found: {'; '.join(texts)}. {HELP}."
        )
    return wall


def _read_gmsh(path: Path) -> RawWall:
    """Read the physical groups of a Gmsh file."""
    with _gmsh_model(path) as gmsh:
        tags, points, _ = gmsh.model.mesh.getNodes()
        cells, layers, layer_names = _gmsh_groups(gmsh, path, 3)
        facets, surfaces, surface_names = _gmsh_groups(gmsh, path, 2)
        lost = sum(map(len, gmsh.model.mesh.getElements(3)[1])) - len(cells)
    if lost:
        raise ValueError(f"{lost} cells of {path} are in no physical volume; {HELP}")
    number = np.full(max(int(a.max(initial=0)) for a in (tags, cells, facets)) + 1, -1)
    number[tags] = np.arange(len(tags))
    arrays = points.reshape(-1, 3), number[cells], layers, number[facets], surfaces
    return RawWall(*arrays, layer_names, surface_names)


@contextmanager
def _gmsh_model(path: Path) -> Iterator[ModuleType]:
    """Open a file in a new model, and leave Gmsh as it was."""
    gmsh = _import("gmsh", path)
    running = bool(gmsh.isInitialized())
    if not running:
        gmsh.initialize(readConfigFiles=False, interruptible=False)
        gmsh.option.setNumber("General.Terminal", 0)
    gmsh.model.add(str(path))
    try:
        try:
            gmsh.merge(str(path))
        except Exception as error:  # gmsh knows no other class
            raise ValueError(f"gmsh cannot read {path}: {error}") from error
        yield gmsh
    finally:
        gmsh.model.remove()
        if not running:
            gmsh.finalize()


def _gmsh_groups(gmsh: ModuleType, path: Path, dim: int) -> tuple[Numbers, Numbers, dict[str, int]]:
    """Return the elements of all physical groups of a dimension, their tags and the names' tags."""
    elements: list[Numbers] = []
    values: list[Numbers] = [np.zeros(0, dtype=np.int64)]
    names: dict[str, int] = {}
    group_of: dict[int, str] = {}
    kinds = {n: kind for n, (kind, *_) in CELLS.items()} if dim == 3 else FACETS
    for _, tag in gmsh.model.getPhysicalGroups(dim):
        name = gmsh.model.getPhysicalName(dim, tag)
        if name and name in names:
            raise ValueError(
                f"{path} has two physical groups of dimension {dim} that are called {name!r}: "
                "join them, or give each a name of its own"
            )
        names[name] = tag
        for entity in gmsh.model.getEntitiesForPhysicalGroup(dim, tag):
            group = name or str(tag)
            if group_of.setdefault(entity, group) != group:
                raise ValueError(
                    f"{'Volume' if dim == 3 else 'Surface'} {entity} of {path} is in two physical "
                    f"groups, {group_of[entity]!r} and {group!r}: leave it in one of them"
                )
            for element, _, nodes in zip(*gmsh.model.mesh.getElements(dim, entity), strict=True):
                kind, _, _, n_nodes, *_ = gmsh.model.mesh.getElementProperties(element)
                if n_nodes not in kinds or any(n_nodes != e.shape[1] for e in elements):
                    raise ValueError(
                        f"{path} has elements of type {kind}; a wall has tetrahedra and triangles, "
                        "or hexahedra and quadrilaterals, of one order, 1 or 2"
                    )
                order = dolfinx.cpp.io.perm_gmsh(dolfinx.mesh.to_type(kinds[n_nodes]), n_nodes)
                elements.append(nodes.astype(np.int64).reshape(-1, n_nodes)[:, order])
                values.append(np.full(len(elements[-1]), tag))
    tags = np.concatenate(values)
    names.pop("", None)
    found = {name: tag for name, tag in names.items() if np.any(tags == tag)}
    cells = np.concatenate(elements or [np.zeros((0, dim + 1), dtype=np.int64)])
    return cells, tags, found if names else named_tags({}, tags, dim)


def _read_meshio(path: Path) -> RawWall:
    """Read tetrahedra and triangles from any format that meshio knows, with their cell data."""
    meshio = _import("meshio", path)
    try:
        mesh = meshio.read(path)
    except (Exception, SystemExit) as error:  # each format has errors of its own
        raise ValueError(f"meshio cannot read {path}: {error}") from error
    blocks = {"triangle": np.zeros((0, 3)), **mesh.cells_dict}
    if "tetra" not in blocks or set(blocks) - {"tetra", "triangle", "line", "vertex"}:
        present = ", ".join(sorted(mesh.cells_dict)) or "none"
        raise ValueError(f"{path} has cells of type {present}; a wall has tetra and triangle only")
    if mesh.points.ndim != 2 or mesh.points.shape[1] != 3:
        raise ValueError(f"{path} has points of shape {mesh.points.shape}: a wall lies in space")
    layers, surfaces = (_cell_data(path, mesh, kind) for kind in ("tetra", "triangle"))
    tagged = surfaces > 0
    return RawWall(
        points=np.asarray(mesh.points, dtype=np.float64),
        cells=blocks["tetra"].astype(np.int64),
        layers=layers,
        facets=blocks["triangle"][tagged].astype(np.int64),
        surfaces=surfaces[tagged],
        layer_names=named_tags({}, layers[layers > 0], 3),
        surface_names=named_tags({}, surfaces[tagged], 2),
    )


def _cell_data(path: Path, mesh: Any, kind: str) -> Numbers:
    """Return the tags of the cells of one kind."""
    if kind not in mesh.cells_dict:
        return np.zeros(0, dtype=np.int64)
    for name in CELL_DATA[kind]:
        if kind in mesh.cell_data_dict.get(name, {}):
            values = np.asarray(mesh.cell_data_dict[name][kind], dtype=np.float64)
            whole = (values == np.rint(values)) & (np.abs(values) <= np.iinfo(np.int32).max)
            if values.size != len(mesh.cells_dict[kind]) or not whole.all():
                raise ValueError(
                    f"{path}: the cell data {name!r} are not one integer of 32 bits for each {kind}"
                )
            return values.astype(np.int64).reshape(-1)
    raise ValueError(
        f"{path} has no cell data {' or '.join(CELL_DATA[kind])} for its {kind} cells; "
        f"found: {', '.join(mesh.cell_data) or 'none'}. {HELP}"
    )


def _import(name: str, path: Path) -> ModuleType:
    try:
        return __import__(name)
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            f"Reading {path} needs the Python package {name}, which is not installed: "
            f"`pip install {name}` or `apt install python3-{name}`",
            name=name,
        ) from error
