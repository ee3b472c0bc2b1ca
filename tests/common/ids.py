# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Ids of parametrised tests: text that one can type in a shell without quotes."""

from __future__ import annotations

import re
from collections.abc import Mapping

#: Characters that a shell does not interpret and that are on every keyboard.
TYPABLE = re.compile(r"[\w.=+,:/-]+", re.ASCII)

#: Longest id of one parameter: what fits, twice, on a line with the name of a test.
MAX_LENGTH = 40


def id_of(value: object, name: str) -> str | None:
    """Return the id of a parameter, or None if that of pytest can be typed.

    Args:
        value: Value of the parameter.
        name: Name of the argument; it is the id of a function without a name.
    """
    if isinstance(value, str):
        return typable(value)
    if isinstance(value, Mapping):
        return typable(",".join(f"{key}={text_of(entry)}" for key, entry in value.items()))
    if isinstance(value, set | frozenset):  # in the same order in each process
        return typable(",".join(sorted(text_of(entry) for entry in value)))
    if isinstance(value, list | tuple):
        return typable(",".join(text_of(entry) for entry in value))
    if getattr(value, "__name__", None) == "<lambda>":
        return name
    return None


def text_of(value: object) -> str:
    """Return the name of a function or class, or else the text of a value."""
    return str(getattr(value, "__name__", value))


def typable(text: str) -> str:
    """Return the beginning of a text, with hyphens in place of what one cannot type."""
    if TYPABLE.fullmatch(text) and len(text) <= MAX_LENGTH:
        return text
    return re.sub(r"[^\w.=+,:/]+", "-", text, flags=re.ASCII)[:MAX_LENGTH].strip("-") or "empty"
