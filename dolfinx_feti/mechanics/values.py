# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Numbers that a user gives, each within the range where it has a meaning."""

from __future__ import annotations

import math
from collections.abc import Mapping
from numbers import Real

from ufl.core.expr import Expr

__all__ = ["require_finite", "require_not_negative", "require_positive", "require_within"]


def require_within(
    low: float,
    high: float,
    values: Mapping[str, object],
    *,
    ends: bool = True,
    remedy: str = "",
    sign: str = " = ",
) -> None:
    """Refuse numbers that are not finite or out of a range; UFL expressions are not checked.

    Args:
        low: The least value.
        high: The greatest value.
        values: The numbers by the names of the arguments.
        ends: Whether both belong to the range; an infinite one never does.
        remedy: What to give instead; the range if empty.
        sign: What the message puts between name and value.

    Raises:
        TypeError: One is no number.
        ValueError: One is out of the range.
    """
    words = ("from", "to") if ends else ("between", "and")
    for name, value in values.items():
        if isinstance(value, Expr):
            continue
        if isinstance(value, bool) or not isinstance(value, Real):
            raise TypeError(f"{name}{sign}{value!r}: expected a number or a UFL expression.")
        x = float(value)
        if not (math.isfinite(x) and (low <= x <= high if ends else low < x < high)):
            between = f"a number {words[0]} {low:g} {words[1]} {high:g}"
            raise ValueError(f"{name}{sign}{value}: give {remedy or between}.")


def require_positive(**values: object) -> None:
    """Refuse numbers that are not finite and positive; see :func:`require_within`."""
    require_within(0.0, math.inf, values, ends=False, remedy="a positive number")


def require_not_negative(**values: object) -> None:
    """Refuse numbers that are negative or not finite; see :func:`require_within`."""
    require_within(0.0, math.inf, values, remedy="a finite number that is not negative")


def require_finite(**values: object) -> None:
    """Refuse numbers that are not finite; see :func:`require_within`."""
    require_within(-math.inf, math.inf, values, remedy="a finite number")
