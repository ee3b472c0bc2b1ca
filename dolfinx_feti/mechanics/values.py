# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What a user gives: numbers in the range where they have a meaning, arguments of their type."""

from __future__ import annotations

import functools
import inspect
import math
import re
import reprlib
from collections.abc import Callable, Mapping, Sequence
from numbers import Integral, Real
from types import SimpleNamespace, UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
import numpy.typing as npt

from ufl.core.expr import Expr

__all__ = [
    "require_finite",
    "require_not_negative",
    "require_positive",
    "require_within",
    "type_exports",
    "typed",
]

Work = TypeVar("Work", bound=Callable[..., Any])

REPR = reprlib.Repr()
REPR.maxother = 80
NUMBERS: dict[object, type] = {float: Real, int: Integral}


def require_within(
    low: float,
    high: float,
    values: Mapping[str, object],
    *,
    ends: bool = True,
    remedy: str = "",
    sign: str = " = ",
) -> None:
    """Refuse values, by name, that are not finite numbers in a range; UFL expressions pass.

    ``ends`` tells whether low and high belong to the range, ``remedy`` what to give instead.
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


def typed(work: Work) -> Work:
    """Let a function, or a class when an object is made, refuse arguments of a wrong type."""
    if inspect.isclass(work):
        work.__init__ = typed(work.__init__)  # type: ignore[misc]
        return work  # type: ignore[return-value]
    signature = inspect.signature(work)
    hints: dict[str, Any] = {}

    @functools.wraps(work)
    def checked(*args: Any, **kwargs: Any) -> Any:
        if not hints:  # the first call, when all names are known
            hints.update(_hints(work))
        for name, value in signature.bind(*args, **kwargs).arguments.items():
            kind = signature.parameters[name].kind
            if name not in hints or kind is inspect.Parameter.VAR_KEYWORD:
                continue
            if misfit := _misfit(name, value, hints[name]):
                wanted = inspect.formatannotation(hints[name])
                wanted = re.sub(r"(typing|collections\.abc)\.", "", wanted)
                raise TypeError(f"{misfit[0]} is {REPR.repr(misfit[1])}: give {wanted}.")
        return work(*args, **kwargs)

    return checked  # type: ignore[return-value]


def type_exports(room: dict[str, Any]) -> None:
    """Let all in the ``__all__`` of a room refuse arguments so; pickle finds functions there."""
    for name in room["__all__"]:
        if callable(room[name]):
            room[name] = typed(room[name])
            if not inspect.isclass(room[name]):
                room[name].__module__ = room["__name__"]


def _hints(work: Callable[..., Any]) -> dict[str, Any]:
    """Return the types of the arguments, but for names of a base class in another module."""
    scope = inspect.unwrap(work).__globals__
    hints: dict[str, Any] = {}
    for name, annotation in work.__annotations__.items():
        try:
            hints |= get_type_hints(SimpleNamespace(__annotations__={name: annotation}), scope)
        except NameError:
            hints[name] = Any
    return hints


def _misfit(where: str, value: Any, hint: Any) -> tuple[str, object] | None:
    """Return the first thing in a value that does not fit a type, and where it is."""
    origin, args = get_origin(hint) or hint, get_args(hint)
    if hint == npt.ArrayLike or origin is np.ndarray:
        return None if _is_array(value) else (where, value)
    if origin in (Union, UnionType):
        found = [_misfit(where, value, each) for each in args]
        return None if None in found else max(filter(None, found), key=lambda at: len(at[0]))
    if origin is Callable:
        return None if callable(value) else (where, value)
    if hint is Any or not isinstance(origin, type) or getattr(origin, "_is_protocol", False):
        return None  # choices, too, are for the function to check
    parts: dict[Any, Any] | None = None
    if issubclass(origin, Mapping):
        parts = dict(value) if isinstance(value, Mapping) else None
    elif origin in (Sequence, list, tuple):
        listed = isinstance(value, Sequence) and not isinstance(value, (str, bytes))
        if listed or (isinstance(value, np.ndarray) and value.ndim > 0):
            parts = dict(enumerate(value))
    elif isinstance(value, NUMBERS.get(origin, origin)):
        parts = {}
    if parts is None:
        return where, value
    inner = args[-1] if origin is not tuple and args else Any
    if get_origin(inner) in (Union, UnionType):
        return None
    inside = (_misfit(f"{where}[{key!r}]", part, inner) for key, part in parts.items())
    return next(filter(None, inside), None)


def _is_array(value: object) -> bool:
    """Tell whether a value is an array of real numbers, or can be made one."""
    try:
        return np.asarray(value, dtype=np.float64).dtype == np.float64 and value is not None
    except (TypeError, ValueError):
        return False
