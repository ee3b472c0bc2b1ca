# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What all processes do together: work that fails on all if on one, and warnings said once."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any, TypeVar

from mpi4py import MPI

__all__ = ["on_all", "on_first", "reason", "warn"]

T = TypeVar("T")
logger = logging.getLogger("dolfinx_feti")


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
    if error is not None:
        raise error
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
    if cause is not None:
        raise RuntimeError(cause) from error
    return result


def reason(error: Exception) -> str:
    """Say what went wrong, in one line."""
    text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return " ".join(text.split()) or type(error).__name__


def warn(text: str, comm: MPI.Comm) -> None:
    """Log a warning on the first process, through Python's logger ``dolfinx_feti``.

    Args:
        text: The warning, with the remedy.
        comm: Communicator of all to whom it applies.
    """
    if comm.rank == 0:
        logger.warning(text)
