# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The paper's cube on its coarsest level: each subdomain is a cell of 24 linear tetrahedra."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from hand_torn import Array, HandTorn, assembled, kernel, stiffness_of, tear

from dolfinx_feti.meshes.cube import CORNERS, FACES, TETRAHEDRA

POISSON = 0.45


def cube(
    subdomains: int,
    components: int = 3,
    fixed: Callable[[Array], npt.NDArray[np.bool_]] | None = None,
) -> HandTorn:
    """Tear a cube into one subdomain for each cell.

    Args:
        subdomains: Cells along an edge, 8 in the paper.
        components: Three for linear elasticity, one for the Laplace equation.
        fixed: Marks the Dirichlet dofs by the coordinates of the nodes in units of cells, (nodes,
            3) → (nodes, components); the whole surface, as in the paper, if not given.
    """
    nodes = np.full((7, 3), 0.5)  # the centre, and those of faces
    nodes[np.arange(1, 7), FACES[:, 0]] = FACES[:, 1]
    nodes = np.vstack([nodes, CORNERS])
    matrices = [element(nodes[tetrahedron], components) for tetrahedron in TETRAHEDRA]
    pattern, K_0 = assembled(list(TETRAHEDRA), matrices, components)
    corners = np.array(list(itertools.product(range(subdomains), repeat=3)))
    places = np.concatenate([nodes + corner for corner in corners])
    x, number = np.unique(np.round(2 * places).astype(int), axis=0, return_inverse=True)
    x = x / 2
    surface = np.any((x == 0.0) | (x == subdomains), axis=1)
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


def element(corners: Array, components: int) -> Array:
    """Return the stiffness of a linear tetrahedron with the given corners, (4, 3)."""
    edges = corners[1:] - corners[0]
    g = np.linalg.solve(edges, np.eye(4)[1:] - np.eye(4)[0])  # ∇φ, (3, 4)
    G = abs(np.linalg.det(edges)) / 6 * np.einsum("ia,jb->ijab", g, g)
    return stiffness_of(G, components, POISSON)
