# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What fails on the last process alone fails on all: callbacks, checkpoints, the bar."""

from __future__ import annotations

import io
import threading
from types import SimpleNamespace

import pytest
from collective import COMM, agree, equal, raises
from played import OWN, truth
from states import opened
from tqdm import TMonitor

from dolfinx_feti.loading.load_steps import follow_load
from dolfinx_feti.loading.steps import Steps

LAST = COMM.rank == COMM.size - 1
STEPS = Steps(first=0.2, least=0.1)


def test_set_load(played):
    problem = played()

    def set_load(load: float) -> None:
        if LAST and load > 0.3:
            raise ZeroDivisionError("not this load")
        problem.load = load

    with raises(ZeroDivisionError, "not this load"):
        follow_load(problem, set_load, [1.0], STEPS, state=[problem.u, problem.p])
    agree([attempt.load for attempt in problem.attempts] == [0.2])
    agree(problem.solver.getTolerances()[0] == OWN)


def test_on_step(played):
    problem = played()

    def on_step(step: object) -> None:
        if LAST:
            raise OSError(28, "No space left on device")

    with raises(OSError, "No space left"):
        problem.follow([1.0], STEPS, on_step=on_step)
    equal(problem.state(), truth(0.2), 1e-12)


class NoTerminal(io.StringIO):
    """Looks like a terminal, and cannot be written to."""

    def __init__(self, error: Exception) -> None:
        super().__init__()
        self.error, self.tried = error, 0

    def isatty(self) -> bool:
        return True

    def write(self, text: str) -> int:
        self.tried += 1
        raise type(self.error)(*self.error.args)  # afresh: a traceback holds the SNES


@pytest.mark.parametrize(
    "error",
    [
        BrokenPipeError(32, "Broken pipe"),
        ValueError("I/O operation on closed file"),
        UnicodeEncodeError("ascii", "█", 0, 1, "ordinal not in range(128)"),
    ],
    ids=lambda error: type(error).__name__,
)
def test_terminal_of_the_first_process(error, played, monkeypatch):
    """The run goes on without the bar."""
    screen = NoTerminal(error)
    monkeypatch.setattr("dolfinx_feti.loading.progress.sys", SimpleNamespace(stderr=screen))
    steps = played(cost=lambda increment: 2).follow([1.0], STEPS)
    agree(steps[-1].load == 1.0 and (screen.tried > 0) == (COMM.rank == 0))
    # A thread of tqdm's would wait at exit for the lock that a failed write has left.
    agree(not [each for each in threading.enumerate() if isinstance(each, TMonitor)])


def test_parameters_of_a_checkpoint(tmp_path):
    with raises(ValueError, r"parameters\['c'\] is <.*>: give numbers"):
        opened(tmp_path / "run", restart=False, c=object() if LAST else 3.0)
    agree(not (tmp_path / "run").exists())


def test_record_of_a_checkpoint(tmp_path, state):
    """That of the first process counts."""
    checkpoint = opened(tmp_path, restart=False)
    bad = {"load": object()}
    checkpoint.write(state.functions, bad if COMM.rank else {"load": 1.0})
    agree(checkpoint.record == {"load": 1.0})
    with raises(TypeError, "is no number, string, or list"):
        checkpoint.write(state.functions, {"load": 1.0} if COMM.rank else bad)
    agree(checkpoint.record == opened(tmp_path).record == {"load": 1.0})
