# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Rigid body motions that the conditions on a wall leave free.

With the translations and the rotations about the wall's middle as columns of R(X), (3, 6), what
holds the wall gives the matrix

    G = Σ ∫ R(X)ᵀ P R(X) dA,        P = I, e_k e_kᵀ or N Nᵀ,

for clamps and springs in all directions, for surfaces that slide in a plane normal to e_k, and for
springs along the normal N. Its null space holds the motions that are free. Dashpots hold nothing.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dolfinx_feti.wall.conditions import Clamp, Condition, Conditions, Slide, Spring, by_surface
from dolfinx_feti.wall.wall import Wall, corners, extent, plane

__all__ = ["free_motions"]

Array = npt.NDArray[np.float64]

#: Below this share of the largest one an eigenvalue of G counts as zero.
FREE = 1e-9

#: Points of a quadrature of second degree on a triangle, in barycentric coordinates.
MIDDLES = np.array([[1.0, 1.0, 0.0], [0.0, 1.0, 1.0], [1.0, 0.0, 1.0]]) / 2.0


def free_motions(wall: Wall, conditions: Conditions) -> int:
    """Return how many of the six rigid body motions nothing holds.

    Args:
        wall: The wall.
        conditions: On its surfaces; other Dirichlet conditions are not known here.

    Raises:
        ValueError: The wall has no such surface, or one that slides lies in no plane. On all
            processes.

    Note:
        Collective.
    """
    low, high = extent(wall.mesh)
    middle, length = (low + high) / 2.0, float(np.linalg.norm(high - low))
    G = np.zeros((6, 6))
    for name, given in by_surface(conditions).items():
        for condition in given:
            x = corners(wall, name)
            P = _projections(wall, name, condition, x)
            if P is None:
                continue
            area = np.linalg.norm(_area_vectors(x), axis=1)
            for at in np.einsum("qk,fkd->qfd", MIDDLES, x):
                R = _motions((at - middle) / length)
                G += np.einsum("f,fia,fij,fjb->ab", area / 3.0, R, P, R)
    eigenvalues = np.linalg.eigvalsh(wall.mesh.comm.allreduce(G))
    return int(np.sum(eigenvalues <= FREE * max(eigenvalues[-1], np.finfo(float).tiny)))


def _projections(wall: Wall, name: str, condition: Condition, x: Array) -> Array | None:
    """Return P on each facet, (facets, 3, 3); None if the condition holds nothing."""
    match condition:
        case Clamp() | Spring(direction="all"):
            return np.tile(np.eye(3), (len(x), 1, 1))
        case Slide():
            e = np.eye(3)[plane(wall, name)[0]]
            return np.tile(np.outer(e, e), (len(x), 1, 1))
        case Spring():
            n = _area_vectors(x)
            n /= np.linalg.norm(n, axis=1, keepdims=True)
            return np.asarray(n[:, :, None] * n[:, None, :])
    return None


def _area_vectors(x: Array) -> Array:
    """Return the area vectors of triangles, of either sign, (facets, 3)."""
    return np.asarray(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]) / 2.0)


def _motions(x: Array) -> Array:
    """Return translations and rotations, (points, 3, 6)."""
    e = np.eye(3)
    rotations = np.stack([np.cross(axis, x) for axis in e], axis=2)
    return np.concatenate([np.tile(e, (len(x), 1, 1)), rotations], axis=2)
