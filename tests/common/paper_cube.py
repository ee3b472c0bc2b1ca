# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The cube of the paper: subcubes of cells of 24 tetrahedra, linear elements, clamped all round."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from hand_torn import Array, HandTorn, assembled, kernel, stiffness_of, tear

POISSON = 0.45


def cube(
    subdomains: int,
    cells: int,
    components: int = 3,
    fixed: Callable[[Array], npt.NDArray[np.bool_]] | None = None,
) -> HandTorn:
    """Tear a cube of subdomains³ subcubes of cells³ cells each.

    Args:
        subdomains: Their number along an edge, 8 in the paper.
        cells: Cells along the edge of a subcube, 1, 2, 4, … in the paper.
        components: Three for linear elasticity, one for the Laplace equation.
        fixed: Marks the Dirichlet dofs, (nodes, components), of nodes at x, (nodes, 3), in units of
            cells; if not given the whole surface, as in the paper.
    """
    nodes, tetrahedra = subcube(cells)
    matrices = [element(nodes[tetrahedron], components) for tetrahedron in tetrahedra]
    pattern, K_0 = assembled(list(tetrahedra), matrices, components)
    corners = cells * np.array(list(itertools.product(range(subdomains), repeat=3)))
    places = np.concatenate([nodes + corner for corner in corners])
    x, number = np.unique(np.round(2 * places).astype(int), axis=0, return_inverse=True)
    x = x / 2
    surface = np.any((x == 0.0) | (x == subdomains * cells), axis=1)
    mark = np.repeat(surface[:, None], components, axis=1) if fixed is None else fixed(x)
    dofs = number.reshape(-1, 1) * components + np.arange(components)
    return tear(
        [K_0] * subdomains**3,
        list(dofs.reshape(subdomains**3, -1)),
        x,
        kernel(x, components),
        mark.ravel(),
        pattern=pattern,
    )


def subcube(cells: int) -> tuple[Array, npt.NDArray[np.int64]]:
    """Mesh a subcube: its nodes, and its tetrahedra from cell centre, face centre and an edge."""
    tetrahedra = []
    for cell in itertools.product(range(cells), repeat=3):
        centre = np.array(cell) + 0.5
        for axis, side in itertools.product(range(3), (-0.5, 0.5)):
            face = centre + side * np.eye(3)[axis]
            a, b = 0.5 * np.delete(np.eye(3), axis, 0)
            ring = [face + a + b, face + a - b, face - a - b, face - a + b]
            tetrahedra += [[centre, face, ring[j], ring[j - 1]] for j in range(4)]
    corners = np.array(tetrahedra).reshape(-1, 3)
    nodes, number = np.unique(np.round(2 * corners).astype(int), axis=0, return_inverse=True)
    return nodes / 2, number.reshape(-1, 4)


def element(corners: Array, components: int) -> Array:
    """Stiffness of a tetrahedron with linear shape functions."""
    edges = corners[1:] - corners[0]
    g = np.linalg.solve(edges, np.eye(4)[1:] - np.eye(4)[0])  # ∇φ, (3, 4)
    G = abs(np.linalg.det(edges)) / 6 * np.einsum("ia,jb->ijab", g, g)
    return stiffness_of(G, components, POISSON)
