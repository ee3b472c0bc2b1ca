# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""An error on one process is an error on all processes."""

from __future__ import annotations

import errno
import re
import weakref
from contextlib import suppress
from functools import partial

import numpy as np
import pytest
from collective import COMM, agree, equal, raises

from dolfinx_feti.runtime.collective import (
    DeferredErrors,
    allgather_rows,
    error_message,
    on_all,
    on_first,
    on_root,
    reason,
    total_of,
    warn,
)


def test_sums_leave_their_argument_unchanged():
    """An array of columns keeps its shape and layout."""
    own = np.arange(6.0).reshape(2, 3).T * (COMM.rank + 1)
    before = own.copy()
    ranks = sum(range(1, COMM.size + 1))
    total = total_of(own, COMM)
    agree(total.shape == (3, 2))
    equal(own, before)
    equal(total, np.arange(6.0).reshape(2, 3).T * ranks, 1e-15)
    agree(total_of(COMM.rank + 1.0, COMM) == ranks)


def test_on_root_shares_one_result_and_on_all_keeps_each():
    """Only the first process works in on_root."""
    ranks: list[int] = []
    agree(on_root(lambda: (ranks.append(COMM.rank), "done")[1], COMM) == "done")
    agree(ranks == ([0] if COMM.rank == 0 else []))
    agree(on_all(lambda: COMM.rank, COMM) == COMM.rank)


class StubbornError(Exception):
    """Cannot be made again from its arguments."""

    def __init__(self, one: int, two: int) -> None:
        super().__init__(f"{one} and\n {two}")


@pytest.mark.parametrize(
    ("together", "fails", "error"),
    [
        (on_root, True, ValueError("size = -1")),
        (on_root, True, FileNotFoundError(errno.ENOENT, "No such file", "wall.msh")),
        (on_root, COMM.rank == 0, StubbornError(1, 2)),
        (on_all, COMM.rank == 0, StubbornError(1, 2)),
        (on_all, COMM.rank == COMM.size - 1, OSError(errno.ENOSPC, "No space left", "state.bp")),
        (on_all, True, ValueError(f"on process {COMM.rank}")),
    ],
)
def test_error_on_one_process_is_raised_on_all(together, fails, error):
    """It is the same error if it can be sent; a process with its own error raises that one."""

    def work() -> None:
        if fails:
            raise error

    kind = RuntimeError if isinstance(error, StubbornError) and not fails else type(error)
    with raises(kind, r"\s+".join(map(re.escape, str(error).split()))):
        together(work, COMM)


def test_result_that_cannot_be_sent_is_an_error():
    """All processes raise, and none waits."""
    with raises(Exception, "lambda"):
        on_root(lambda: lambda: None, COMM)


def test_deferred_errors_are_nan_until_they_are_raised():
    """The first error is raised once; results without an error are returned as they are."""
    errors = DeferredErrors()
    agree(errors.guard(lambda: [1.0, 2.0], 2).tolist() == [1.0, 2.0])
    errors.raise_first()
    for message in ("first", "second"):
        agree(np.isnan(errors.guard(partial(fail, message), (2, 3))).all())
    with raises(ValueError, "first"):
        errors.raise_first()
    errors.raise_first()


def fail(message: str) -> None:
    """Raise a ValueError."""
    raise ValueError(message)


def test_deferred_errors_belong_to_their_object():
    """Two solvers do not raise each other's errors."""
    errors = DeferredErrors()
    agree(np.isnan(errors.guard(partial(fail, "no"), 1)).all())
    DeferredErrors().raise_first()
    errors.clear()
    errors.raise_first()


def test_both_names_of_a_function_work():
    """Demos and scripts use the second one."""
    agree(on_first is on_root and reason is error_message)


def test_warning_is_logged_by_the_first_process(caplog):
    """Others do not repeat it."""
    warn("too thin", COMM)
    expected = ["too thin"] if COMM.rank == 0 else []
    agree([record.message for record in caplog.records] == expected)


@pytest.mark.parametrize("do", [on_all, on_root])
def test_error_leaves_no_reference_cycle(without_collector, do):
    """Objects of the failed work are freed with the error, without the collector."""

    class Made:
        pass

    watched = []

    def work() -> None:
        made = Made()
        watched.append(weakref.ref(made))
        raise ValueError("no")

    with suppress(RuntimeError, ValueError):
        do(work, COMM)
    agree(all(ref() is None for ref in watched))


def test_error_message_is_one_line_and_never_empty():
    """An error without a message has the name of its class."""
    agree(error_message(ValueError("two\n  lines")) == "two lines")
    agree(error_message(AssertionError()) == "AssertionError")
    agree(error_message(OSError(errno.EACCES, "Permission denied", "file")) == "Permission denied")


@pytest.mark.parametrize("dtype", [float, int])
def test_allgather_rows_joins_the_rows_of_all_processes(dtype):
    """Processes without rows are left out; there may be no rows at all."""
    own = np.full((COMM.rank, 2), COMM.rank, dtype=dtype)
    gathered = allgather_rows(own if COMM.rank else [], COMM)
    counts = np.repeat(np.arange(COMM.size), np.arange(COMM.size))
    equal(gathered.reshape(-1, 2), np.column_stack([counts, counts]))
    agree(len(allgather_rows([], COMM)) == 0)
