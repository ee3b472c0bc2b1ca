# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Walls from files of several formats, distributed to all processes.

=============  =====================================  ==========================================
file           cells                                  names of layers and surfaces
=============  =====================================  ==========================================
``*.xdmf``     all; written by ``write_wall``         those of the wall
``*.msh``      tetrahedra, hexahedra; order 1 or 2    physical groups of Gmsh
other          tetrahedra of order 1, by meshio       numbers in cell data (meshes/README.md)
=============  =====================================  ==========================================

PETSc's log shows the phase ``WallRead``, before those of ``wall_arrays``.

Gmsh files are not read by ``dolfinx.io.gmsh``, which in dolfinx 0.9 to 0.11 fails with a bare
AssertionError if node numbers have gaps, and ignores cells without a group or in two of them.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

from mpi4py import MPI

import numpy as np

import dolfinx

from dolfinx_feti.runtime.arrays import Numbers
from dolfinx_feti.runtime.collective import on_root, on_root_only
from dolfinx_feti.runtime.events import event
from dolfinx_feti.runtime.values import require_positive
from dolfinx_feti.wall.checks import CELLS, check_cells, check_faces, check_rows
from dolfinx_feti.wall.names import (
    Groups,
    checked_groups,
    merged_names,
    names_of,
    tags_with_names,
    with_default_names,
)
from dolfinx_feti.wall.wall import Wall
from dolfinx_feti.wall.wall_arrays import WallArrays, distribute, first_or_empty
from dolfinx_feti.wall.xdmf import is_written_by_write_wall, read_parallel

__all__ = ["read_wall", "read_wall_arrays"]

#: Shape of a facet by its number of nodes.
FACETS = {3: "triangle", 6: "triangle", 4: "quadrilateral", 9: "quadrilateral"}

#: Names of the cell data with tags, by meshio's type of cell. Of those in a file, the first is
#: used.
CELL_DATA = {
    "tetra": ("layer", "gmsh:physical", "medit:ref", "tag"),
    "triangle": ("surface", "gmsh:physical", "medit:ref", "tag"),
}

#: End of the messages about names and tags.
HELP = "meshes/README.md explains how to name layers and surfaces"

#: Types of meshio with nodes on their edges.
SECOND_ORDER = frozenset({"tetra10", "triangle6"})

#: Remedy for cells of second order in a format other than Gmsh's; PATH stands for the path.
CORNERS_ONLY = """. Cells of second order are read from Gmsh's own files (*.msh). Or keep their \
corners: m = meshio.read("PATH"); \
n = {"tetra10": ("tetra", 4), "triangle6": ("triangle", 3)}; \
m = meshio.Mesh(m.points, [(n[b.type][0], b.data[:, :n[b.type][1]]) for b in m.cells], \
cell_data=m.cell_data); m.write("wall.vtu")"""

#: Remedy for sets of cells, such as Abaqus's, in place of numbers; PATH stands for the path.
NUMBER_THE_SETS = """. Number the sets in the order of your list, from 1 on: \
m = meshio.read("PATH"); sets = ["media", "lumen"]; m.cell_data["gmsh:physical"] = \
[sum(k * np.isin(np.arange(len(b.data)), m.cell_sets[s][i]) for k, s in enumerate(sets, 1)) \
for i, b in enumerate(m.cells)]; m.cell_sets = {}; m.write("wall.vtu"); then \
read_wall("wall.vtu", comm, names={"media": (3, 1), "lumen": (2, 2)})"""


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
        on_first = on_root_only(lambda: _read_with_names(path, names or {}), comm)
        arrays = first_or_empty(on_first, comm)
        check_rows(path, arrays.points, arrays.cells, [arrays.facets], comm)
        check_faces(path, arrays.cells, arrays.facets, comm)
    wall = distribute(arrays, comm, scale=scale)
    check_cells(path, wall, same_orientation=True)
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
    wall = _read_gmsh(path) if path.suffix == ".msh" else _read_meshio(path)
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
            f"surfaces {_listed(surfaces)}. {HELP}."
        )
    return wall


def _listed(names: Sequence[tuple[str | None, int]]) -> str:
    """Return names and tags for a message."""
    return ", ".join(f"{name or 'nameless'} = {tag}" for name, tag in names) or "none"


def _read_gmsh(path: Path) -> WallArrays:
    """Read the physical groups of a Gmsh file."""
    with _gmsh_model(path) as gmsh:
        tags, coordinates, _ = gmsh.model.mesh.getNodes()
        cells, cell_tags, layer_names = _read_groups(gmsh, path, 3)
        facets, facet_tags, surface_names = _read_groups(gmsh, path, 2)
        n_cells = sum(len(elements) for elements in gmsh.model.mesh.getElements(3)[1])
    if n_cells > len(cells):
        raise ValueError(
            f"{n_cells - len(cells)} cells of {path} are in no physical volume; {HELP}"
        )
    last = max(int(numbers.max(initial=0)) for numbers in (tags, cells, facets))
    # index of each node by Gmsh's number; −1 for a missing node, which check_rows detects
    number = np.full(last + 1, -1)
    number[tags] = np.arange(len(tags))
    return WallArrays(
        points=coordinates.reshape(-1, 3),
        cells=number[cells],
        cell_tags=cell_tags,
        facets=number[facets],
        facet_tags=facet_tags,
        layer_names=layer_names,
        surface_names=surface_names,
    )


@contextmanager
def _gmsh_model(path: Path) -> Iterator[ModuleType]:
    """Open a file in a new model of Gmsh, and restore the state of Gmsh afterwards."""
    gmsh = _import("gmsh", path)
    is_running = bool(gmsh.isInitialized())
    if not is_running:
        gmsh.initialize(readConfigFiles=False, interruptible=False)
        gmsh.option.setNumber("General.Terminal", 0)
    gmsh.model.add(str(path))
    try:
        try:
            gmsh.merge(str(path))
        except Exception as error:  # gmsh raises no other class
            raise ValueError(f"gmsh cannot read {path}: {error}") from error
        yield gmsh
    finally:
        gmsh.model.remove()
        if not is_running:
            gmsh.finalize()


def _read_groups(gmsh: ModuleType, path: Path, dim: int) -> tuple[Numbers, Numbers, dict[str, int]]:
    """Read the elements of all physical groups of one dimension.

    Args:
        gmsh: The module gmsh, with the model as the current one.
        path: The file, for messages.
        dim: 3 for cells, 2 for facets.

    Returns:
        Nodes of the elements in dolfinx's order, by Gmsh's node numbers, (n, nodes); their tags,
        (n,); and the tags of the names.

    Raises:
        ValueError: Two groups have the same name, an entity is in two groups, or elements are of a
            type that walls do not have.
    """
    names = _group_names(gmsh, path, dim)
    elements: list[Numbers] = []
    tags: list[Numbers] = [np.zeros(0, dtype=np.int64)]
    for entity, tag in _tags_of_entities(gmsh, path, dim).items():
        types, _, nodes_of_type = gmsh.model.mesh.getElements(dim, entity)
        for element_type, nodes in zip(types, nodes_of_type, strict=True):
            rows = _gmsh_elements(gmsh, path, dim, element_type, nodes)
            if elements and rows.shape[1] != elements[0].shape[1]:
                raise _unsupported_elements(gmsh, path, element_type)
            elements.append(rows)
            tags.append(np.full(len(rows), tag))
    all_elements = np.concatenate(elements or [np.zeros((0, dim + 1), dtype=np.int64)])
    all_tags = np.concatenate(tags)
    if not names:
        return all_elements, all_tags, with_default_names({}, all_tags, dim)
    return all_elements, all_tags, names_of(all_tags, names)


def _group_names(gmsh: ModuleType, path: Path, dim: int) -> dict[str, int]:
    """Return the names of the physical groups of one dimension, with their tags.

    Raises:
        ValueError: Two groups have the same name.
    """
    names: dict[str, int] = {}
    for _, tag in gmsh.model.getPhysicalGroups(dim):
        name = gmsh.model.getPhysicalName(dim, tag)
        if name and name in names:
            raise ValueError(
                f"{path} has two physical groups of dimension {dim} that are called {name!r}: "
                "join them, or give each a name of its own"
            )
        if name:
            names[name] = tag
    return names


def _tags_of_entities(gmsh: ModuleType, path: Path, dim: int) -> dict[int, int]:
    """Return the tag of the physical group of each entity of one dimension.

    Raises:
        ValueError: An entity is in two groups.
    """
    tag_of: dict[int, int] = {}
    for _, tag in gmsh.model.getPhysicalGroups(dim):
        for entity in gmsh.model.getEntitiesForPhysicalGroup(dim, tag):
            if entity in tag_of:
                groups = [
                    gmsh.model.getPhysicalName(dim, each) or str(each)
                    for each in (tag_of[entity], tag)
                ]
                raise ValueError(
                    f"{'Volume' if dim == 3 else 'Surface'} {entity} of {path} is in two physical "
                    f"groups, {groups[0]!r} and {groups[1]!r}: leave it in one of them"
                )
            tag_of[entity] = tag
    return tag_of


def _gmsh_elements(
    gmsh: ModuleType, path: Path, dim: int, element_type: int, nodes: Numbers
) -> Numbers:
    """Return the nodes of elements of one type in dolfinx's order, (n, nodes).

    Args:
        gmsh: The module gmsh.
        path: The file, for messages.
        dim: Dimension of the elements.
        element_type: Gmsh's number of the type.
        nodes: Nodes of all elements, one element after the other, in Gmsh's order.
    """
    n_nodes = gmsh.model.mesh.getElementProperties(element_type)[3]
    shapes = FACETS if dim == 2 else {n: kind.shape for n, kind in CELLS.items()}
    if n_nodes not in shapes:
        raise _unsupported_elements(gmsh, path, element_type)
    order = dolfinx.cpp.io.perm_gmsh(dolfinx.mesh.to_type(shapes[n_nodes]), n_nodes)
    return np.asarray(nodes.astype(np.int64).reshape(-1, n_nodes)[:, order])


def _unsupported_elements(gmsh: ModuleType, path: Path, element_type: int) -> ValueError:
    """Create the error about elements of a type that walls do not have, or of a second type."""
    name = gmsh.model.mesh.getElementProperties(element_type)[0]
    return ValueError(
        f"{path} has elements of type {name}; a wall has tetrahedra and triangles, or hexahedra "
        "and quadrilaterals, of one order, 1 or 2"
    )


def _read_meshio(path: Path) -> WallArrays:
    """Read tetrahedra and triangles with their cell data from a format that meshio reads."""
    meshio = _import("meshio", path)
    printed = io.StringIO()
    try:
        with redirect_stdout(printed), redirect_stderr(printed):
            mesh = meshio.read(path)
    except (Exception, SystemExit) as error:  # the errors differ between formats
        # For an unknown format meshio prints the reason and exits.
        reason = str(error)
        if isinstance(error, SystemExit):
            reason = " ".join(printed.getvalue().split())
        raise ValueError(
            f"meshio cannot read {path}: {reason or repr(error)}. Give a file of a format and an "
            "ending that meshio.read takes."
        ) from error
    blocks = {"triangle": np.zeros((0, 3)), **mesh.cells_dict}
    if "tetra" not in blocks or set(blocks) - {"tetra", "triangle", "line", "vertex"}:
        present = ", ".join(sorted(mesh.cells_dict)) or "none"
        message = f"{path} has cells of type {present}; a wall has tetra and triangle only"
        if not SECOND_ORDER.isdisjoint(mesh.cells_dict):
            message += CORNERS_ONLY.replace("PATH", str(path))
        raise ValueError(message)
    if mesh.points.ndim != 2 or mesh.points.shape[1] != 3:
        raise ValueError(f"{path} has points of shape {mesh.points.shape}: a wall lies in space")
    cell_tags = _cell_data(path, mesh, "tetra")
    facet_tags = _cell_data(path, mesh, "triangle")
    tagged = facet_tags > 0
    return WallArrays(
        points=np.asarray(mesh.points, dtype=np.float64),
        cells=blocks["tetra"].astype(np.int64),
        cell_tags=cell_tags,
        facets=blocks["triangle"][tagged].astype(np.int64),
        facet_tags=facet_tags[tagged],
        layer_names=with_default_names({}, cell_tags[cell_tags > 0], 3),
        surface_names=with_default_names({}, facet_tags[tagged], 2),
    )


def _cell_data(path: Path, mesh: Any, kind: str) -> Numbers:
    """Return the tags of meshio's cells of one type, (n,).

    Raises:
        ValueError: The file has no cell data of :data:`CELL_DATA`, or they are not integers.
    """
    if kind not in mesh.cells_dict:
        return np.zeros(0, dtype=np.int64)
    for name in CELL_DATA[kind]:
        if kind in mesh.cell_data_dict.get(name, {}):
            values = np.asarray(mesh.cell_data_dict[name][kind], dtype=np.float64)
            is_integer = (values == np.rint(values)) & (np.abs(values) <= np.iinfo(np.int32).max)
            if values.size != len(mesh.cells_dict[kind]) or not is_integer.all():
                raise ValueError(
                    f"{path}: the cell data {name!r} are not one integer of 32 bits for each {kind}"
                )
            return values.astype(np.int64).reshape(-1)
    if mesh.cell_sets:
        sets = ", ".join(mesh.cell_sets)
        raise ValueError(
            f"{path} has sets of cells ({sets}), but a wall is read from numbers, the cell data "
            f"{CELL_DATA[kind][0]}" + NUMBER_THE_SETS.replace("PATH", str(path))
        )
    raise ValueError(
        f"{path} has no cell data {' or '.join(CELL_DATA[kind])} for its {kind} cells; "
        f"found: {', '.join(mesh.cell_data) or 'none'}. {HELP}"
    )


def _import(name: str, path: Path) -> ModuleType:
    """Import an optional package; a ModuleNotFoundError with the remedy if it is missing."""
    try:
        return __import__(name)
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            f"Reading {path} needs the Python package {name}, which is not installed: "
            f"`pip install {name}` or `apt install python3-{name}`",
            name=name,
        ) from error
