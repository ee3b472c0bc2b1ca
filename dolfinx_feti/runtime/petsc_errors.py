# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Python errors that pass through PETSc: the original error is raised, not PETSc's error code.

From Python 3.12 on, the cyclic garbage collector may run inside of petsc4py's error handler while
an error is pending. The error is then lost, and petsc4py reads a null pointer. The collector is
therefore paused while C code runs that may call Python, and resumed in the Python code that C
calls::

    with python_errors(snes):                       paused
        snes.solve(None, x)                         C
            with garbage_collection_resumed(snes):  runs, in Newton.solve
                with python_errors(ksp):            paused
                    ksp.solve(b, x)                 C
                        with garbage_collection_resumed(ksp):   runs, in FETI.solve
                with python_errors():               paused
                    snes.monitor(…)                 C, calls a monitor of the user

With this, the collector is paused while an error passes from Python through C to Python.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

from petsc4py import PETSc

#: Attribute of a PETSc solver: True while a call of the solver keeps the collector paused. PETSc
#: calls Python without arguments of ours, and the solver is the only object that both sides have.
PAUSED = "dolfinx_feti_collector_paused"


@contextmanager
def python_errors(solver: PETSc.Object | None = None) -> Iterator[None]:
    """Context for a call of PETSc: if the call fails because of a Python error, raise that error.

    The garbage collector is paused in the context.

    Args:
        solver: The solver that is called, if its context is Python code that uses
            :func:`garbage_collection_resumed`. None if PETSc calls only Python code with little
            garbage, such as a monitor.
    """
    collects = gc.isenabled()
    gc.disable()
    if solver is not None:
        solver.setAttr(PAUSED, collects)
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
        if solver is not None:
            solver.setAttr(PAUSED, False)
        if collects:
            gc.enable()


@contextmanager
def garbage_collection_resumed(solver: PETSc.Object) -> Iterator[None]:
    """Context in which the collector runs, for Python code that a solver calls.

    It does nothing unless :func:`python_errors` has paused the collector, which a user may have
    disabled.

    Args:
        solver: The solver, which was passed to :func:`python_errors`.
    """
    paused = bool(solver.getAttr(PAUSED))
    if not paused:
        yield
        return
    solver.setAttr(PAUSED, False)  # a context inside of this one does nothing
    gc.enable()
    try:
        yield
    finally:
        gc.disable()
        solver.setAttr(PAUSED, True)
