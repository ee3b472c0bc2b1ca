# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The bar of the load on a terminal, and its lines in the log."""

from __future__ import annotations

import io
from types import SimpleNamespace

import pytest
from collective import COMM, agree, raises

from dolfinx_feti import ConvergenceError
from dolfinx_feti.loading.progress import WIDTH, Progress, duration, time_left
from dolfinx_feti.loading.steps import LoadStep, Steps

#: What the bar says of the time that a played problem takes.
LEFT = "about 0 s left  "


class Terminal(io.StringIO):
    """Keeps what is written to it."""

    def isatty(self) -> bool:
        return True


@pytest.fixture
def terminal(monkeypatch) -> Terminal:
    """Give each process a terminal of 100 columns as stderr."""
    screen = Terminal()
    monkeypatch.setattr("dolfinx_feti.loading.progress.sys", SimpleNamespace(stderr=screen))
    monkeypatch.setenv("COLUMNS", "100")
    return screen


def lines(written: str) -> list[str]:
    """Return what stood on the terminal's line, one after the other."""
    return written.split("\r\x1b[K")[1:]


def test_nothing_is_shown_where_there_is_no_terminal(played, monkeypatch):
    screen = io.StringIO()
    monkeypatch.setattr("dolfinx_feti.loading.progress.sys", SimpleNamespace(stderr=screen))
    played().follow([1.0], Steps(first=0.1, least=0.1))
    agree(screen.getvalue() == "", screen.getvalue())


def test_bar_on_the_first_process(played, terminal):
    played(cost=lambda increment: 2).follow(
        [1.0, 2.0], Steps(first=0.5, least=0.5, growth=1.0), unit="mmHg"
    )
    shown = lines(terminal.getvalue())
    if COMM.rank == 0:
        text = [line.split("%")[1].strip().removeprefix(LEFT) for line in shown if line]
        expected = [
            f"{load:.4g} → {load + 0.5:.4g} of 2 mmHg{newton}"
            for load in (0.0, 0.5, 1.0, 1.5)
            for newton in ("", "  Newton 0  ‖r‖ = 1.0e+00", "  Newton 1  ‖r‖ = 1.0e-01")
        ]
        filled = [line.count("█") / (line.count("█") + line.count("░")) for line in shown if line]
        known = [LEFT in line for line in shown if line]  # from the second step on
        ok = known == [False] * 3 + [True] * 9
        ok = ok and text == expected and shown[-1] == "" and filled[::3] == [0.0, 0.25, 0.5, 0.75]
    else:
        ok = shown == []
    agree(ok, shown)


def test_bar_measures_the_way_up_and_down(played, terminal):
    steps = Steps(first=1.0, least=1.0, growth=1.0)
    played().follow([3.0, 1.0, 2.0], steps, unloading=True)
    percent = [line.split("%")[0][-4:] for line in lines(terminal.getvalue()) if "Newton" in line]
    expected = [0, 17, 33, 50, 67, 83] if COMM.rank == 0 else []
    agree([int(number) for number in percent] == expected, percent)


def test_bar_is_as_wide_as_the_terminal(played, terminal, monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    played().follow([1.0], Steps(first=0.5, least=0.5), unit="millimetres of mercury")
    width = max((len(line) for line in lines(terminal.getvalue())), default=0)
    agree(width == (39 if COMM.rank == 0 else 0), width)


def test_bar_goes_when_the_way_ends(played, terminal):
    """After a failure too, and a later solve of the same SNES shows nothing."""
    problem = played(fails=lambda before, load: load > 0.5)
    with raises(ConvergenceError, "beyond a load of 0.5"):
        problem.follow([1.0], Steps(first=0.5, least=0.5))
    written = terminal.getvalue()
    agree(lines(written)[-1:] == ([""] if COMM.rank == 0 else []))
    problem.solver.monitor(0, 1.0)
    agree(terminal.getvalue() == written)


def test_one_monitor_however_many_loads(played, terminal):
    """The user's own stays, too; each load has its own bar."""
    problem, seen = played(), []
    problem.solver.setMonitor(lambda snes, its, norm: seen.append(its))
    for load in (1.0, 2.0, 3.0):
        problem.follow([load], Steps(first=1.0, least=1.0))
    monitors = len(problem.solver.getMonitor())
    agree(monitors == (2 if COMM.rank == 0 else 1), monitors)
    agree(seen == [0, 0, 0], seen)
    shown = [line.split("%")[1] for line in lines(terminal.getvalue()) if "Newton" in line]
    loads = ["0 → 1 of 1", "1 → 2 of 2", "2 → 3 of 3"] if COMM.rank == 0 else []
    agree([text.split("  ")[1] for text in shown] == loads, shown)


def test_bar_makes_room_for_other_output(played, terminal):
    """Where ``on_step`` is called, the line is empty."""
    cleared = []
    played().follow(
        [1.0],
        Steps(first=0.5, least=0.5),
        on_step=lambda _: cleared.append(lines(terminal.getvalue())[-1:]),
    )
    agree(set(map(tuple, cleared)) == {("",) if COMM.rank == 0 else ()}, cleared)


def test_bar_where_there_is_no_way_left(played, terminal):
    """As at a restart whose only target has been met, but roughly."""
    problem = played()
    with Progress(problem.solver, COMM, loads=[3.0, 3.0], unit="mmHg") as bar:
        bar.attempt(3.0, 3.0)
        bar.accept(LoadStep(3.0, 0.0, (), 0, (), 1.0))
    shown = [line.split("  ")[0] for line in lines(terminal.getvalue()) if line]
    agree(shown == (["█" * WIDTH + " 100 %"] if COMM.rank == 0 else []), shown)


# -- the log


def test_a_line_for_each_load_step(played, caplog):
    """On the first process; a failed attempt has a line of its own."""
    caplog.set_level("INFO", logger="dolfinx_feti")
    problem = played(
        cost=lambda increment: 2, fails=lambda before, load: before == 0.5 and load == 1.0
    )
    problem.solver.setFunctionNorm(2.5e-7)
    problem.follow([1.0], Steps(first=0.5, least=0.25, growth=1.0), unit="mmHg")
    said = [record.getMessage() for record in caplog.records]
    residual = "residual 2.5e-07, 0.0 s"
    two = f"2 Newton steps with 2 tangents, 14 linear iterations, {residual}"
    four = f"4 Newton steps with 4 tangents, 28 linear iterations, {residual}"
    expected = [
        f"load step 1: 0.5 of 1 mmHg, {two}, about 0 s left",
        "no equilibrium at 1: The spring broke.",
        f"load step 2: 0.75 of 1 mmHg after 1 failed attempt(s), {four}, about 0 s left",
        f"load step 3: 1 of 1 mmHg, {two}",
    ]
    agree(said == (expected if COMM.rank == 0 else []), said)


def step_of(increment, seconds):
    return LoadStep(0.0, increment, (), 0, (), seconds)


def test_time_left():
    """The pace of the last three steps, up or down; nothing without a way to take it from."""
    steps = [step_of(1.0, 100.0), step_of(1.0, 2.0), step_of(-2.0, 4.0), step_of(1.0, 6.0)]
    agree(time_left(steps, 8.0) == 24.0)
    agree(time_left(steps[:1], 0.5) == 50.0 and time_left(steps, 0.0) == 0.0)
    agree(time_left([], 1.0) is None and time_left([step_of(0.0, 1.0)], 1.0) is None)


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.2, "0 s"), (99.4, "99 s"), (100, "2 min"), (3599, "1 h 0 min"), (12000, "3 h 20 min")],
)
def test_duration(seconds, words):
    agree(duration(seconds) == words, duration(seconds))
