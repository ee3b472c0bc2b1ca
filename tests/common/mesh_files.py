# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Areas and volumes of walls, and surfaces to grow them on."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import numpy.typing as npt
from collective import agree, equal

from dolfinx_feti.meshes import tube
from dolfinx_feti.wall.wall_arrays import WallArrays

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]


def areas(wall: WallArrays) -> dict[str, float]:
    """Return the area of each surface [mm²]."""
    a, b, c = np.moveaxis(wall.points[wall.facets], 1, 0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    return {n: area[wall.facet_tags == t].sum() for n, t in wall.surface_names.items()}


def volumes(wall: WallArrays) -> dict[str, float]:
    """Return the volume of each layer [mm³]."""
    volume = np.abs(np.linalg.det(wall.points[wall.cells[:, 1:]] - wall.points[wall.cells[:, :1]]))
    return {n: volume[wall.cell_tags == t].sum() / 6 for n, t in wall.layer_names.items()}


def watertight(wall: WallArrays) -> None:
    """Assert that the facets are the faces of a single cell, each of them once."""
    faces = wall.cells[:, [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]].reshape(-1, 3)
    sorted_faces, count = np.unique(np.sort(faces, axis=1), axis=0, return_counts=True)
    agree(count.max() == 2)
    equal(np.unique(np.sort(wall.facets, axis=1), axis=0), sorted_faces[count == 1])
    agree(len(wall.facets) == np.sum(count == 1))


def pipe(
    n: int = 24, m: int = 12, radius: float = 3.0, length: float = 10.0
) -> tuple[Array, Indices]:
    """Return points and triangles of a straight lumen with open ends, triangles facing outwards."""
    axis, t, _ = tube.unit_tube(n, m, quarter=False)
    return axis * [radius, radius, length], t


def write_stl(path: Path, x: Array, t: Indices, *, binary: bool) -> Path:
    """Write a surface in binary, or as text, which is compressed if the name ends in ``.gz``."""
    if binary:
        record = np.zeros(len(t), dtype=[("n", "<f4", 3), ("x", "<f4", (3, 3)), ("a", "<u2")])
        record["x"] = x[t]
        path.write_bytes(b"\0" * 80 + np.uint32(len(t)).tobytes() + record.tobytes())
        return path
    corner = "\n".join(
        "facet\nouter loop\n{}\nendloop\nendfacet".format(
            "\n".join("vertex {:.9g} {:.9g} {:.9g}".format(*p) for p in x[s])
        )
        for s in t
    )
    text = f"solid pipe\n{corner}\nendsolid pipe\n".encode()
    path.write_bytes(gzip.compress(text) if path.suffix == ".gz" else text)
    return path
