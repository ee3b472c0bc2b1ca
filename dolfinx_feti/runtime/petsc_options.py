# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""PETSc's options database: a prefix that is checked, options inserted or withheld for a while."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager

from petsc4py import PETSc

__all__ = ["inserted", "require_prefix", "withheld"]


def require_prefix(prefix: object) -> str:
    """Check a ``petsc_options_prefix``.

    Raises:
        ValueError: It is no string or empty.
    """
    if not isinstance(prefix, str) or not prefix:
        raise ValueError(
            f"petsc_options_prefix is {prefix!r}; give a non-empty string, the same on all "
            "processes, for example 'artery_'."
        )
    return prefix


@contextmanager
def inserted(prefix: str, petsc_options: Mapping[str, object] | None) -> Iterator[None]:
    """Put options under a prefix for a while and leave the database as it was.

    Args:
        prefix: Prefix of each key.
        petsc_options: Keys without prefix; None or True as a value sets a flag.
    """
    database = PETSc.Options()
    before = database.getAll()
    keys = {prefix + key: value for key, value in (petsc_options or {}).items()}
    for key, value in keys.items():
        database.setValue(key, "" if value is None else value)
    try:
        yield
    finally:
        for key in keys:
            database.delValue(key)
            if key in before:
                database.setValue(key, before[key])


@contextmanager
def withheld(keys: Iterable[str]) -> Iterator[None]:
    """Take options out of the database for a while.

    Args:
        keys: Their names, prefix included; those that are not there do not matter.
    """
    database = PETSc.Options()
    present = database.getAll()
    values = {key: present[key] for key in keys if key in present}
    for key in values:
        database.delValue(key)
    try:
        yield
    finally:
        for key, value in values.items():
            database.setValue(key, value)
