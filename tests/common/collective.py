# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Tests on several processes: assertions that fail on all, global arrays, PETSc's garbage."""

from __future__ import annotations

import ctypes
import gc
import os
import re
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
import pytest
from explain import argument, explain, loop_variables

Array = npt.NDArray[np.float64]

COMM = MPI.COMM_WORLD

#: Largest array that a failure shows in full: it fits on a line or two of a terminal.
MAX_ENTRIES = 12


def agree(ok: object, context: object = None) -> None:
    """Assert on all processes that a condition holds on each, so that no process goes on alone.

    A failure shows the condition as it is written in the test, the values of its operands on each
    process where it fails, the context, and the variables of loops around the call.

    Args:
        ok: The condition; collective operands are evaluated again if it fails.
        context: What the condition does not contain, such as the message of a solver.
    """
    __tracebackhide__ = True
    caller = sys._getframe(1)
    fails = COMM.allgather(not ok)
    if not any(fails):
        return
    explanation = explain(caller)  # on all processes: operands may be collective
    text = "" if context is None else str(context)
    message = f"{explanation}\n    {text}" if text else explanation
    _fail_together(fails, message, caller)


def small(error: float, tolerance: float) -> None:
    """Assert on all processes that abs(error) ≤ tolerance on each; NaN fails."""
    __tracebackhide__ = True
    caller = sys._getframe(1)
    fails = COMM.allgather(not abs(error) <= tolerance)
    if any(fails):
        message = f"|{argument(caller, 0)}| = {abs(error)} > {tolerance}"
        _fail_together(fails, message, caller)


def equal(actual: npt.ArrayLike, expected: npt.ArrayLike, tolerance: float = 0.0) -> None:
    """Assert on all processes that arrays agree to a tolerance relative to the largest entry.

    Args:
        actual: Array of any shape; each process compares its own.
        expected: Array of the same shape; its largest entry on this process scales the tolerance.
        tolerance: Largest difference relative to that entry; with 0 they are equal.
    """
    __tracebackhide__ = True
    actual = np.asarray(actual, dtype=float)
    expected = np.asarray(expected, dtype=float)
    caller = sys._getframe(1)
    fails = COMM.allgather(actual.shape != expected.shape)
    if any(fails):
        shapes = f"have shapes {actual.shape} and {expected.shape}"
        message = f"{argument(caller, 0)} and {argument(caller, 1)} {shapes}"
        _fail_together(fails, message, caller)
    scale = np.abs(expected).max(initial=0.0) if tolerance else 1.0
    allowed = tolerance * max(scale, 1e-300)
    error = np.abs(actual - expected).max(initial=0.0)
    fails = COMM.allgather(not error <= allowed)
    if any(fails):
        compared = f"{argument(caller, 0)} and {argument(caller, 1)}"
        place = largest_difference(actual, expected)
        _fail_together(fails, f"{compared} differ by {error} > {allowed} {place}", caller)


def uniform(values: npt.ArrayLike, value: float, tolerance: float) -> None:
    """Assert on all processes that all entries have one value, to an absolute tolerance."""
    __tracebackhide__ = True
    caller = sys._getframe(1)
    entries = np.asarray(values, dtype=float)
    error = np.abs(entries - value).max(initial=0.0)
    fails = COMM.allgather(not error <= tolerance)
    if any(fails):
        place = largest_difference(entries, np.full_like(entries, value))
        message = f"{argument(caller, 0)} differs by {error} > {tolerance} {place}"
        _fail_together(fails, message, caller)


def largest_difference(actual: Array, expected: Array) -> str:
    """Return where arrays of one shape differ most, or where the first NaN is, and both entries.

    Short arrays follow in full, because a list of steps is understood by its first difference.
    """
    if actual.size == 0:
        return "(no entries)"
    place = np.unravel_index(np.argmax(np.abs(actual - expected)), actual.shape)
    index = ", ".join(str(int(i)) for i in place)
    entry = f"(entry [{index}]: {actual[place]} instead of {expected[place]})"
    if not 1 < actual.size <= MAX_ENTRIES:
        return entry
    return f"{entry}\n    {actual.tolist()} instead of\n    {expected.tolist()}"


def _fail_together(fails: list[bool], message: str, caller: FrameType) -> NoReturn:
    """Raise an AssertionError on all processes, with the messages of those where a check fails.

    Args:
        fails: Whether the check fails, one for each process.
        message: What the check compares on this process.
        caller: Frame that calls the check; the variables of loops around the call are added.
    """
    __tracebackhide__ = True
    lines = message.splitlines()
    loops = [f"    {line}" for line in loop_variables(caller)]
    lines += [line for line in loops if line not in lines]
    messages = COMM.allgather("\n".join(lines))
    wrong = [rank for rank, fail in enumerate(fails) if fail]
    raise AssertionError("\n".join(f"rank {rank}: {messages[rank]}" for rank in wrong))


@contextmanager
def raises(kind: type[Exception], match: str) -> Iterator[None]:
    """Assert that every process raises this error, with a message that matches the pattern."""
    caught: Exception | None = None
    try:
        yield
    except Exception as error:  # another kind is reported, and not on one process alone
        caught = error
    agree(
        isinstance(caught, kind) and re.search(match, str(caught)),
        f"{caught!r} instead of {kind.__name__} with '{match}'",
    )


def logged_messages(caplog: pytest.LogCaptureFixture) -> list[str]:
    """Return the messages that the first process has logged, on all processes."""
    return COMM.bcast([record.getMessage() for record in caplog.records])


def random_part(n: int, columns: int | None = None, *, seed: int = 1993) -> Array:
    """Return this process's rows, (n,) or (n, columns), of a random array.

    The whole array is the same on any number of processes.
    """
    shape = (COMM.allreduce(n),) if columns is None else (COMM.allreduce(n), columns)
    last = COMM.scan(n)
    return np.random.default_rng(seed).standard_normal(shape)[last - n : last]


def norm(local: Array) -> float:
    """Return the Euclidean norm of a vector of which each process has a part."""
    return float(np.sqrt(COMM.allreduce(float(local.ravel() @ local.ravel()))))


def whole(local: npt.NDArray[np.generic]) -> npt.NDArray[np.generic]:
    """Join the parts of all processes, on all of them."""
    return np.concatenate(COMM.allgather(local))


def lu_solve(A: PETSc.Mat, b: PETSc.Vec) -> Array:
    """Solve A x = b with MUMPS and one step of refinement; return the owned values."""
    ksp = PETSc.KSP().create(A.comm)
    ksp.setOperators(A)
    ksp.setType(PETSc.KSP.Type.PREONLY)
    ksp.getPC().setType(PETSc.PC.Type.LU)
    ksp.getPC().setFactorSolverType(PETSc.Mat.SolverType.MUMPS)
    x = A.createVecRight()
    dx = A.createVecRight()
    r = b.copy()
    for _ in range(2):
        ksp.solve(r, dx)
        x.axpy(1.0, dx)
        A.mult(x, r)
        r.aypx(-1.0, b)
    values = x.array_r.copy()
    for owned in (ksp, x, dx, r):
        owned.destroy()
    return values


def dense(M: PETSc.Mat) -> Array:
    """Return all of a distributed matrix on all processes, (N, N)."""
    indptr, indices, values = M.getValuesCSR()
    rows = np.zeros((len(indptr) - 1, M.getSize()[1]))
    np.add.at(rows, (np.repeat(np.arange(len(rows)), np.diff(indptr)), indices), values)
    return whole(rows)


def matrix_of_map(apply: Callable[[Array], Array], n: int) -> Array:
    """Return the matrix of a linear map on all processes, (N, N).

    Args:
        apply: Maps a part of a vector, (n,), to one of the result; collective.
        n: Number of entries of this process.
    """
    last = COMM.scan(n)
    mine = np.arange(last - n, last)
    columns = [apply((mine == j).astype(np.float64)) for j in range(COMM.allreduce(n))]
    return whole(np.column_stack(columns))


def collect_garbage() -> None:
    """Collect Python's garbage, and that of PETSc. Collective.

    The traceback of an expected error keeps objects whose ``destroy`` is collective.
    """
    gc.collect()
    PETSc.garbage_cleanup()


def garbage(comm: MPI.Comm) -> str:
    """Return PETSc's list of objects that wait for a collective ``destroy``; empty if none do."""
    sys.stdout.flush()
    with tempfile.TemporaryFile() as file:
        screen = os.dup(1)
        os.dup2(file.fileno(), 1)
        try:
            PETSc.garbage_view(comm)
            PETSc.Sys.syncFlush(comm)
            ctypes.CDLL(None).fflush(None)
        finally:
            os.dup2(screen, 1)
            os.close(screen)
        file.seek(0)
        text = file.read().decode()
    text = comm.bcast(text)
    entries = sum(map(int, re.findall(r"Total entries: (\d+)", text)))
    return text if entries else ""
