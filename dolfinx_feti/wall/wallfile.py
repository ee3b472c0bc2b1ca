# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Wall files: cells with layers, facets with surfaces, read on one process.

Cells are tetrahedra; those of a Gmsh file may also be hexahedra, or of second order, with curved
edges. A Gmsh file names layers and surfaces by its physical groups, as it likes. In other formats
they are numbers in cell data: ``layer`` for the tetrahedra and ``surface`` for the triangles, or
``gmsh:physical``, ``medit:ref`` or ``tag`` for both. :data:`NUMBERS` gives the names of numbers
without names; others are called ``layer_7`` and ``surface_7``. ``meshes/README.md`` shows how to
bring your own wall.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt

import basix

from dolfinx_feti.runtime import compat

__all__ = ["CELLS", "NUMBERS", "RawWall", "read_raw_wall"]

#: Cell and order of the geometry by the number of nodes; and the same of facets.
CELLS = {
    4: ("tetrahedron", 1),
    10: ("tetrahedron", 2),
    8: ("hexahedron", 1),
    27: ("hexahedron", 2),
}
FACETS = {
    3: ("triangle", 1),
    6: ("triangle", 2),
    4: ("quadrilateral", 1),
    9: ("quadrilateral", 2),
}

# Names of numbers without names; opening k has 10 + k.
LAYER_NUMBERS = {"media": 1, "adventitia": 2}
SURFACE_NUMBERS = {"lumen": 3, "outer": 4, "symmetry_x": 5, "symmetry_y": 6}
SURFACE_NUMBERS |= {f"opening_{k}": 10 + k for k in range(1, 90)}
NUMBERS = LAYER_NUMBERS | SURFACE_NUMBERS

CELL_DATA = {
    "tetra": ("layer", "gmsh:physical", "medit:ref", "tag"),
    "triangle": ("surface", "gmsh:physical", "medit:ref", "tag"),
}
HELP = "meshes/README.md explains how to name layers and surfaces"

Indices = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class RawWall:
    """A wall as read from a file.

    Attributes:
        points: Coordinates, (n, 3), in the file's unit.
        cells: Nodes of the cells in dolfinx's order, (m, 4), or as many as in :data:`CELLS`.
        layers: The tag of each cell, (m,).
        facets: Nodes of the tagged facets, (k, 3), or as many as theirs have.
        surfaces: Their tags, (k,).
        layer_names: Tags of the layers.
        surface_names: Tags of the surfaces.
    """

    points: npt.NDArray[np.float64]
    cells: Indices
    layers: Indices
    facets: Indices
    surfaces: Indices
    layer_names: dict[str, int]
    surface_names: dict[str, int]


def read_raw_wall(path: Path) -> RawWall:
    """Read a wall and check that it is valid.

    Args:
        path: A Gmsh file (`*.msh`), or one of another format that meshio reads.

    Raises:
        FileNotFoundError: There is no such file.
        ModuleNotFoundError: The reader, gmsh or meshio, is not installed.
        ValueError: The file cannot be read, has other cells, or more than one kind, or has a cell
            without a layer's name, or no surface; the message lists those found.
    """
    if not path.is_file():
        raise FileNotFoundError(f"There is no file {path}: give the path of a mesh of a wall")
    wall = _read_gmsh(path) if path.suffix == ".msh" else _read_meshio(path)
    _check_names(path, wall)
    _check_mesh(path, wall)
    used, cells = np.unique(wall.cells, return_inverse=True)
    number = np.full(len(wall.points), -1)
    number[used] = np.arange(len(used))
    return RawWall(
        points=wall.points[used],
        cells=cells.reshape(wall.cells.shape).astype(np.int64),
        layers=wall.layers,
        facets=number[wall.facets],
        surfaces=wall.surfaces,
        layer_names=_used(wall.layer_names, wall.layers),
        surface_names=_used(wall.surface_names, wall.surfaces),
    )


def _used(names: dict[str, int], tags: Indices) -> dict[str, int]:
    """Leave out the names that nothing has."""
    return {name: tag for name, tag in names.items() if np.any(tags == tag)}


def _read_gmsh(path: Path) -> RawWall:
    """Read the physical groups of a Gmsh file."""
    with _gmsh_model(path) as gmsh:
        tags, points, _ = gmsh.model.mesh.getNodes()
        number = np.zeros(int(tags.max(initial=0)) + 1, dtype=np.int64)
        number[tags] = np.arange(len(tags))
        cells, layers, layer_names = _gmsh_groups(gmsh, path, 3)
        facets, surfaces, surface_names = _gmsh_groups(gmsh, path, 2)
        n_cells = sum(len(elements) for elements in gmsh.model.mesh.getElements(3)[1])
    if len(cells) < n_cells:
        raise ValueError(
            f"{n_cells - len(cells)} cells of {path} are in no physical volume; {HELP}"
        )
    return RawWall(
        points=points.reshape(-1, 3),
        cells=number[cells],
        layers=layers,
        facets=number[facets],
        surfaces=surfaces,
        layer_names=layer_names,
        surface_names=surface_names,
    )


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


def _gmsh_groups(gmsh: ModuleType, path: Path, dim: int) -> tuple[Indices, Indices, dict[str, int]]:
    """Return the elements of all physical groups of a dimension, their tags and the names' tags."""
    elements: list[Indices] = []
    values: list[Indices] = [np.zeros(0, dtype=np.int64)]
    names = {}
    known = CELLS if dim == 3 else FACETS
    for _, tag in gmsh.model.getPhysicalGroups(dim):
        names[gmsh.model.getPhysicalName(dim, tag)] = tag
        for entity in gmsh.model.getEntitiesForPhysicalGroup(dim, tag):
            for element, _, nodes in zip(*gmsh.model.mesh.getElements(dim, entity), strict=True):
                name, _, _, n_nodes, *_ = gmsh.model.mesh.getElementProperties(element)
                if n_nodes not in known or any(n_nodes != e.shape[1] for e in elements):
                    raise ValueError(
                        f"{path} has elements of type {name}; a wall has tetrahedra and triangles, "
                        "or hexahedra and quadrilaterals, of one order, 1 or 2"
                    )
                order = compat.gmsh_permutation(known[n_nodes][0], n_nodes)
                elements.append(nodes.astype(np.int64).reshape(-1, n_nodes)[:, order])
                values.append(np.full(len(elements[-1]), tag))
    tags = np.concatenate(values)
    names.pop("", None)
    none = np.zeros((0, dim + 1), dtype=np.int64)
    return np.concatenate(elements) if elements else none, tags, names or _named(tags, dim)


def _read_meshio(path: Path) -> RawWall:
    """Read tetrahedra and triangles from any format that meshio knows, with their cell data."""
    meshio = _import("meshio", path)
    try:
        mesh = meshio.read(path)
    except SystemExit as error:
        raise ValueError(f"meshio cannot read {path}") from error
    except Exception as error:  # each format has errors of its own
        raise ValueError(f"meshio cannot read {path}: {error}") from error
    others = {b.type for b in mesh.cells} - {"tetra", "triangle", "line", "vertex"}
    if others or "tetra" not in mesh.cells_dict:
        present = ", ".join(sorted({b.type for b in mesh.cells})) or "none"
        raise ValueError(f"{path} has cells of type {present}; a wall has tetra and triangle only")
    layers = _cell_data(path, mesh, "tetra")
    surfaces = _cell_data(path, mesh, "triangle")
    tagged = surfaces > 0
    facets = mesh.cells_dict.get("triangle", np.zeros((0, 3), dtype=np.int64))
    return RawWall(
        points=np.asarray(mesh.points, dtype=np.float64),
        cells=mesh.cells_dict["tetra"].astype(np.int64),
        layers=layers,
        facets=facets[tagged].astype(np.int64),
        surfaces=surfaces[tagged],
        layer_names=_named(layers, 3),
        surface_names=_named(surfaces, 2),
    )


def _cell_data(path: Path, mesh: Any, kind: str) -> Indices:
    """Return the tags of the cells of one kind, rounded to integers."""
    if kind not in mesh.cells_dict:
        return np.zeros(0, dtype=np.int64)
    for name in CELL_DATA[kind]:
        if kind in mesh.cell_data_dict.get(name, {}):
            return np.rint(mesh.cell_data_dict[name][kind]).astype(np.int64).reshape(-1)
    raise ValueError(
        f"{path} has no cell data {' or '.join(CELL_DATA[kind])} for its {kind} cells; "
        f"found: {', '.join(mesh.cell_data) or 'none'}. {HELP}"
    )


def _named(tags: Indices, dim: int) -> dict[str, int]:
    """Name the numbers of layers (dimension 3) or surfaces (2) that occur."""
    numbers = LAYER_NUMBERS if dim == 3 else SURFACE_NUMBERS
    kind = "layer" if dim == 3 else "surface"
    name_of = {tag: name for name, tag in numbers.items()}
    present = {int(tag) for tag in tags if tag > 0}
    named = {name: tag for name, tag in numbers.items() if tag in present}
    return named | {f"{kind}_{tag}": tag for tag in sorted(present - name_of.keys())}


def _import(name: str, path: Path) -> ModuleType:
    try:
        return __import__(name)
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            f"Reading {path} needs the Python package {name}, which is not installed: "
            f"`pip install {name}` or `apt install python3-{name}`",
            name=name,
        ) from error


def _check_names(path: Path, wall: RawWall) -> None:
    """Require a named layer for every cell, and a named surface."""
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


def _check_mesh(path: Path, wall: RawWall) -> None:
    """Require cells of nonzero volume, and facets that are faces of cells, each tagged once."""
    cell = CELLS[wall.cells.shape[1]][0]
    kind, kinds = {"tetrahedron": ("triangles", "tetrahedra")}.get(
        cell, ("quadrilaterals", "hexahedra")
    )
    topology = basix.topology(getattr(basix.CellType, cell))
    apexes = [1, 2, 3] if cell == "tetrahedron" else [1, 2, 4]
    edges = wall.points[wall.cells[:, apexes]] - wall.points[wall.cells[:, :1]]
    volume = np.abs(np.linalg.det(edges))
    flat = int(np.sum(volume <= 1e-12 * np.linalg.norm(edges, axis=2).max(axis=1) ** 3))
    if flat:
        raise ValueError(f"{flat} {kinds} of {path} have no volume: improve the mesh")
    corners = len(topology[2][0])
    faces = wall.cells[:, topology[2]].reshape(-1, corners)
    facets = np.unique(np.sort(wall.facets[:, :corners], axis=1), axis=0)
    if len(facets) < len(wall.facets):
        raise ValueError(
            f"{len(wall.facets) - len(facets)} {kind} of {path} have two tags: give each of "
            "them one surface"
        )
    n_faces = len(np.unique(np.sort(faces, axis=1), axis=0))
    strays = len(np.unique(np.sort(np.vstack([faces, facets]), axis=1), axis=0)) - n_faces
    if strays:
        raise ValueError(
            f"{strays} tagged {kind} of {path} are not faces of its {kinds}: mesh volumes "
            "and surfaces together"
        )
