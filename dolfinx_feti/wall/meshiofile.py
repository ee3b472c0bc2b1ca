# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Walls in files that meshio reads: straight tetrahedra with numbers in cell data."""

from __future__ import annotations

import io
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np

from dolfinx_feti.runtime.arrays import Numbers
from dolfinx_feti.wall.names import with_default_names
from dolfinx_feti.wall.reading import NAMING_HELP, import_reader
from dolfinx_feti.wall.wall_arrays import WallArrays

__all__ = ["read_meshio"]

#: Names of the cell data with tags, by meshio's type of cell. Of those in a file, the first is
#: used.
CELL_DATA = {
    "tetra": ("layer", "gmsh:physical", "medit:ref", "tag"),
    "triangle": ("surface", "gmsh:physical", "medit:ref", "tag"),
}

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


def read_meshio(path: Path) -> WallArrays:
    """Read tetrahedra and triangles with their cell data from a format that meshio reads. Serial.

    Args:
        path: The file.

    Raises:
        ModuleNotFoundError: The Python package meshio is not installed.
        ValueError: meshio cannot read the file, or it is no wall of straight tetrahedra with tags.
    """
    meshio = import_reader("meshio", path)
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


def _cell_data(path: Path, mesh: Any, cell_type: str) -> Numbers:
    """Return the tags of meshio's cells of one type, ``tetra`` or ``triangle``, (n,).

    Raises:
        ValueError: The file has no cell data of :data:`CELL_DATA`, or they are not integers.
    """
    if cell_type not in mesh.cells_dict:
        return np.zeros(0, dtype=np.int64)
    for name in CELL_DATA[cell_type]:
        if cell_type in mesh.cell_data_dict.get(name, {}):
            values = np.asarray(mesh.cell_data_dict[name][cell_type], dtype=np.float64)
            is_integer = (values == np.rint(values)) & (np.abs(values) <= np.iinfo(np.int32).max)
            if values.size != len(mesh.cells_dict[cell_type]) or not is_integer.all():
                raise ValueError(
                    f"{path}: the cell data {name!r} are not one integer of 32 bits for "
                    f"each {cell_type}"
                )
            return values.astype(np.int64).reshape(-1)
    if mesh.cell_sets:
        sets = ", ".join(mesh.cell_sets)
        raise ValueError(
            f"{path} has sets of cells ({sets}), but a wall is read from numbers, the cell data "
            f"{CELL_DATA[cell_type][0]}" + NUMBER_THE_SETS.replace("PATH", str(path))
        )
    raise ValueError(
        f"{path} has no cell data {' or '.join(CELL_DATA[cell_type])} for its {cell_type} cells; "
        f"found: {', '.join(mesh.cell_data) or 'none'}. {NAMING_HELP}"
    )
