# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A wall as arrays, the quality of its tetrahedra, and its file in Gmsh's format or XDMF.

The quality is Gmsh's minSICN, the signed inverse condition number of the map S from the regular
tetrahedron,

    q = 3 / (‖S‖ ‖S⁻¹‖) = 3 det S / (‖S‖ ‖cof S‖)   (Frobenius norms),

which is 1 for a regular tetrahedron, 0 for a flat one, and negative for one that is inside out.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dolfinx_feti.meshes.surface import Indices, Points

__all__ = ["TAGS", "Quality", "WallMesh", "measure_quality", "write_mesh", "write_msh"]

#: Tags of the layers and surfaces; opening k has 10 + k.
TAGS = {"media": 1, "adventitia": 2, "lumen": 3, "outer": 4, "symmetry_x": 5, "symmetry_y": 6}
TAGS |= {f"opening_{k}": 10 + k for k in range(1, 90)}

#: Edges of a regular tetrahedron from its first corner, in columns, (3, 3).
REGULAR = np.array([[1, 0, 0], [1 / 2, 3**0.5 / 2, 0], [1 / 2, 3**0.5 / 6, (2 / 3) ** 0.5]]).T


@dataclass(frozen=True, slots=True)
class WallMesh:
    """A wall of tetrahedra.

    Attributes:
        points: Coordinates, (n, 3) [mm].
        cells: Tetrahedra, (m, 4).
        layers: The tag of each cell's layer, (m,).
        facets: Triangles of the boundary, (k, 3).
        surfaces: The tag of each facet's surface, (k,).
    """

    points: Points
    cells: Indices
    layers: Indices
    facets: Indices
    surfaces: Indices


@dataclass(frozen=True, slots=True)
class Quality:
    """Size and quality of a mesh.

    Attributes:
        points: Number of points.
        cells: Number of tetrahedra.
        minimum: Smallest quality.
        mean: Mean quality.
        histogram: Numbers of cells of quality below 0.1, 0.2, …, 1.0, (10,).
        volume: Volume [mm³].
    """

    points: int
    cells: int
    minimum: float
    mean: float
    histogram: tuple[int, ...]
    volume: float

    def __str__(self) -> str:
        """Return two lines for a log."""
        counts = "  ".join(f"{k / 10:.1f}: {n}" for k, n in enumerate(self.histogram) if n)
        return (
            f"{self.cells} tetrahedra, {self.points} points, {self.volume:.4g} mm³, "
            f"quality (minSICN) {self.minimum:.3f} to {self.mean:.3f} on average\n"
            f"cells by quality, from {counts}"
        )


def tetrahedron_quality(edges: Points) -> Points:
    """Return the qualities of tetrahedra.

    Args:
        edges: The edges from the first corner to the three others, in columns, (m, 3, 3).

    Returns:
        q, (m,).
    """
    S = edges @ np.linalg.inv(REGULAR)
    a, b, c = np.moveaxis(S, 2, 0)
    cofactors = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=2)
    det = np.sum(a * cofactors[:, :, 0], axis=1)
    norms = np.linalg.norm(S, axis=(1, 2)) * np.linalg.norm(cofactors, axis=(1, 2))
    return np.asarray(3 * det / np.maximum(norms, np.finfo(float).tiny))


def measure_quality(mesh: WallMesh) -> Quality:
    """Return the quality of a mesh, with its histogram."""
    corners = mesh.points[mesh.cells]
    edges = np.moveaxis(corners[:, 1:] - corners[:, :1], 1, 2)
    q = tetrahedron_quality(edges)
    counts, _ = np.histogram(np.clip(q, 0, 1), bins=10, range=(0, 1))
    return Quality(
        points=len(mesh.points),
        cells=len(mesh.cells),
        minimum=float(q.min(initial=1.0)),
        mean=float(q.mean()) if len(q) else 1.0,
        histogram=tuple(int(n) for n in counts),
        volume=float(np.linalg.det(edges).sum() / 6),
    )


def write_mesh(path: Path, mesh: WallMesh, names: Mapping[str, int] = TAGS) -> None:
    """Write an XDMF file, which all processes read, or a Gmsh file.

    Args:
        path: The file, `*.xdmf`, which needs dolfinx, or `*.msh`; its folder is created.
        mesh: The wall.
        names: Tags of the names; those that the mesh does not have are left out.
    """
    if path.suffix != ".xdmf":
        return write_msh(path, mesh, names)
    from mpi4py import MPI

    from dolfinx_feti.wall.wall_arrays import WallArrays, distribute
    from dolfinx_feti.wall.xdmf import write_wall

    raw = WallArrays(
        points=mesh.points,
        cells=mesh.cells,
        layers=mesh.layers,
        facets=mesh.facets,
        surfaces=mesh.surfaces,
        layer_names=_present(names, mesh.layers),
        surface_names=_present(names, mesh.surfaces),
    )
    write_wall(path, distribute(raw, MPI.COMM_SELF))


def _present(names: Mapping[str, int], tags: Indices) -> dict[str, int]:
    """Return the names of the tags that occur."""
    return {name: tag for name, tag in names.items() if np.any(tags == tag)}


def write_msh(path: Path, mesh: WallMesh, names: Mapping[str, int] = TAGS) -> None:
    """Write a Gmsh file, version 2.2, with the layers and surfaces as named physical groups.

    It is written under a temporary name and renamed at the end, so no incomplete file remains.

    Args:
        path: The file, `*.msh`; its folder is created.
        mesh: The wall.
        names: Tags of the names; those that the mesh does not have are left out.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.stem}-{os.getpid()}{path.suffix}")
    surfaces = _present(names, mesh.surfaces)
    layers = _present(names, mesh.layers)
    groups = [f'2 {tag} "{name}"' for name, tag in surfaces.items()]
    groups += [f'3 {tag} "{name}"' for name, tag in layers.items()]
    number = np.arange(1, len(mesh.points) + 1)
    first = 1 + len(mesh.facets)
    elements = [
        _elements(1, 2, mesh.facets, mesh.surfaces),
        _elements(first, 4, mesh.cells, mesh.layers),
    ]
    try:
        with temporary.open("wb") as file:
            head = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$PhysicalNames", str(len(groups))]
            head += [*groups, "$EndPhysicalNames", "$Nodes", str(len(number))]
            file.write("\n".join([*head, ""]).encode())
            np.savetxt(file, np.column_stack([number, mesh.points]), fmt="%d %.12g %.12g %.12g")
            count = sum(len(table) for table in elements)
            file.write(f"$EndNodes\n$Elements\n{count}\n".encode())
            for table in elements:
                np.savetxt(file, table, fmt="%d")
            file.write(b"$EndElements\n")
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def _elements(first: int, kind: int, corners: Indices, tags: Indices) -> Indices:
    """Return the lines of Gmsh elements: number, kind, two tags, the physical and the entity's."""
    number = first + np.arange(len(tags))
    kinds = np.full(len(tags), kind)
    tag_counts = np.full(len(tags), 2)
    return np.column_stack([number, kinds, tag_counts, tags, tags, corners + 1])
