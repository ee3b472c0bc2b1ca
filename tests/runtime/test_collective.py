# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What fails on one process fails on all."""

from __future__ import annotations

import errno
import re
import weakref
from contextlib import suppress

import numpy as np
import pytest
from collective import COMM, agree, raises

from dolfinx_feti.runtime.collective import join, on_all, on_first, reason, total, total_of, warn


def test_sums_leave_the_process_its_own():
    own = np.arange(6.0).reshape(2, 3).T * (COMM.rank + 1)
    before, ranks = own.copy(), sum(range(1, COMM.size + 1))
    found = total_of(own, COMM)
    agree(np.array_equal(own, before) and found.shape == (3, 2))
    agree(np.allclose(found, np.arange(6.0).reshape(2, 3).T * ranks))
    agree(total(COMM.rank + 1.0, COMM) == ranks)


def test_all_have_the_result_of_the_first_or_their_own():
    ranks: list[int] = []
    agree(on_first(lambda: (ranks.append(COMM.rank), "done")[1], COMM) == "done")
    agree(ranks == [0] * (COMM.rank == 0), ranks)
    agree(on_all(lambda: COMM.rank, COMM) == COMM.rank)


class StubbornError(Exception):
    """Cannot be made again from its arguments."""

    def __init__(self, one: int, two: int) -> None:
        super().__init__(f"{one} and\n {two}")


@pytest.mark.parametrize(
    ("together", "fails", "error"),
    [
        (on_first, True, ValueError("size = -1")),
        (on_first, True, FileNotFoundError(errno.ENOENT, "No such file", "wall.msh")),
        (on_first, COMM.rank == 0, StubbornError(1, 2)),
        (on_all, COMM.rank == 0, StubbornError(1, 2)),
        (on_all, COMM.rank == COMM.size - 1, OSError(errno.ENOSPC, "No space left", "state.bp")),
        (on_all, True, ValueError(f"on process {COMM.rank}")),
    ],
)
def test_one_that_fails_is_enough(together, fails, error):
    """Its error is raised on all, if it can be sent; one's own goes before those of others."""

    def work() -> None:
        if fails:
            raise error

    kind = RuntimeError if isinstance(error, StubbornError) and not fails else type(error)
    with raises(kind, r"\s+".join(map(re.escape, str(error).split()))):
        together(work, COMM)


def test_result_that_cannot_be_sent():
    with raises(Exception, "lambda"):
        on_first(lambda: lambda: None, COMM)


def test_a_warning_is_logged_once(caplog):
    warn("too thin", COMM)
    agree([record.message for record in caplog.records] == ["too thin"] * (COMM.rank == 0))


@pytest.mark.parametrize("do", [on_all, on_first])
def test_error_leaves_no_circle(without_collector, do):
    """What the work has made is freed as soon as the error is, without the collector."""

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


def test_reason_is_one_line_and_never_empty():
    agree(reason(ValueError("two\n  lines")) == "two lines")
    agree(reason(AssertionError()) == "AssertionError")
    agree(reason(OSError(errno.EACCES, "Permission denied", "file")) == "Permission denied")


@pytest.mark.parametrize("dtype", [float, int])
def test_join(dtype):
    """One after the other; who has none does not count, and there may be none at all."""
    own = np.full((COMM.rank, 2), COMM.rank, dtype=dtype)
    joined = join(own if COMM.rank else [], COMM)
    counts = np.repeat(np.arange(COMM.size), np.arange(COMM.size))
    agree(np.array_equal(joined.reshape(-1, 2), np.column_stack([counts, counts])), joined)
    agree(len(join([], COMM)) == 0)
