# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Collective work: an error on one process is raised on all; sums, gathered rows, warnings.

MPI waits forever for a process that has left a collective call because of an error. Work that may
fail on one process therefore runs inside of :func:`on_all`, :func:`on_root` or
:func:`on_root_only`, which exchange the errors. In an iteration that would cost a message: there
:meth:`DeferredErrors.guard` is used.
"""

from __future__ import annotations

import logging
import pickle
from collections.abc import Callable
from typing import Any, TypeVar, overload

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx_feti.runtime.arrays import Array, ArrayOrNaN

T = TypeVar("T")
logger = logging.getLogger("dolfinx_feti")


def on_root(work: Callable[[], T], comm: MPI.Comm) -> T:
    """Do work on rank 0 and return its result on all processes. Collective.

    Args:
        work: Not collective; its result is pickled.
        comm: The processes.

    Raises:
        BaseException: The error of the work, on all processes.
    """
    pickled = on_all(lambda: pickle.dumps(work()) if comm.rank == 0 else b"", comm)
    return pickle.loads(comm.bcast(pickled, root=0))


def on_root_only(work: Callable[[], T], comm: MPI.Comm) -> T | None:
    """Do work on rank 0, and return its result there and None on all others. Collective.

    Args:
        work: Not collective; its result is not sent.
        comm: The processes.

    Raises:
        BaseException: The error of the work, on all processes.
    """
    return on_all(lambda: work() if comm.rank == 0 else None, comm)


def on_all(work: Callable[[], T], comm: MPI.Comm) -> T:
    """Do work on each process; raise on all processes if it fails on one. Collective.

    Args:
        work: If it is collective, it must not fail while other processes wait for this one.
        comm: The processes.

    Returns:
        The result of this process.

    Raises:
        BaseException: On a process where the work failed, its own error; elsewhere that of the
            first process where it failed, with a note that names the process.
    """
    result: Any = None
    own_error: BaseException | None = None
    try:
        result = work()
    except BaseException as caught:  # KeyboardInterrupt, too, ends the work on all processes
        own_error = caught
    errors = comm.allgather(None if own_error is None else _picklable(own_error))
    failed = [rank for rank, error in enumerate(errors) if error is not None]
    try:
        if own_error is not None:
            raise own_error
        if failed:
            errors[failed[0]].add_note(f"Raised on process {failed[0]} of {comm.size}.")
            raise errors[failed[0]]
    finally:
        # The traceback refers to this frame. Without the reference cycle, PETSc objects in the
        # traceback are freed at once, on all processes together.
        del own_error, errors
    return result


class DeferredErrors:
    """Errors of local work between two collective calls of an iteration, to be raised later.

    If an error left the iteration on one process, the others would hang in their next collective
    call. Instead, :meth:`guard` returns NaN as the result. The next sum over all processes spreads
    the NaN, the iteration ends on all of them, and :meth:`raise_first` raises the error inside of
    :func:`on_all`.
    """

    def __init__(self) -> None:
        self._errors: list[Exception] = []

    def guard(self, work: Callable[[], Any], shape: int | tuple[int, ...]) -> ArrayOrNaN:
        """Return the result of local work; NaN if it fails.

        Args:
            work: Not collective. Every exception is caught, including programming errors, and
                raised by the next :meth:`raise_first`.
            shape: Shape of the result.
        """
        try:
            return np.asarray(work())
        except Exception as error:
            self._errors.append(error.with_traceback(None))  # a traceback keeps frames alive
            return np.full(shape, np.nan)

    def raise_first(self) -> None:
        """Raise the first error of this process since the last call; discard all. Not collective.

        Raises:
            Exception: The error, if there is one.
        """
        if not self._errors:
            return
        error = self._errors[0]
        self.clear()
        try:
            raise error
        finally:
            del error  # its traceback refers to this frame

    def clear(self) -> None:
        """Discard all errors."""
        self._errors.clear()


def _picklable(error: BaseException) -> BaseException:
    """Return the error, or a RuntimeError with its message if it cannot be sent to others."""
    try:
        copy = pickle.loads(pickle.dumps(error))
    except Exception:  # the class cannot be pickled, or not be created from its arguments
        copy = None
    return error if isinstance(copy, BaseException) else RuntimeError(error_message(error))


@overload
def total_of(values: float, comm: MPI.Comm) -> float: ...


@overload
def total_of(values: Array, comm: MPI.Comm) -> Array: ...


def total_of(values: float | Array, comm: MPI.Comm) -> float | Array:
    """Return the sum of a number, or of an array entry by entry, over all processes. Collective.

    Args:
        values: A number, or an array of the same shape on all processes.
        comm: The processes.
    """
    sums = np.array(values, dtype=np.float64, order="C")
    comm.Allreduce(MPI.IN_PLACE, sums)
    return sums if sums.ndim else float(sums)


def allgather_rows(values: npt.ArrayLike, comm: MPI.Comm) -> npt.NDArray[Any]:
    """Return the arrays of all processes, concatenated along the first axis. Collective."""
    parts = [part for part in comm.allgather(np.asarray(values)) if len(part)]
    return np.concatenate(parts) if parts else np.asarray(values)


def bounding_box(
    x: npt.NDArray[np.floating[Any]], comm: MPI.Comm
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return the lower and upper corner, (d,), of the points x, (n, d), of all processes.

    Without any point the corners are infinity and minus infinity. Collective.
    """
    corners = x.min(axis=0, initial=np.inf), x.max(axis=0, initial=-np.inf)
    lower, upper = np.swapaxes(np.asarray(comm.allgather(corners), dtype=np.float64), 0, 1)
    return lower.min(axis=0), upper.max(axis=0)


def error_message(error: BaseException) -> str:
    """Return the message of an error in one line; its class if it has none."""
    text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return " ".join(text.split()) or type(error).__name__


def warn(text: str, comm: MPI.Comm) -> None:
    """Log a warning on the first process of a communicator. Not collective."""
    if comm.rank == 0:
        logger.warning(text)


#: Another name of :func:`on_root`, for programs that import it; not used in this package.
on_first = on_root

#: Another name of :func:`error_message`, likewise.
reason = error_message
