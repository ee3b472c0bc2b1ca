# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""PETSc's options database: a prefix that is checked, options inserted or withheld for a while."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager

from petsc4py import PETSc


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


def inserted(
    prefix: str, petsc_options: Mapping[str, object] | None
) -> AbstractContextManager[None]:
    """Put options under a prefix for a while; None or True as a value sets a flag."""
    values = {prefix + key: value for key, value in (petsc_options or {}).items()}
    return _changed(list(values), values)


def withheld(keys: Iterable[str]) -> AbstractContextManager[None]:
    """Take options, prefix included, out of the database for a while, as far as they are there."""
    return _changed(list(keys), {})


@contextmanager
def _changed(keys: Sequence[str], values: Mapping[str, object]) -> Iterator[None]:
    """Give options these values, or none, for a while; then the database is as it was."""
    database = PETSc.Options()
    before = database.getAll()

    def put(values: Mapping[str, object]) -> None:
        for key in keys:
            database.delValue(key)
            if key in values:
                database.setValue(key, "" if values[key] is None else values[key])

    put(values)
    try:
        yield
    finally:
        put(before)
