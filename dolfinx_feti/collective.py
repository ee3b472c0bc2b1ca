# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Work that may fail on one process, and then fails on all: no process waits for another."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from mpi4py import MPI

__all__ = ["on_all", "on_first", "reason"]

T = TypeVar("T")


def on_first(work: Callable[[], T], comm: MPI.Comm) -> T:
    """Do something on the first process.

    Args:
        work: What is done; its result and its error can be pickled.
        comm: Communicator of all who wait for it.

    Returns:
        The result, on all processes.

    Raises:
        Exception: What the work raises, on all processes.

    Note:
        Collective.
    """
    result: Any = None
    error: Exception | None = None
    if comm.rank == 0:
        try:
            result = work()
        except Exception as caught:
            error = caught
    result, error = comm.bcast((result, error), root=0)
    try:
        if error is not None:
            raise error
    finally:
        error = None  # its traceback holds this frame, and with it whatever the work has made
    return result


def on_all(work: Callable[[], T], comm: MPI.Comm) -> T:
    """Do something on all processes.

    Args:
        work: What each of them does.
        comm: Communicator of all of them.

    Returns:
        The process's own result.

    Raises:
        RuntimeError: The work has failed on some process; with the reason of the first of these,
            on all processes.

    Note:
        Collective.
    """
    result: Any = None
    error: Exception | None = None
    try:
        result = work()
    except Exception as caught:
        error = caught
    causes = comm.allgather(None if error is None else reason(error))
    cause = next((text for text in causes if text is not None), None)
    try:
        if cause is not None:
            raise RuntimeError(cause) from error
    finally:
        error = None  # no circle: PETSc's objects are to be freed on all processes at a time
    return result


def reason(error: Exception) -> str:
    """Say what went wrong, in one line."""
    text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return " ".join(text.split()) or type(error).__name__
