# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Quadratic elements with bubbles, which a discontinuous linear pressure is stable with.

On a simplex with barycentric coordinates λ they are joined by the products :math:`λ_i λ_j λ_k` of
its faces and, in space, :math:`λ_1 λ_2 λ_3 λ_4` of the cell (Crouzeix and Raviart 1973; Ern and
Guermond 2004, 4.2.6). Bubbles of cells cost no dof on the interface.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

import basix
import basix.ufl

Floats = npt.NDArray[np.floating]


def quadratic_with_bubbles(cell: str, *, faces: bool = True) -> basix.ufl._ElementBase:
    """Enrich quadratic elements by the bubbles of cells, and of the faces of a tetrahedron.

    Returns:
        A scalar element, of which ``basix.ufl.blocked_element`` makes that of a displacement.

    Raises:
        ValueError: The cell is neither ``triangle`` nor ``tetrahedron``.
    """
    if cell not in ("triangle", "tetrahedron"):
        raise ValueError(f"cell is {cell!r}: bubbles are made for 'triangle' and 'tetrahedron'.")
    dim = 2 if cell == "triangle" else 3
    parts = [basix.ufl.element("Lagrange", cell, 2), basix.ufl.element("Bubble", cell, dim + 1)]
    if dim == 3 and faces:
        parts.append(_face_bubbles())
    return basix.ufl.enriched_element(parts)


def _face_bubbles() -> basix.ufl._ElementBase:
    """Return λ_i λ_j λ_k on the faces of a tetrahedron, with their values at the midpoints."""
    cell = basix.CellType.tetrahedron
    topology, corners = basix.topology(cell), np.asarray(basix.geometry(cell))
    x, w = (np.asarray(part, dtype=np.float64) for part in basix.make_quadrature(cell, 6))
    λ = np.column_stack([1.0 - x.sum(axis=1), x])
    bubbles = np.array([λ[:, face].prod(axis=1) for face in topology[2]])
    legendre = basix.tabulate_polynomials(basix.PolynomialType.legendre, cell, 3, x)
    points: list[list[Floats]] = [[np.zeros((0, 3)) for _ in entities] for entities in topology]
    dofs: list[list[Floats]] = [[np.zeros((0, 1, 0, 1)) for _ in part] for part in topology]
    points[2] = [corners[face].mean(axis=0)[None] for face in topology[2]]
    dofs[2] = [np.ones((1, 1, 1, 1)) for _ in topology[2]]
    span = (bubbles * w) @ np.asarray(legendre).T  # the bubbles in orthonormal polynomials
    kind = basix.MapType.identity, basix.SobolevSpace.H1
    return basix.ufl.custom_element(cell, (), span, points, dofs, 0, *kind, False, -1, 3)
