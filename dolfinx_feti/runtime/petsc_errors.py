# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The error of Python's behind one of PETSc's, where PETSc has called Python."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from petsc4py import PETSc

__all__ = ["python_errors"]


@contextmanager
def python_errors() -> Iterator[None]:
    """Raise the error of Python's that made a call of PETSc's fail, and not PETSc's own."""
    try:
        yield
    except PETSc.Error as error:
        cause: BaseException = error
        while isinstance(cause, PETSc.Error) and cause.__cause__ is not None:
            cause = cause.__cause__
        if cause is error:
            raise
        raise cause from None
