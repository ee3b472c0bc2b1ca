# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Wall files: cells with layers, facets with surfaces, read on one process.

Cells are tetrahedra; those of a Gmsh file may also be hexahedra, or of second order, with curved
edges. A Gmsh file names layers and surfaces by its physical groups. In other formats they are
numbers in cell data: ``layer`` for the tetrahedra and ``surface`` for the triangles, or
``gmsh:physical``, ``medit:ref`` or ``tag`` for both. Numbers without names are called ``layer_7``
and ``surface_7``. ``meshes/README.md`` shows how to bring your own wall.

What is read is checked here, on one process: dolfinx takes a broken mesh as it is, and may crash.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

import basix

from dolfinx_feti.runtime import compat
from dolfinx_feti.runtime.arrays import Array, Integers, Mask, Numbers
from dolfinx_feti.wall.wall import named_tags

__all__ = ["CELLS", "RawWall", "orientations", "read_raw_wall"]

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

CELL_DATA = {
    "tetra": ("layer", "gmsh:physical", "medit:ref", "tag"),
    "triangle": ("surface", "gmsh:physical", "medit:ref", "tag"),
}

#: Volume of a cell, over the cube of its longest edge, that counts as none.
FLAT = 1e-12

#: Cells that are looked at together, to save memory.
MANY = 10_000

HELP = "meshes/README.md explains how to name layers and surfaces"


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

    points: Array
    cells: Numbers
    layers: Numbers
    facets: Numbers
    surfaces: Numbers
    layer_names: dict[str, int]
    surface_names: dict[str, int]


def read_raw_wall(path: Path) -> RawWall:
    """Read a wall from a Gmsh file (`*.msh`), or one that meshio reads, and check that it is valid.

    Raises:
        FileNotFoundError: There is no such file.
        ModuleNotFoundError: The reader, gmsh or meshio, is not installed.
        ValueError: The file cannot be read, or holds no valid wall; the message says how.
    """
    if not path.is_file():
        raise FileNotFoundError(f"There is no file {path}: give the path of a mesh of a wall")
    wall = _read_gmsh(path) if path.suffix == ".msh" else _read_meshio(path)
    _check_names(path, wall)
    _check_points(path, wall)
    _check_cells(path, wall)
    _check_faces(path, wall)
    used, cells = np.unique(wall.cells, return_inverse=True)
    number = np.full(len(wall.points), -1)
    number[used] = np.arange(len(used))
    return replace(
        wall,
        points=wall.points[used],
        cells=cells.reshape(wall.cells.shape).astype(np.int64),
        facets=number[wall.facets],
    )


def _read_gmsh(path: Path) -> RawWall:
    """Read the physical groups of a Gmsh file."""
    with _gmsh_model(path) as gmsh:
        tags, points, _ = gmsh.model.mesh.getNodes()
        cells, layers, layer_names = _gmsh_groups(gmsh, path, 3)
        facets, surfaces, surface_names = _gmsh_groups(gmsh, path, 2)
        n_cells = sum(len(elements) for elements in gmsh.model.mesh.getElements(3)[1])
    if len(cells) < n_cells:
        raise ValueError(
            f"{n_cells - len(cells)} cells of {path} are in no physical volume; {HELP}"
        )
    number = np.full(
        int(max(tags.max(initial=0), cells.max(initial=0), facets.max(initial=0))) + 1, -1
    )
    number[tags] = np.arange(len(tags))
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


def _gmsh_groups(gmsh: ModuleType, path: Path, dim: int) -> tuple[Numbers, Numbers, dict[str, int]]:
    """Return the elements of all physical groups of a dimension, their tags and the names' tags."""
    elements: list[Numbers] = []
    values: list[Numbers] = [np.zeros(0, dtype=np.int64)]
    names: dict[str, int] = {}
    group_of: dict[int, str] = {}
    known = CELLS if dim == 3 else FACETS
    for _, tag in gmsh.model.getPhysicalGroups(dim):
        name = gmsh.model.getPhysicalName(dim, tag)
        if name and name in names:
            raise ValueError(
                f"{path} has two physical groups of dimension {dim} that are called {name!r}: "
                "join them, or give each a name of its own"
            )
        names[name] = tag
        for entity in gmsh.model.getEntitiesForPhysicalGroup(dim, tag):
            first = group_of.setdefault(entity, name or str(tag))
            if first != (name or str(tag)):
                raise ValueError(
                    f"{'Volume' if dim == 3 else 'Surface'} {entity} of {path} is in two physical "
                    f"groups, {first!r} and {name or str(tag)!r}: leave it in one of them"
                )
            for element, _, nodes in zip(*gmsh.model.mesh.getElements(dim, entity), strict=True):
                kind, _, _, n_nodes, *_ = gmsh.model.mesh.getElementProperties(element)
                if n_nodes not in known or any(n_nodes != e.shape[1] for e in elements):
                    raise ValueError(
                        f"{path} has elements of type {kind}; a wall has tetrahedra and triangles, "
                        "or hexahedra and quadrilaterals, of one order, 1 or 2"
                    )
                order = compat.gmsh_permutation(known[n_nodes][0], n_nodes)
                elements.append(nodes.astype(np.int64).reshape(-1, n_nodes)[:, order])
                values.append(np.full(len(elements[-1]), tag))
    tags = np.concatenate(values)
    names.pop("", None)
    none = np.zeros((0, dim + 1), dtype=np.int64)
    found = {name: tag for name, tag in names.items() if np.any(tags == tag)}
    cells = np.concatenate(elements) if elements else none
    return cells, tags, found if names else named_tags({}, tags, dim)


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
    if mesh.points.ndim != 2 or mesh.points.shape[1] != 3:
        raise ValueError(f"{path} has points of shape {mesh.points.shape}: a wall lies in space")
    return RawWall(
        points=np.asarray(mesh.points, dtype=np.float64),
        cells=mesh.cells_dict["tetra"].astype(np.int64),
        layers=layers,
        facets=facets[tagged].astype(np.int64),
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


def _words(wall: RawWall) -> tuple[str, str]:
    """Return what cells and facets are called."""
    if CELLS[wall.cells.shape[1]][0] == "tetrahedron":
        return "tetrahedra", "triangles"
    return "hexahedra", "quadrilaterals"


def _check_points(path: Path, wall: RawWall) -> None:
    """Require cells and facets of the same kind, whose points exist and are finite."""
    cells, facets = _words(wall)
    kinds = CELLS[wall.cells.shape[1]], FACETS.get(wall.facets.shape[1], ("", 0))
    if len(wall.facets) and kinds[1] != (
        {"tetrahedra": "triangle"}.get(cells, facets[:-1]),
        kinds[0][1],
    ):
        raise ValueError(
            f"{path} has {cells} of order {kinds[0][1]}, but facets with {wall.facets.shape[1]} "
            f"nodes: a wall has {facets} of that order"
        )
    for what, nodes in ((cells, wall.cells), (facets, wall.facets)):
        lost = int(np.sum(((nodes < 0) | (nodes >= len(wall.points))).any(axis=1)))
        if lost:
            raise ValueError(f"{lost} {what} of {path} have points that are not in the file")
    wrong = int(np.sum(~np.isfinite(wall.points[np.unique(wall.cells)]).all(axis=1)))
    if wrong:
        raise ValueError(f"{wrong} points of {path} have coordinates that are not finite")


def _check_cells(path: Path, wall: RawWall) -> None:
    """Require cells that occur once, have a volume, and are not turned inside out."""
    cells = _words(wall)[0]
    again = len(wall.cells) - len(np.unique(np.sort(wall.cells, axis=1), axis=0))
    if again:
        raise ValueError(f"{again} {cells} of {path} occur twice: put each into one layer")
    side, flat = orientations(wall.points, wall.cells)
    if flat.any():
        raise ValueError(f"{flat.sum()} {cells} of {path} have no volume: improve the mesh")
    inverted = min(np.sum(side != 1), np.sum(side != -1))
    if inverted:
        raise ValueError(
            f"{inverted} {cells} of {path} are inverted, in part or against the others: improve "
            "the mesh, or number their nodes as in the other cells"
        )


def orientations(points: Array, cells: Integers) -> tuple[Numbers, Mask]:
    """Return the sign of det ∂x/∂X in each cell, 0 where it changes, and which have no volume.

    Nodes of the cells are in dolfinx's order, (m, 4), or as many as in :data:`CELLS`; points (n,
    3).
    """
    kind, order = CELLS[cells.shape[1]]
    cell = getattr(basix.CellType, kind)
    variant = basix.LagrangeVariant.equispaced
    element = basix.create_element(basix.ElementFamily.P, cell, order, variant)
    degree = 0 if (kind, order) == ("tetrahedron", 1) else 4
    at, weights = (np.asarray(part, np.float64) for part in basix.make_quadrature(cell, degree))
    dφ = np.asarray(element.tabulate(1, at), np.float64)[1:, :, :, 0]  # (3, points, nodes)
    side, flat = np.zeros(len(cells), dtype=np.int64), np.zeros(len(cells), dtype=bool)
    for k in range(0, len(cells), MANY):
        x, part = points[cells[k : k + MANY]], slice(k, k + MANY)
        det = np.linalg.det(np.einsum("jqn,cni->cqij", dφ, x))  # det ∂x/∂X, (cells, points)
        side[part] = (det > 0.0).all(axis=1) * 1 - (det < 0.0).all(axis=1)
        flat[part] = np.abs(det @ weights) <= FLAT * np.ptp(x, axis=1).max(axis=1) ** 3
    return side, flat


def _check_faces(path: Path, wall: RawWall) -> None:
    """Require faces of no more than two cells, and facets that are faces, each tagged once."""
    kinds, kind = _words(wall)
    topology = basix.topology(getattr(basix.CellType, CELLS[wall.cells.shape[1]][0]))
    corners = len(topology[2][0])
    every = np.sort(wall.cells[:, topology[2]].reshape(-1, corners), axis=1)
    faces, cells_of_face = np.unique(every, axis=0, return_counts=True)
    crowded = int(np.sum(cells_of_face > 2))
    if crowded:
        raise ValueError(
            f"{crowded} {kind} of {path} are faces of more than two {kinds}: cells overlap there"
        )
    facets = np.unique(np.sort(wall.facets[:, :corners], axis=1), axis=0)
    if len(facets) < len(wall.facets):
        raise ValueError(
            f"{len(wall.facets) - len(facets)} {kind} of {path} have two tags: give each of "
            "them one surface"
        )
    strays = len(np.unique(np.vstack([faces, facets]), axis=0)) - len(faces)
    if strays:
        raise ValueError(
            f"{strays} tagged {kind} of {path} are not faces of its {kinds}: mesh volumes "
            "and surfaces together"
        )
