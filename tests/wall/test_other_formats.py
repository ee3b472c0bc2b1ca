# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Files in formats that cannot be read are refused with a command that converts them."""

from __future__ import annotations

import re

import numpy as np
import pytest
from collective import COMM, agree, raises

from dolfinx_feti.runtime.collective import on_root
from dolfinx_feti.wall import read_wall

POINTS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]])
TETRA = np.array([[0, 1, 2, 3], [1, 2, 3, 4]])
TRIANGLES = np.array([[0, 1, 2]])


def converted(message: str, folder) -> None:
    """Run the command of a message, which writes wall.vtu, in a folder."""
    meshio = pytest.importorskip("meshio")
    line = message[message.index('m = meshio.read("') :]
    line = re.split(r"; then read_wall", line)[0].replace('"wall.vtu"', f'"{folder}/wall.vtu"')
    exec(line, {"meshio": meshio, "np": np})


def refused(path) -> str:
    """Return the message of a file that is refused on all processes."""
    try:
        read_wall(path, COMM)
    except ValueError as error:
        return str(error)
    agree(False, f"{path} was read")
    raise AssertionError


@pytest.mark.parametrize("text", ["nonsense", ""])
@pytest.mark.parametrize("name", ["wall.unknown", "wall.vtu", "wall.med"])
def test_what_meshio_ends_at(name, text, tmp_path):
    """If meshio exits, the error has the reason that it printed."""
    pytest.importorskip("meshio")
    path = COMM.bcast(tmp_path) / name
    on_root(lambda: path.write_text(text), COMM)
    with raises(ValueError, r"meshio cannot read .*: .*\w{3}.*\. Give a file of a format"):
        read_wall(path, COMM)
    agree(not refused(path).startswith(f"meshio cannot read {path}: 1"), refused(path))


def test_cells_of_second_order(tmp_path):
    """Second-order cells are refused, and the message's command converts them."""
    meshio = pytest.importorskip("meshio")
    path = COMM.bcast(tmp_path) / "second.vtu"

    def write() -> None:
        points = list(POINTS)
        cells = []
        for cell in TETRA:
            pairs = [(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)]
            middle = [(POINTS[cell[a]] + POINTS[cell[b]]) / 2 for a, b in pairs]
            cells.append([*cell, *range(len(points), len(points) + 6)])
            points += middle
        corner = [0, 1, 2, *(cells[0][4 + k] for k in range(3))]
        blocks = [("tetra10", np.array(cells)), ("triangle6", np.array([corner]))]
        data = {"gmsh:physical": [np.array([3, 4]), np.array([7])]}
        meshio.Mesh(np.array(points), blocks, cell_data=data).write(path)

    on_root(write, COMM)
    message = refused(path)
    agree("tetra10" in message and "*.msh" in message, message)
    on_root(lambda: converted(message, path.parent), COMM)
    wall = read_wall(path.parent / "wall.vtu", COMM)
    agree(set(wall.layers) == {"layer_3", "layer_4"}, wall.layers)


def test_sets_of_abaqus(tmp_path):
    """Sets of Abaqus are refused, and the message's command converts them to tags."""
    meshio = pytest.importorskip("meshio")
    path = COMM.bcast(tmp_path) / "sets.inp"

    def write() -> None:
        sets = {
            "media": [np.array([0, 1]), np.array([], dtype=int)],
            "lumen": [np.array([], dtype=int), np.array([0])],
        }
        blocks = [("tetra", TETRA), ("triangle", TRIANGLES)]
        meshio.Mesh(POINTS, blocks, cell_sets=sets).write(path)

    on_root(write, COMM)
    message = refused(path)
    agree("sets of cells (media, lumen)" in message, message)
    on_root(lambda: converted(message, path.parent), COMM)
    names = {"media": (3, 1), "lumen": (2, 2)}
    wall = read_wall(path.parent / "wall.vtu", COMM, names=names)
    agree(set(wall.layers) == {"media"}, wall.layers)
    agree(set(wall.surfaces) == {"lumen"}, wall.surfaces)
