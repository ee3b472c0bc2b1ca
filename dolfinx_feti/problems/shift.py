# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The shift of an indefinite tangent: how it grows and falls.

.. math:: K' + σ \operatorname{diag}|k|

σ is relative to the stiffness k of the dofs and has no unit; zero stands for the tangent itself.
"""

from __future__ import annotations

__all__ = ["fallen", "raised"]

#: The first shift, its growth, and the largest one that is tried.
LEAST_SHIFT, SHIFT_GROWTH = 1e-4, 4.0
LARGEST_SHIFT = LEAST_SHIFT * SHIFT_GROWTH**7


def raised(sigma: float) -> float | None:
    """Return the next larger shift, or None if there is none to try."""
    larger = max(LEAST_SHIFT, SHIFT_GROWTH * sigma)
    return larger if larger <= LARGEST_SHIFT else None


def fallen(sigma: float, *, grown: bool) -> float:
    """Return the shift with which the next Newton step begins.

    Args:
        sigma: Shift of the last step.
        grown: Whether it had to grow in that step; it then falls by one power of the growth and not
            by two.
    """
    smaller = sigma / (SHIFT_GROWTH if grown else SHIFT_GROWTH**2)
    return smaller if smaller >= LEAST_SHIFT / SHIFT_GROWTH else 0.0
