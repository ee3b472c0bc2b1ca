# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Wall files: cells with layers, facets with surfaces, read on one process.

Cells are tetrahedra; those of a Gmsh file may also be hexahedra, or of second order, with curved
edges. A Gmsh file names layers and surfaces by its physical groups. In other formats they are
numbers in cell data: ``layer`` for the tetrahedra and ``surface`` for the triangles, or
``gmsh:physical``, ``medit:ref`` or ``tag`` for both. Numbers without names are called ``layer_7``
and ``surface_7``. ``meshes/README.md`` shows how to bring your own wall.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from dolfinx_feti.runtime import compat
from dolfinx_feti.runtime.arrays import Array, Numbers
from dolfinx_feti.wall.checks import CELLS
from dolfinx_feti.wall.wall import named_tags

__all__ = ["RawWall", "read_raw_wall"]

#: What a facet is by the number of its nodes.
FACETS = {3: "triangle", 6: "triangle", 4: "quadrilateral", 9: "quadrilateral"}

CELL_DATA = {
    "tetra": ("layer", "gmsh:physical", "medit:ref", "tag"),
    "triangle": ("surface", "gmsh:physical", "medit:ref", "tag"),
}

HELP = "meshes/README.md explains how to name layers and surfaces"


@dataclass(frozen=True, slots=True)
class RawWall:
    """A wall as read from a file.

    Attributes:
        points: Coordinates, (n, 3), in the file's unit.
        cells: Nodes of the cells in dolfinx's order, (m, 4), or as many as in ``checks.CELLS``.
        layers: The tag of each cell, (m,).
        facets: Nodes of the tagged facets, (k, 3), or as many as theirs have.
        surfaces: Their tags, (k,).
        layer_names: Tags of the layers.
        surface_names: Tags of the surfaces.
    """

    points: Array
    cells: Numbers
    layers: Numbers
    facets: Numbers
    surfaces: Numbers
    layer_names: dict[str, int]
    surface_names: dict[str, int]


def read_raw_wall(path: Path) -> RawWall:
    """Read a wall from a Gmsh file (`*.msh`), or one that meshio reads.

    Raises:
        FileNotFoundError: There is no such file.
        ModuleNotFoundError: The reader, gmsh or meshio, is not installed.
        ValueError: The file cannot be read, or has a cell without a layer, or no surface.
    """
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
                order = compat.gmsh_permutation(kinds[n_nodes], n_nodes)
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
