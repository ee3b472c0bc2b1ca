# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Checks of a user's arguments: numbers in the range where they have a meaning, and types.

Each check takes the values by their names, which the message repeats. A wrong value has a message
with "=", ``c = -1.0: give a positive number.``; a wrong type has one with "is", ``mesh is None:
give dolfinx.mesh.Mesh.`` A public function checks types if a wrong one would fail late, or with an
error that does not name the argument, such as ``state=u`` in place of ``state=[u]``.
"""

from __future__ import annotations

import math
import reprlib
from collections.abc import Mapping, Sequence
from numbers import Real

import numpy as np

from ufl.core.expr import Expr

__all__ = [
    "require_finite",
    "require_not_negative",
    "require_number",
    "require_positive",
    "require_sequence",
    "require_type",
    "require_within",
]

#: Values in messages, cut to a line.
_REPR = reprlib.Repr()
_REPR.maxother = 80


def require_within(
    low: float,
    high: float,
    values: Mapping[str, object],
    *,
    includes_ends: bool = True,
    remedy: str = "",
) -> None:
    """Check that values are finite numbers in a range. UFL expressions are not checked.

    The values are a mapping here, not keywords, as their names may be those of a user.

    Args:
        low: Lower end of the range.
        high: Upper end.
        values: The values by name.
        includes_ends: Whether low and high belong to the range.
        remedy: What to give instead; by default a number in the range.

    Raises:
        TypeError: A value is neither a number nor a UFL expression.
        ValueError: A number is not finite, or out of the range.
    """
    for name, value in values.items():
        if isinstance(value, Expr):
            continue
        if isinstance(value, bool) or not isinstance(value, Real):
            raise TypeError(f"{name} = {value!r}: expected a number or a UFL expression.")
        x = float(value)
        is_inside = low <= x <= high if includes_ends else low < x < high
        if not (math.isfinite(x) and is_inside):
            words = ("from", "to") if includes_ends else ("between", "and")
            in_range = f"a number {words[0]} {low:g} {words[1]} {high:g}"
            raise ValueError(f"{name} = {value}: give {remedy or in_range}.")


def require_positive(**values: object) -> None:
    """Check that values are finite and positive; see :func:`require_within`."""
    require_within(0.0, math.inf, values, includes_ends=False, remedy="a positive number")


def require_not_negative(**values: object) -> None:
    """Check that values are finite and not negative; see :func:`require_within`."""
    require_within(0.0, math.inf, values, remedy="a finite number that is not negative")


def require_finite(**values: object) -> None:
    """Check that values are finite; see :func:`require_within`."""
    require_within(-math.inf, math.inf, values, remedy="a finite number")


def require_number(**values: object) -> None:
    """Check that values are real numbers, and neither bool nor UFL expressions.

    Raises:
        TypeError: ``first is 'a': give float.``
    """
    for name, value in values.items():
        if isinstance(value, bool) or not isinstance(value, Real):
            raise TypeError(f"{name} is {_REPR.repr(value)}: give float.")


def require_type(expected: type | tuple[type, ...], **values: object) -> None:
    """Check that values are instances of a type, or of one of several.

    Raises:
        TypeError: ``mesh is None: give dolfinx.mesh.Mesh.``
    """
    for name, value in values.items():
        if not isinstance(value, expected):
            raise TypeError(f"{name} is {_REPR.repr(value)}: give {_type_name(expected)}.")


def require_sequence(item: type, **values: object) -> None:
    """Check that values are sequences, such as lists or arrays, of instances of a type.

    A string and a UFL expression have a length and items, too, but are no sequences here.

    Raises:
        TypeError: ``targets is 0.3: give Sequence[float].``, or ``targets[1] is 'b': …``.
    """
    for name, value in values.items():
        remedy = f"give Sequence[{_type_name(item)}]."
        items: Sequence[object] | None = None
        if isinstance(value, np.ndarray) and value.ndim > 0:
            items = list(value)
        elif isinstance(value, Sequence) and not isinstance(value, str | bytes):
            items = value
        if items is None:
            raise TypeError(f"{name} is {_REPR.repr(value)}: {remedy}")
        for i, part in enumerate(items):
            if not isinstance(part, item):
                raise TypeError(f"{name}[{i}] is {_REPR.repr(part)}: {remedy}")


def _type_name(expected: type | tuple[type, ...]) -> str:
    """Return the name of a type as one writes it in an annotation, or of several with ``|``."""
    if isinstance(expected, tuple):
        return " | ".join(map(_type_name, expected))
    if expected is Real:
        return "float"
    if expected.__module__ in ("builtins", "collections.abc"):
        return expected.__name__
    return f"{expected.__module__}.{expected.__qualname__}"
