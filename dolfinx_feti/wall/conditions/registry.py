# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The kinds of conditions on a surface, and the conditions of each surface by its name."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from numbers import Real
from typing import Any, TypeAlias

from dolfinx_feti.wall.casekeys import Key
from dolfinx_feti.wall.conditions.condition import Condition
from dolfinx_feti.wall.conditions.prescribed import Clamp, Slide
from dolfinx_feti.wall.conditions.pressure import Pressure
from dolfinx_feti.wall.conditions.supports import Dashpot, Spring

__all__ = ["KINDS", "Conditions", "case_keys", "checked_conditions", "conditions_in_case"]

#: One or several conditions for each surface by name.
Conditions: TypeAlias = Mapping[str, Condition | Sequence[Condition]]

#: Kinds that a case in TOML may have, in the order in which it lists the conditions of a surface.
#: ``apply_conditions`` accepts objects of any other subclass of ``Condition``, too.
KINDS: tuple[type[Condition], ...] = (Pressure, Spring, Dashpot, Slide, Clamp)


def checked_conditions(conditions: Conditions) -> dict[str, tuple[Condition, ...]]:
    """Return the conditions of each surface as a tuple, if they are valid.

    Raises:
        ValueError: A surface has an object that is no condition, two conditions of one kind, or
            others in addition to one that allows none (``WHY_ALONE``).
    """
    return {name: _checked(name, conditions[name]) for name in conditions}


def _checked(name: str, one_or_several: object) -> tuple[Condition, ...]:
    """Return the conditions of a surface; see :func:`checked_conditions`."""
    listed: tuple[object, ...] = (one_or_several,)
    if isinstance(one_or_several, Sequence) and not isinstance(one_or_several, str):
        listed = tuple(one_or_several)
    surface = f"conditions[{name!r}]"
    checked: list[Condition] = []
    for condition in listed:
        if isinstance(condition, type) and issubclass(condition, Condition):
            name_of_class = condition.__name__
            raise ValueError(
                f"{surface} holds the class {name_of_class}: give an object of it, with its "
                f"arguments in parentheses, {_call(condition)}."
            )
        if isinstance(condition, Real):
            raise ValueError(
                f"{surface} holds {condition!r}: give Pressure() for a surface under pressure, and "
                "set its value by boundary.set_pressure."
            )
        if not isinstance(condition, Condition):
            choices = _alternatives([_call(kind) for kind in KINDS])
            raise ValueError(f"{surface} holds {condition!r}: give {choices}.")
        checked.append(condition)
    if len({type(condition) for condition in checked}) < len(checked):
        raise ValueError(f"{surface} holds a condition twice: give each kind once.")
    for condition in checked:
        if condition.WHY_ALONE and len(checked) > 1:
            raise ValueError(
                f"{surface} holds a {type(condition).__name__.lower()} and another condition, "
                f"which {condition.WHY_ALONE}: leave one of them out."
            )
    return tuple(checked)


def case_keys() -> dict[str, Key]:
    """Return all keys of a table ``[surfaces.NAME]`` of a case."""
    keys: dict[str, Key] = {}
    for kind in KINDS:
        keys |= kind.CASE_KEYS
    return keys


def conditions_in_case(
    name: str, table: Mapping[str, Any], wall_pressure: float
) -> tuple[Condition, ...]:
    """Return the conditions of a table ``[surfaces.NAME]`` of a case.

    Args:
        name: Name of the surface.
        table: The values of its keys, in the first unit of each.
        wall_pressure: Pressure of the case [mmHg], of which each surface gets a share.

    Raises:
        ValueError: The table, or one of its keys, has no effect.
    """
    candidates = (kind.from_case(table, wall_pressure) for kind in KINDS)
    conditions = tuple(condition for condition in candidates if condition is not None)
    if not conditions:
        names = list(dict.fromkeys(_case_name(kind) for kind in KINDS if kind.CASE_KEYS))
        raise ValueError(f"[surfaces.{name}] has no effect: give it a {_alternatives(names)}")
    for key in table:
        if not any(key in condition.CASE_KEYS for condition in conditions):
            names = [f"a {_case_name(kind)}" for kind in KINDS if key in kind.CASE_KEYS]
            raise ValueError(
                f"[surfaces.{name}] {key}: has no effect without {_alternatives(names)}"
            )
    return conditions


def _case_name(kind: type[Condition]) -> str:
    """Return the key of a case that names a kind of condition."""
    return next(iter(kind.CASE_KEYS))


def _call(kind: type[Condition]) -> str:
    """Return how to create a condition of a kind, for a message: ``Spring(stiffness)``."""
    parameters = inspect.signature(kind).parameters.values()
    required = [parameter.name for parameter in parameters if parameter.default is parameter.empty]
    return f"{kind.__name__}({', '.join(required)})"


def _alternatives(words: Sequence[str]) -> str:
    """Return words for a message, ``a, b or c``."""
    *first, last = words
    return f"{', '.join(first)} or {last}" if first else last
