# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The progress bar of a path on a terminal, and its lines in the log."""

from __future__ import annotations

import io
import threading
from collections.abc import Callable
from types import SimpleNamespace

import pytest
from collective import COMM, agree, raises
from tqdm import TMonitor

from dolfinx_feti import ConvergenceError
from dolfinx_feti.loading.steps import Steps


class Terminal(io.StringIO):
    """A stream, perhaps a terminal, that records what is written or fails."""

    encoding = "utf-8"

    def __init__(self, *, there: bool = True, error: Exception | None = None) -> None:
        super().__init__()
        self.there = there
        self.error = error
        self.tried = 0

    def isatty(self) -> bool:
        return self.there

    def write(self, text: str) -> int:
        self.tried += 1
        if self.error is not None:
            raise type(self.error)(*self.error.args)  # afresh: a traceback holds the SNES
        return super().write(text)


@pytest.fixture
def open_terminal(monkeypatch) -> Callable[..., Terminal]:
    """Return a function that replaces stderr by a Terminal; the clock is stopped."""
    clock = SimpleNamespace(perf_counter=lambda: 0.0)
    monkeypatch.setattr("dolfinx_feti.loading.stepper.time", clock)
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("LINES", "24")

    def open_one(**options: object) -> Terminal:
        screen = Terminal(**options)
        monkeypatch.setattr("dolfinx_feti.loading.progress.sys", SimpleNamespace(stderr=screen))
        return screen

    return open_one


@pytest.fixture
def terminal(open_terminal) -> Terminal:
    """The recording terminal of this process."""
    return open_terminal()


def lines(written: str) -> list[str]:
    """Return the successive texts of the terminal's line."""
    return [line.strip() for line in written.split("\r")[1:]]


def shown(terminal: Terminal) -> list[str]:
    """Return the successive texts that count Newton steps."""
    return [line for line in lines(terminal.getvalue()) if "Newton" in line]


def test_nothing_is_shown_where_there_is_no_terminal(create_fake_problem, open_terminal):
    """Without a terminal nothing is written to stderr."""
    screen = open_terminal(there=False)
    create_fake_problem().follow([1.0], Steps(first=0.1, least=0.1))
    agree(screen.getvalue() == "")


def test_bar_on_the_first_process(create_fake_problem, terminal):
    """Only the first process shows the bar: share, time left, load and Newton step."""
    steps = Steps(first=1.0, least=1.0, growth=1.0)
    create_fake_problem(cost=lambda increment: 2).follow(
        [3.0, 1.0], steps, unloading=True, unit="mmHg"
    )
    agree(COMM.rank == 0 or terminal.getvalue() == "")
    said = COMM.bcast(shown(terminal))
    last = {
        line.split("%")[0] + line.split("mmHg")[0].split("%")[1].split()[-3]: line for line in said
    }
    agree([line.split("%")[0].strip() for line in last.values()] == ["0", "20", "40", "60", "80"])
    agree(all("Newton 1  ‖r‖ = 1.0e-01" in line for line in last.values()), last)
    agree("3 → 2 of 1 mmHg" in list(last.values())[3], last)
    agree(["about 00:00 left" in line for line in last.values()] == [False] + [True] * 4, last)


def test_bar_goes_when_the_way_ends(create_fake_problem, terminal):
    """The bar is removed at the end, after a failure too, and later solves show none."""
    problem = create_fake_problem(fails=lambda before, load: load > 0.5)
    with raises(ConvergenceError, "beyond a load of 0.5"):
        problem.follow([1.0], Steps(first=0.5, least=0.5))
    written = terminal.getvalue()
    agree(lines(written)[-1:] == ([""] if COMM.rank == 0 else []))
    problem.solver.monitor(0, 1.0)
    agree(terminal.getvalue() == written)


def test_one_monitor_however_many_loads(create_fake_problem, terminal):
    """Each path has a new bar, and the user's monitor is kept."""
    problem = create_fake_problem()
    seen = []
    problem.solver.setMonitor(lambda snes, its, norm: seen.append(its))
    for load in (1.0, 2.0, 3.0):
        problem.follow([load], Steps(first=1.0, least=1.0))
    agree(len(problem.solver.getMonitor()) == 2)
    agree(seen == [0, 0, 0])
    loads = ["0 → 1 of 1", "1 → 2 of 2", "2 → 3 of 3"] if COMM.rank == 0 else []
    agree(all(any(load in line for line in shown(terminal)) for load in loads), shown(terminal))


def test_bar_makes_room_for_other_output(create_fake_problem, terminal):
    """The line of the bar is empty while ``on_step`` is called."""
    cleared = []
    create_fake_problem().follow(
        [1.0],
        Steps(first=0.5, least=0.5),
        on_step=lambda _: cleared.append(lines(terminal.getvalue())[-1:]),
    )
    agree(set(map(tuple, cleared)) == {("",) if COMM.rank == 0 else ()}, cleared)


@pytest.mark.parametrize(
    "error",
    [
        BrokenPipeError(32, "Broken pipe"),
        ValueError("I/O operation on closed file"),
        UnicodeEncodeError("ascii", "█", 0, 1, "ordinal not in range(128)"),
    ],
    ids=lambda error: type(error).__name__,
)
def test_terminal_of_the_first_process(error, create_fake_problem, open_terminal):
    """If the terminal cannot be written, the path goes on without a bar."""
    screen = open_terminal(error=error)
    steps = create_fake_problem(cost=lambda increment: 2).follow([1.0], Steps(first=0.2, least=0.1))
    agree(steps[-1].load == 1.0 and (screen.tried > 0) == (COMM.rank == 0))
    # A thread of tqdm's would wait at exit for the lock that a failed write has left.
    agree(not [each for each in threading.enumerate() if isinstance(each, TMonitor)])


# -- the log


def test_a_line_for_each_load_step(create_fake_problem, open_terminal, caplog):
    """The first process logs one line for each load step, and one for each failed attempt."""
    caplog.set_level("INFO", logger="dolfinx_feti")
    problem = create_fake_problem(
        cost=lambda increment: 2, fails=lambda before, load: before == 0.5 and load == 1.0
    )
    problem.solver.setFunctionNorm(2.5e-7)
    problem.follow([1.0], Steps(first=0.5, least=0.25, growth=1.0), unit="mmHg")
    said = [record.getMessage() for record in caplog.records]
    residual = "residual 2.5e-07, 0.0 s"
    two = f"2 Newton steps with 2 tangents, 14 linear iterations, {residual}"
    four = f"4 Newton steps with 4 tangents, 28 linear iterations, {residual}"
    expected = [
        f"load step 1: 0.5 of 1 mmHg, {two}, about 00:00 left",
        "no equilibrium at 1: The spring broke.",
        f"load step 2: 0.75 of 1 mmHg after 1 failed attempt(s), {four}, about 00:00 left",
        f"load step 3: 1 of 1 mmHg, {two}",
    ]
    agree(said == (expected if COMM.rank == 0 else []), said)
