# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Quadratic elements with bubbles, for displacements with a discontinuous linear pressure.

Together with the pressure ("DG", 1) they are stable if all bubbles are present: cell bubbles in the
plane, face and cell bubbles in space. Without the face bubbles they are not stable in space
(docs/elements.md).

The bubbles of a simplex with barycentric coordinates λ are :math:`λ_i λ_j λ_k` of its faces and, in
three dimensions, :math:`λ_1 λ_2 λ_3 λ_4` of the cell (Crouzeix and Raviart 1973; Ern and Guermond
2004, 4.2.6). Bubbles of cells add no dof to the interface.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

import basix
import basix.ufl

Floats = npt.NDArray[np.floating]

#: Polynomial degree of λ_i λ_j λ_k.
FACE_BUBBLE_DEGREE = 3


def quadratic_with_bubbles(cell: str, *, faces: bool = True) -> basix.ufl._ElementBase:
    """Return the quadratic element with the bubbles of cells, and of faces of a tetrahedron.

    Args:
        cell: ``triangle`` or ``tetrahedron``.
        faces: False to leave out the bubbles of a tetrahedron's faces.

    Returns:
        A scalar element; ``basix.ufl.blocked_element`` turns it into one of a displacement.

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
    """Return the element of λ_i λ_j λ_k on the faces of a tetrahedron; dofs are midpoint values.

    basix takes the basis functions as coefficients of its orthonormal Legendre polynomials, and
    each dof as points with weights M, (dofs, values, points, derivatives).
    """
    cell = basix.CellType.tetrahedron
    topology = basix.topology(cell)
    corners = np.asarray(basix.geometry(cell))
    points_and_weights = basix.make_quadrature(cell, 2 * FACE_BUBBLE_DEGREE)
    x, w = (np.asarray(part, dtype=np.float64) for part in points_and_weights)
    λ = np.column_stack([1.0 - x.sum(axis=1), x])
    bubbles = np.array([λ[:, face].prod(axis=1) for face in topology[2]])
    legendre = basix.tabulate_polynomials(
        basix.PolynomialType.legendre, cell, FACE_BUBBLE_DEGREE, x
    )
    coefficients = (bubbles * w) @ np.asarray(legendre).T  # ∫ bubble · polynomial
    points: list[list[Floats]] = []  # of the dofs of each entity, by dimension
    weights: list[list[Floats]] = []  # M of the values there, (dofs, 1, points, 1)
    for dimension, entities in enumerate(topology):
        if dimension == 2:
            points.append([corners[face].mean(axis=0)[None] for face in entities])
            weights.append([np.ones((1, 1, 1, 1)) for _ in entities])
        else:
            points.append([np.zeros((0, 3)) for _ in entities])
            weights.append([np.zeros((0, 1, 0, 1)) for _ in entities])
    return basix.ufl.custom_element(
        cell_type=cell,
        reference_value_shape=(),
        wcoeffs=coefficients,
        x=points,
        M=weights,
        interpolation_nderivs=0,
        map_type=basix.MapType.identity,
        sobolev_space=basix.SobolevSpace.H1,
        discontinuous=False,
        embedded_subdegree=-1,  # the bubbles span no polynomials of a degree, not even constants
        embedded_superdegree=FACE_BUBBLE_DEGREE,
    )
