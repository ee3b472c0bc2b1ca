# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The error of Python's behind one of PETSc's, where PETSc has called Python.

From Python 3.12 on, the cyclic garbage collector may run inside petsc4py's error handler, while the
error is pending. The error is lost then, and petsc4py reads a null pointer. So the collector pauses
until the error has left PETSc.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

from petsc4py import PETSc


@contextmanager
def python_errors() -> Iterator[None]:
    """Raise the error of Python's that made a call of PETSc's fail, and not PETSc's own."""
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    except PETSc.Error as error:
        cause: BaseException = error
        while isinstance(cause, PETSc.Error) and cause.__cause__ is not None:
            cause = cause.__cause__
        if cause is error:
            raise
        raise cause from None
    finally:
        if collects:
            gc.enable()
