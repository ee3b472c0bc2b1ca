# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""PETSc's options database: check of a prefix; contexts that set or remove options; unread ones."""

from __future__ import annotations

import ctypes
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager

from petsc4py import PETSc

from dolfinx_feti.runtime.petsc_library import c_function


def require_prefix(prefix: object) -> str:
    """Return a ``petsc_options_prefix`` after a check.

    Raises:
        ValueError: It is not a string, or empty.
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
    """Context in which options are set; the former options are restored at its end.

    Args:
        prefix: Options prefix.
        petsc_options: Values by keys without the prefix. An option with the value None or True is
            set as a flag, without a value. None for no options.
    """
    values = {prefix + key: value for key, value in (petsc_options or {}).items()}
    return _changed(list(values), values)


def withheld(keys: Iterable[str]) -> AbstractContextManager[None]:
    """Context in which the options with these keys, prefix included, are not set."""
    return _changed(list(keys), {})


def mark_as_read(prefix: str, name: str) -> None:
    """Mark an option as read if it is set: :func:`unread_options` then omits it."""
    PETSc.Options(prefix).hasName(name)  # PETSc marks what it looks up


def unread_options(prefix: str) -> dict[str, str]:
    """Return the options under a prefix that no code has read on this process.

    An option that was removed and set again counts as unread.

    Args:
        prefix: Options prefix.

    Returns:
        Values by keys without the prefix; none if PETSc's library lacks the function.
    """
    arguments = (ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p)
    options_used = c_function("PetscOptionsUsed", arguments)
    if options_used is None:
        return {}
    unread = {}
    for key, value in PETSc.Options().getAll().items():
        is_used = ctypes.c_int(0)  # four bytes; some versions of PETSc write one of them
        if key.startswith(prefix):
            options_used(None, key.encode(), ctypes.byref(is_used))
            if not is_used.value:
                unread[key.removeprefix(prefix)] = value or ""  # the value of a flag is None
    return unread


@contextmanager
def _changed(keys: Sequence[str], values: Mapping[str, object]) -> Iterator[None]:
    """Context in which the options with these keys have the given values, or are not set.

    The former values are restored at its end.
    """
    database = PETSc.Options()
    before = database.getAll()

    def set_options(new_values: Mapping[str, object]) -> None:
        for key in keys:
            database.delValue(key)
            if key in new_values:
                value = new_values[key]
                database.setValue(key, "" if value is None else value)

    set_options(values)
    try:
        yield
    finally:
        set_options(before)
