# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Views: the direction from which bodies are drawn, and the scale."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dolfinx_feti.output.surfaces import BodySurface
from dolfinx_feti.runtime.arrays import Array

__all__ = ["View", "view_of"]

#: Direction from a body to the viewer: from the right, in front and above.
VIEWER = np.array([0.40, -0.85, 0.34])

#: Ratio of two successive singular values of the cloud of points above which the body is longer in
#: one direction than in the next. A longer body lies on its side; a cube stays upright.
ELONGATED = 1.3

#: Cosine of the angle between the longest direction of a body and a coordinate axis above which the
#: body is drawn along this axis: the angle is less than 20 degrees.
ALONG_AXIS = 0.94

#: Cosine of the angle between the direction to the viewer and the upward one above which a body is
#: seen from above or below. The upward direction in the picture is then the one to the back: it
#: must not be parallel to the direction to the viewer.
SEEN_FROM_ABOVE = 1.0 - 1e-6


@dataclass(frozen=True, slots=True)
class View:
    """A parallel projection.

    Attributes:
        viewer: Direction from the body to the viewer, (3,), a unit vector.
        up: Direction that is upwards in the picture, (3,).
        half_height: Half the height of the window, in the unit of length.
    """

    viewer: Array
    up: Array
    half_height: float


def view_of(surfaces: Sequence[BodySurface], viewer: Sequence[float] | None) -> View:
    """Return the view of all bodies at which the largest fits into the window.

    Args:
        surfaces: Surfaces of the bodies; the first one determines the direction.
        viewer: Direction from the body to the viewer, of any length; by default from the right, in
            front and above.

    Raises:
        ValueError: ``viewer`` is zero or not finite, and the bodies are not plane.
    """
    half_height = max(float(np.linalg.norm(np.ptp(s.points, axis=0))) / 2.0 for s in surfaces)
    if surfaces[0].is_plane:
        return View(np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0]), half_height)
    axes = _axes(surfaces[0].points)
    direction = VIEWER @ axes if viewer is None else np.asarray(viewer, dtype=np.float64)
    length = np.linalg.norm(direction)
    if not 0.0 < length < np.inf:
        raise ValueError(f"viewer={viewer}: give a finite direction that is not zero.")
    direction = direction / length
    up = axes[2]
    if abs(float(direction @ up)) > SEEN_FROM_ABOVE:
        up = axes[1]
    return View(direction, up, half_height)


def _axes(points: Array) -> Array:
    """Return the directions to the right, to the back and upwards as rows, (3, 3).

    A body that is longer than it is wide lies on its side: its first principal axis, or a
    coordinate axis close to it, points to the right. Its second principal axis points upwards. If
    this axis is arbitrary, as in a tube, a coordinate axis points upwards. For all other bodies x
    points to the right and z upwards.
    """
    x = points - points.mean(axis=0)
    _, lengths, directions = np.linalg.svd(x, full_matrices=False)
    right = directions[0]
    right = right * np.sign(right[np.argmax(np.abs(right))])  # the largest component is positive
    if lengths[0] < ELONGATED * lengths[1]:
        return np.eye(3)
    axis = int(np.argmax(np.abs(right)))
    if abs(right[axis]) > ALONG_AXIS:
        right = np.eye(3)[axis]
    up = directions[1]
    if lengths[1] < ELONGATED * lengths[2]:  # the second axis is arbitrary
        up = np.eye(3)[2 if axis != 2 else 0]
    up = up - (up @ right) * right
    up = up * np.sign(up[np.argmax(np.abs(up))]) / np.linalg.norm(up)
    return np.array([right, np.cross(up, right), up])
