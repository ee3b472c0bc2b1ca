# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What all processes do together: work that fails on all if on one, and warnings said once."""

from __future__ import annotations

import logging
import pickle
from collections.abc import Callable
from typing import Any, TypeVar

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx_feti.runtime.arrays import Array

T = TypeVar("T")
logger = logging.getLogger("dolfinx_feti")

#: What :func:`deferred` has caught on this process.
_caught: list[Exception] = []


def on_first(work: Callable[[], T], comm: MPI.Comm) -> T:
    """Do something on the first process; return its result, which can be pickled, on all.

    Raises:
        BaseException: What the work raises, on all processes.

    Note:
        Collective.
    """
    parcel = on_all(lambda: pickle.dumps(work()) if comm.rank == 0 else b"", comm)
    return pickle.loads(comm.bcast(parcel, root=0))


def on_all(work: Callable[[], T], comm: MPI.Comm) -> T:
    """Do something on all processes; if it fails on one of them, it has failed on all.

    Returns:
        The process's own result.

    Raises:
        BaseException: What the work has raised, on all processes: where it has failed, its own
            error; elsewhere that of the first process where it has.

    Note:
        Collective. Work that is collective itself has to fail before it waits for another process,
        or after.
    """
    result: Any = None
    own: BaseException | None = None
    try:
        result = work()
    except BaseException as caught:  # Ctrl-C, too, ends work on all
        own = caught
    errors = comm.allgather(None if own is None else _portable(own))
    first = next((rank for rank, error in enumerate(errors) if error is not None), None)
    try:
        if first is not None:
            if own is None:
                errors[first].add_note(f"Raised on process {first} of {comm.size}.")
            raise own or errors[first]
    finally:
        del own, errors  # no cycle: all processes have to free PETSc's objects together
    return result


def deferred(work: Callable[[], Any], shape: int | tuple[int, ...]) -> Array:
    """Do local work of an iteration, between two collective calls, with a result of this shape.

    Where it fails, the result is NaN, which the next sum over all processes hands to all of them,
    and :func:`raise_deferred` raises its error.
    """
    try:
        return np.asarray(work())
    except Exception as error:
        _caught.append(error.with_traceback(None))  # it would hold frames
        return np.full(shape, np.nan)


def raise_deferred() -> None:
    """Raise the first error that :func:`deferred` has caught on this process. Not collective."""
    if _caught:
        error = _caught[0]
        _caught.clear()
        try:
            raise error
        finally:
            del error  # its traceback holds this frame


def _portable(error: BaseException) -> BaseException:
    """Return an error that can be sent to other processes."""
    try:
        copy = pickle.loads(pickle.dumps(error))
    except Exception:  # of a class that cannot be pickled or made again
        copy = None
    return error if isinstance(copy, BaseException) else RuntimeError(reason(error))


def total(value: float, comm: MPI.Comm) -> float:
    """Sum a number of each process, by a reduction of numbers and not of objects. Collective."""
    return float(total_of(np.array([value], dtype=np.float64), comm)[0])


def total_of(values: Array, comm: MPI.Comm) -> Array:
    """Sum arrays of one shape of all processes, entry by entry. Collective."""
    sum_ = np.array(values, dtype=np.float64, order="C")
    comm.Allreduce(MPI.IN_PLACE, sum_)
    return sum_


def join(values: npt.ArrayLike, comm: MPI.Comm) -> npt.NDArray[Any]:
    """Return the arrays of all processes, one after the other along the first axis. Collective."""
    parts = [part for part in comm.allgather(np.asarray(values)) if len(part)]
    return np.concatenate(parts) if parts else np.asarray(values)


def bounds(x: npt.NDArray[np.floating[Any]], comm: MPI.Comm) -> tuple[Array, Array]:
    """Return the least and the greatest of the points of all processes, (d,) each. Collective."""
    ends = x.min(axis=0, initial=np.inf), x.max(axis=0, initial=-np.inf)
    low, high = np.swapaxes(np.asarray(comm.allgather(ends), dtype=np.float64), 0, 1)
    return low.min(axis=0), high.max(axis=0)


def reason(error: BaseException) -> str:
    """Say what went wrong, in one line."""
    text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return " ".join(text.split()) or type(error).__name__


def warn(text: str, comm: MPI.Comm) -> None:
    """Log a warning, with the remedy, on the first process of those to whom it applies."""
    if comm.rank == 0:
        logger.warning(text)
