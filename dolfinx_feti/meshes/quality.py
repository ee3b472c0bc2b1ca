# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Quality of tetrahedra and hexahedra.

The quality is Gmsh's minSICN, the signed inverse condition number of the map S from the regular
tetrahedron or the unit cube,

    q = 3 / (‖S‖ ‖S⁻¹‖) = 3 det S / (‖S‖ ‖cof S‖)   (Frobenius norms),

which is 1 for a regular tetrahedron or a cube, 0 for a flat cell, and negative for an inverted one.
The gradient of the map of a hexahedron varies: its quality is the smallest one at its corners.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import basix

from dolfinx_feti.runtime.arrays import Array, Numbers

__all__ = ["MeshQuality", "measure_hexahedra", "measure_quality", "tetrahedron_quality"]

#: Edges of a regular tetrahedron from its first corner, in columns, (3, 3).
REGULAR = np.array([[1, 0, 0], [1 / 2, 3**0.5 / 2, 0], [1 / 2, 3**0.5 / 6, (2 / 3) ** 0.5]]).T

HEXAHEDRON = basix.CellType.hexahedron

#: Degree of a rule that integrates det ∂x/∂ξ of a trilinear hexahedron exactly: it is of degree 2
#: in each coordinate.
VOLUME_DEGREE = 2

#: Bins of the histogram of qualities from 0 to 1.
BINS = 10


@dataclass(frozen=True, slots=True)
class MeshQuality:
    """Size and quality of a mesh.

    Attributes:
        points: Number of points.
        cells: Number of cells.
        minimum: Smallest quality.
        mean: Mean quality.
        histogram: Number of cells with a quality from 0, 0.1, …, 0.9 to 0.1 more, (10,). Inverted
            cells count as 0.
        volume: Volume [mm³].
        cell_name: ``tetrahedra`` or ``hexahedra``.
    """

    points: int
    cells: int
    minimum: float
    mean: float
    histogram: tuple[int, ...]
    volume: float
    cell_name: str = "tetrahedra"

    def __str__(self) -> str:
        """Return two lines for a log."""
        counts = "  ".join(f"{k / BINS:.1f}: {n}" for k, n in enumerate(self.histogram) if n)
        return (
            f"{self.cells} {self.cell_name}, {self.points} points, {self.volume:.4g} mm³, "
            f"quality (minSICN) {self.minimum:.3f} to {self.mean:.3f} on average\n"
            f"cells by quality, from {counts}"
        )


def tetrahedron_quality(edges: Array) -> Array:
    """Return the qualities of tetrahedra, (m,).

    Args:
        edges: Edges from the first corner to the three others, in columns, (m, 3, 3).
    """
    return _inverse_condition(edges @ np.linalg.inv(REGULAR))


def measure_quality(points: Array, cells: Numbers) -> MeshQuality:
    """Return size and quality of a mesh of tetrahedra.

    Args:
        points: Coordinates, (n, 3) [mm].
        cells: Corners of the tetrahedra, (m, 4); m = 0 is allowed.
    """
    corners = points[cells]
    edges = np.moveaxis(corners[:, 1:] - corners[:, :1], 1, 2)
    q = tetrahedron_quality(edges)
    return _mesh_quality(points, q, float(np.linalg.det(edges).sum() / 6), "tetrahedra")


def measure_hexahedra(points: Array, cells: Numbers) -> MeshQuality:
    """Return size and quality of a mesh of hexahedra.

    Args:
        points: Coordinates, (n, 3) [mm].
        cells: Corners of the hexahedra in basix's order, (m, 8); m = 0 is allowed.
    """
    corners = points[cells]
    q: Array = np.ones(len(cells))
    for J in _gradients(corners, np.asarray(basix.geometry(HEXAHEDRON))):
        q = np.minimum(q, _inverse_condition(J))
    places, weights = map(np.asarray, basix.make_quadrature(HEXAHEDRON, VOLUME_DEGREE))
    volume = 0.0
    for J, weight in zip(_gradients(corners, places), weights, strict=True):
        volume += float(weight * np.linalg.det(J).sum())
    return _mesh_quality(points, q, volume, "hexahedra")


def _gradients(corners: Array, ξ: Array) -> Array:
    """Return ∂x/∂ξ of trilinear hexahedra at points, (k, m, 3, 3).

    Args:
        corners: Corners in basix's order, (m, 8, 3).
        ξ: Points of the reference cell, (k, 3).
    """
    trilinear = basix.create_element(basix.ElementFamily.P, HEXAHEDRON, 1)
    dφ = np.asarray(trilinear.tabulate(1, ξ))[1:, :, :, 0]  # (3, k, 8)
    return np.asarray(np.einsum("jqn,cni->qcij", dφ, corners))


def _inverse_condition(S: Array) -> Array:
    """Return 3 det S / (‖S‖ ‖cof S‖), (m,), of matrices, (m, 3, 3); 0 for S = 0."""
    a, b, c = np.moveaxis(S, 2, 0)
    cofactors = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=2)
    det = np.sum(a * cofactors[:, :, 0], axis=1)
    norms = np.linalg.norm(S, axis=(1, 2)) * np.linalg.norm(cofactors, axis=(1, 2))
    return np.asarray(3 * det / np.maximum(norms, np.finfo(float).tiny))


def _mesh_quality(points: Array, q: Array, volume: float, cell_name: str) -> MeshQuality:
    """Return the summary of the qualities of all cells, (m,)."""
    counts, _ = np.histogram(np.clip(q, 0, 1), bins=BINS, range=(0, 1))
    return MeshQuality(
        points=len(points),
        cells=len(q),
        minimum=float(q.min(initial=1.0)),
        mean=float(q.mean()) if len(q) else 1.0,
        histogram=tuple(int(n) for n in counts),
        volume=volume,
        cell_name=cell_name,
    )
