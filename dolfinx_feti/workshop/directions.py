# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Directions on the sphere: a search among many, refined by an optimiser.

The functions of a direction n here are even, f(−n) = f(n), so that a hemisphere is enough.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import scipy.optimize

__all__ = ["hemisphere", "minimise", "tangents"]

Array = npt.NDArray[np.float64]

#: Directions of a search; their spacing is some 7°.
N_DIRECTIONS = 400


def hemisphere(n: int = N_DIRECTIONS) -> Array:
    """Return n evenly spread directions with z > 0, a Fibonacci lattice, (n, 3)."""
    z = (np.arange(n) + 0.5) / n
    φ = np.arange(n) * np.pi * (3 - np.sqrt(5))
    r = np.sqrt(1 - z**2)
    return np.column_stack((r * np.cos(φ), r * np.sin(φ), z))


def tangents(n: Array) -> Array:
    """Return two orthonormal vectors normal to each direction, as columns, (…, 3, 2)."""
    helper = np.eye(3)[np.abs(n).argmin(axis=-1)]
    t1 = np.cross(n, helper)
    t1 /= np.linalg.norm(t1, axis=-1, keepdims=True)
    return np.stack((t1, np.cross(n, t1)), axis=-1)


def minimise(f: Callable[[Array], float], start: Array) -> tuple[float, Array]:
    """Minimise a function of a direction by BFGS, in the plane tangent to the sphere at the start.

    Args:
        f: Function of a unit vector (3,).
        start: Unit vector near the minimum.

    Returns:
        The least value, no larger than that at the start, and its direction.
    """
    T = tangents(start)

    def direction(y: Array) -> Array:
        n = start + T @ y
        return n / np.linalg.norm(n)

    optimum = scipy.optimize.minimize(lambda y: f(direction(y)), np.zeros(2), method="BFGS")
    best = min((start, direction(optimum.x)), key=f)
    return f(best), best
