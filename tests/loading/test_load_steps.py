# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Load steps: on a played problem, where everything is known, and on a wall."""

from __future__ import annotations

import io
import itertools
import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import SimpleNamespace

from petsc4py import PETSc

import numpy as np
import pytest
from collective import COMM, agree, equal, raises, small
from mixed import by_place
from problems import cube
from walls import Wall, tube, wall

import dolfinx

from dolfinx_feti import ConvergenceError, NonlinearProblem, loads
from dolfinx_feti.loading.load_steps import LoadStep, Steps, follow_load
from dolfinx_feti.problems.history import NewtonStep

ROUNDING = 1e-12
OWN = 1e-9
STEP = NewtonStep(
    residual=1.0,
    step_length=1.0,
    linear_method="cg",
    linear_iterations=7,
    linear_residual=1e-9,
    condition_number=3.0,
    negative=0,
    indefinite=0,
    shift=0.0,
    solves=1,
    seconds_assembly=0.1,
    seconds_linear=0.2,
)


SNES = PETSc.SNES.ConvergedReason


@dataclass(frozen=True, slots=True)
class Attempt:
    """What a problem saw when it was solved.

    Attributes:
        load: The load.
        before: That of the last equilibrium.
        rtol: The tolerance.
        referred: Load and state that the tolerance refers to, if it was given.
        linearised: Load and state of the first tangent, if it was given.
        guess: The state, u and p in one entry each.
        converged: What came of it.
    """

    load: float
    before: float
    rtol: float
    referred: tuple[float, float, float] | None
    linearised: tuple[float, float, float] | None
    guess: tuple[float, float]
    converged: bool


class Played:
    """A problem with known equilibria, u(t) = 1 − 2 t + 3 t² and p(t) = t² − t.

    A solve takes as many Newton steps as it is told, or fails and leaves nonsense behind.
    """

    def __init__(
        self,
        *,
        start: float = 0.0,
        cost: Callable[[float], int] = lambda increment: 1,
        fails: Callable[[float, float], bool] = lambda before, load: False,
        inside_out: Callable[[float], bool] = lambda load: False,
    ) -> None:
        mesh = cube(2, 2)
        V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1))
        self.u = dolfinx.fem.Function(V)
        self.p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)))
        self.solver = PETSc.SNES().create(COMM)
        self.solver.setTolerances(rtol=OWN, atol=1e-10, max_it=30)
        self.solver.setSolution(PETSc.Vec().createMPI(1, comm=COMM))  # or it cannot be monitored
        self.history: list[NewtonStep] = []
        self.attempts: list[Attempt] = []
        self._cost, self._fails, self._inside_out = cost, fails, inside_out
        self._norms: dict[float, tuple[float, float, float]] = {}
        self.load = self._equilibrium = start
        self._set(*truth(start))

    def _set(self, u: float, p: float) -> None:
        self.u.x.array[:], self.p.x.array[:] = u, p

    def state(self) -> tuple[float, float]:
        """Return u and p; each must have one value all over."""
        values = [f.x.array for f in (self.u, self.p)]
        agree(all(np.ptp(v) <= ROUNDING * (1 + abs(v[0])) for v in values if len(v)))
        return tuple(float(COMM.bcast(v[0] if len(v) else None)) for v in values)

    def linearise(self) -> tuple[float, float, float]:
        return (self.load, *self.state())

    def residual_norm(self) -> float:
        norm = 1.0 + len(self._norms)
        self._norms[norm] = (self.load, *self.state())
        return norm

    def solve(
        self,
        *,
        reference: float | None = None,
        first_tangent: tuple[float, float, float] | None = None,
    ) -> None:
        before = self._equilibrium
        domain = first_tangent is None and self._inside_out(self.load)
        self.solver.setConvergedReason(
            SNES.DIVERGED_FUNCTION_DOMAIN if domain else SNES.DIVERGED_LINE_SEARCH
        )
        fails = domain or self._fails(before, self.load)
        self.attempts.append(
            Attempt(
                self.load,
                before,
                self.solver.getTolerances()[0],
                None if reference is None else self._norms[reference],
                first_tangent,
                self.state(),
                not fails,
            )
        )
        for it in range(cost := self._cost(abs(self.load - before))):
            self.solver.monitor(it, 10.0**-it)
        self.history = [STEP] * cost
        if fails:
            self._set(math.nan, math.inf)
            raise ConvergenceError("The spring broke.")
        self._equilibrium = self.load
        self._set(*truth(self.load))

    def follow(self, targets: list[float], steps: Steps, **arguments: object) -> list[LoadStep]:
        return follow_load(
            self,
            lambda load: setattr(self, "load", load),
            targets,
            steps,
            state=[self.u, self.p],
            start=self._equilibrium,
            **arguments,
        )


@pytest.fixture
def played() -> Iterator[Callable[..., Played]]:
    made: list[Played] = []

    def create(**arguments: object) -> Played:
        made.append(Played(**arguments))
        return made[-1]

    yield create
    for problem in made:
        problem.solver.destroy()


def truth(t: float) -> tuple[float, float]:
    return 1 - 2 * t + 3 * t**2, t**2 - t


def increments(steps: list[LoadStep]) -> np.ndarray:
    return np.abs([step.increment for step in steps])


# -- the way


@pytest.mark.parametrize(
    "targets",
    [
        pytest.param([1.0], id="up"),
        pytest.param([0.1, 0.3, 1 / 3, 1.1], id="up by several"),
        pytest.param([-0.7], id="down"),
        pytest.param([0.9, 0.2, -math.pi / 10, 0.55], id="up and down"),
        pytest.param([0.9, 0.9 + 1e-9], id="hardly away"),
    ],
)
def test_targets_are_met_exactly_one_after_the_other(played, targets):
    problem = played(start=0.05)
    turns = len(targets) == 4 and targets[1] < targets[0]
    steps = problem.follow(targets, Steps(first=0.07, least=0.01), unloading=turns)
    path = [0.05, *(step.load for step in steps)]
    corners = iter(path)
    agree(all(target in corners for target in targets), path)  # each behind the one before
    agree(path[-1] == targets[-1] == problem.load)
    for (a, b), step in zip(itertools.pairwise(path), steps, strict=True):
        agree(step.increment == b - a)
        ahead = next(t for t in [*targets, b] if min(a, t) <= b <= max(a, t))
        agree((b - a) * (ahead - a) > 0, "never beyond a target")
    equal(problem.state(), truth(targets[-1]), ROUNDING)


@pytest.mark.parametrize("targets", [[], [0.3], [0.3, 0.3]])
def test_nothing_is_done_where_one_is_already(played, targets):
    problem = played(start=0.3)
    agree(problem.follow(targets, Steps(first=1.0, least=1.0)) == [] and not problem.attempts)


def test_what_is_left_is_divided_evenly(played):
    """No small rest before a target."""
    problem = played(cost=lambda increment: 9)
    steps = problem.follow([1.0], Steps(first=0.4, least=0.1, quick=3))
    equal(increments(steps), np.full(3, 1 / 3), ROUNDING)


def test_increments_grow_after_quick_steps(played):
    problem = played(cost=lambda increment: 3)
    steps = problem.follow([100.0], Steps(first=1.0, least=1.0, growth=2.0, quick=3))
    found = increments(steps)
    agree(found[0] == 1.0)
    agree(np.all(found[1:] <= 2 * found[:-1] * (1 + ROUNDING)), found)
    agree(len(found) == 7 and found.max() > 30, found)  # 1 + 2 + 4 + … > 100 with seven terms


def test_increments_keep_their_length_after_slow_steps(played):
    problem = played(cost=lambda increment: 4)
    steps = problem.follow([10.0], Steps(first=1.0, least=1.0, growth=2.0, quick=3))
    equal(increments(steps), np.ones(10), ROUNDING)


@pytest.mark.parametrize("cost", [1, 9])
def test_increments_keep_their_length_over_a_target(played, cost):
    """A short step to a target nearby, quick or slow, does not make the next ones short."""
    problem = played(cost=lambda increment: cost)
    steps = problem.follow([1.0, 1.01, 2.01], Steps(first=0.5, least=0.1, growth=1.0, quick=3))
    equal(increments(steps), [0.5, 0.5, 0.01, 0.5, 0.5], 1e-9)


# -- failures


def test_increment_is_halved_until_it_succeeds(played):
    """Each new attempt begins in the last equilibrium."""
    problem = played(fails=lambda before, load: load - before > 0.3, cost=lambda increment: 9)
    steps = problem.follow([4.0], Steps(first=1.0, least=0.01, quick=3))
    equal([a.load for a in problem.attempts[:4]], [1.0, 0.5, 0.25, 0.5], ROUNDING)
    agree([step.failures for step in steps] == [2] + 15 * [0])
    agree([len(step.lost) for step in steps] == [18] + 15 * [0])
    agree([len(step.all_steps) for step in steps] == [27] + 15 * [9])
    for attempt in problem.attempts[:3]:
        equal(attempt.linearised, (0.0, *truth(0.0)), ROUNDING)
    equal(problem.state(), truth(4.0), ROUNDING)


def test_increment_does_not_grow_in_a_step_that_failed_first(played):
    """The step was quick, but only because it was short."""
    problem = played(fails=lambda before, load: before == 0.0 and load > 0.3)
    steps = problem.follow([8.0], Steps(first=1.0, least=0.01, growth=2.0, quick=3))
    equal(increments(steps)[:2], [0.25, 0.25], 0.01)
    agree(increments(steps)[2] > 0.4)


@pytest.mark.parametrize(
    ("start", "target", "first", "least"),
    [(0.0, 1.0, 1.0, 0.1), (1.0, 1.2, 0.1, 0.1), (0.0, -1.0, 0.5, 0.5), (1e6, 1e6 + 1, 1.0, 1e-9)],
    ids=["halved", "first", "down", "rounding"],
)
def test_least_increment(played, start, target, first, least):
    """State and load are those of the last equilibrium, and the message says what to do."""
    problem = played(start=start, fails=lambda before, load: load != before)
    with raises(
        ConvergenceError,
        rf"beyond a load of {re.escape(f'{start:g}')}: an increment of .* {least:g} is the least "
        "allowed. The spring broke. Allow smaller increments",
    ):
        problem.follow([target], Steps(first=first, least=least))
    agree(problem.load == start)
    equal(problem.state(), truth(start), ROUNDING)
    tried = np.abs([attempt.load - start for attempt in problem.attempts])
    agree(np.all(tried[1:] < tried[:-1]) and tried[-1] >= 0.5 * least, tried)


def test_failure_far_along_the_way(played):
    """What was accepted before has been reported, and the last of it is the state."""
    problem = played(fails=lambda before, load: load > 2.2)
    seen: list[LoadStep] = []
    with raises(ConvergenceError, "beyond a load of 2: "):
        problem.follow([5.0], Steps(first=0.5, least=0.25, growth=1.0), on_step=seen.append)
    equal([step.load for step in seen], [0.5, 1.0, 1.5, 2.0], ROUNDING)
    agree(problem.load == seen[-1].load)
    equal(problem.state(), truth(2.0), ROUNDING)


def test_other_errors_are_left_alone(played):
    problem = played()

    def refuse(load: float) -> None:
        if load > 0.4:
            raise ZeroDivisionError("not this load")

    with raises(ZeroDivisionError, "not this load"):
        follow_load(problem, refuse, [1.0], Steps(first=0.2, least=0.1), state=[problem.u])
    small(problem.solver.getTolerances()[0] - OWN, 0.0)


# -- prediction and tolerances


def test_first_steps_begin_with_the_tangent_of_the_last_equilibrium(played):
    problem = played()
    problem.follow([1.0], Steps(first=0.1, least=0.1, growth=1.0))
    for attempt in problem.attempts[:2]:
        expected = (attempt.before, *truth(attempt.before))
        equal(attempt.linearised, expected, ROUNDING)
        equal(attempt.guess, truth(attempt.before), ROUNDING)


@pytest.mark.parametrize("growth", [1.0, 1.7])
def test_prediction_is_exact_for_parabolas(played, growth):
    """With increments of any length, on the way back, and after a failure."""
    problem = played(fails=lambda before, load: before > 0.5 and load - before > 0.3)
    steps = Steps(first=0.15, least=0.01, growth=growth)
    problem.follow([2.0, 0.3, 1.0], steps, unloading=True)
    agree(len(problem.attempts) > 8)
    for attempt in problem.attempts[2:]:
        agree(attempt.linearised is None)
        equal(attempt.guess, truth(attempt.load), 1e-9)
    agree(growth == 1.0 or not all(attempt.converged for attempt in problem.attempts))


def test_inadmissible_prediction_gives_way_to_the_tangent(played):
    """No step is lost; and a failure from there is one."""
    problem = played(inside_out=lambda load: load > 0.5, fails=lambda before, load: load == 0.8)
    steps = problem.follow([1.0], Steps(first=0.2, least=0.01, growth=1.0))
    agree([step.failures for step in steps] == [0, 0, 0, 1, 0, 0, 0], steps)
    for step in (attempt for attempt in problem.attempts if attempt.load > 0.5):
        if step.linearised is not None:
            agree(step.linearised[0] == step.before)
            equal(step.linearised[1:], truth(step.before), ROUNDING)
    agree(sum(attempt.linearised is not None for attempt in problem.attempts) >= 6)


def test_a_load_met_twice_does_not_break_the_prediction(played):
    problem = played()
    steps = Steps(first=0.1, least=0.1, growth=1.0)
    problem.follow([0.1, 0.2, 0.1, 0.2, 0.1], steps, unloading=True)
    equal(problem.state(), truth(0.1), ROUNDING)
    agree(all(np.isfinite(attempt.guess).all() for attempt in problem.attempts))


@pytest.mark.parametrize("rough", [None, 1e-2, OWN / 100])
def test_rough_on_the_way_and_exact_at_the_targets(played, rough):
    """If it is asked for; a tolerance of the solver's own that is rougher still is kept."""
    problem = played(fails=lambda before, load: load == 0.5 and load - before > 0.15)
    before = problem.solver.getTolerances()
    problem.follow([0.5, 1.0], Steps(first=0.2, least=0.01, growth=1.0, rtol=rough))
    agree(problem.solver.getTolerances() == before)
    agree(not all(attempt.converged for attempt in problem.attempts))
    for attempt in problem.attempts:
        expected = OWN if attempt.load in (0.5, 1.0) else max(rough or 0.0, OWN)
        small(attempt.rtol - expected, 0.0)


def test_tolerances_after_a_failure(played):
    problem = played(fails=lambda before, load: True)
    before = problem.solver.getTolerances()
    with raises(ConvergenceError, "No equilibrium was found"):
        problem.follow([1.0], Steps(first=0.1, least=0.1, rtol=0.5))
    agree(problem.attempts[0].rtol == 0.5 and problem.solver.getTolerances() == before)


def test_tolerance_refers_to_the_last_equilibrium_under_the_new_load(played):
    """And not to the predicted state."""
    problem = played()
    problem.follow([1.0], Steps(first=0.1, least=0.01))
    for attempt in problem.attempts:
        expected = None if attempt.linearised else (attempt.load, *truth(attempt.before))
        agree(attempt.referred == expected, attempt)
    agree(any(attempt.referred for attempt in problem.attempts))


# -- what the caller sees


def test_on_step_is_called_in_each_equilibrium_on_all_processes(played):
    problem = played(cost=lambda increment: 2, fails=lambda before, load: load - before > 0.25)
    seen: list[LoadStep] = []

    def look(step: LoadStep) -> None:
        equal(problem.state(), truth(step.load), ROUNDING)
        agree(problem.load == step.load and step.history == (STEP, STEP))
        seen.append(step)

    steps = problem.follow([1.0], Steps(first=0.4, least=0.1), on_step=look)
    agree(seen == steps and COMM.bcast([s.load for s in seen]) == [s.load for s in seen])
    agree(sum(step.failures for step in steps) > 0 and all(step.seconds >= 0 for step in steps))


@pytest.mark.parametrize("targets", [[1.0, 0.5], [0.5, 0.7, -1.0], [-1.0, 0.0]])
def test_load_that_turns_back(played, targets):
    """A list out of order is an error, unless unloading is meant; nothing has moved by then."""
    problem = played()
    steps = Steps(first=0.5, least=0.5)
    with raises(ValueError, r"targets=.*: the load turns back.* unloading=True"):
        problem.follow(targets, steps)
    agree(problem.load == 0.0)
    agree(problem.follow(targets, steps, unloading=True)[-1].load == targets[-1])


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_loads_that_are_no_numbers(played, bad):
    problem = played()
    with raises(ValueError, r"targets=\[1.0, (nan|inf)\]: loads are finite numbers"):
        problem.follow([1.0, bad], Steps(first=1.0, least=1.0))
    with raises(ValueError, "start=(nan|inf)"):
        follow_load(
            problem, lambda _: None, [1.0], Steps(first=1.0, least=1.0), state=[], start=bad
        )
    agree(not problem.attempts)


@pytest.mark.parametrize(
    ("wrong", "match"),
    [
        ({"first": 0.0}, "first=0.0 and least="),
        ({"first": -1.0}, "first=-1.0"),
        ({"first": math.nan}, "first=nan"),
        ({"first": math.inf}, "first=inf"),
        ({"least": 0.0}, "least=0.0"),
        ({"least": 2.0}, "least=2.0: increments are positive numbers, and the least is not above"),
        ({"least": math.nan}, "least=nan"),
        ({"rtol": 0.0}, "rtol=0.0 is not a number between 0 and 1"),
        ({"rtol": 1.0}, "rtol=1.0"),
        ({"rtol": math.nan}, "rtol=nan"),
        ({"growth": 0.9}, "growth=0.9 is not a number of 1 or more"),
        ({"growth": math.inf}, "growth=inf"),
        ({"growth": math.nan}, "growth=nan"),
    ],
)
def test_steps_out_of_range(wrong, match):
    with raises(ValueError, match):
        Steps(**{"first": 1.0, "least": 0.1} | wrong)


# -- progress


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
        text = [line.split("%")[1].strip() for line in shown if line]
        expected = [
            f"{load:.4g} → {load + 0.5:.4g} of 2 mmHg{newton}"
            for load in (0.0, 0.5, 1.0, 1.5)
            for newton in ("", "  Newton 0  ‖r‖ = 1.0e+00", "  Newton 1  ‖r‖ = 1.0e-01")
        ]
        filled = [line.count("█") / (line.count("█") + line.count("░")) for line in shown if line]
        ok = text == expected and shown[-1] == "" and filled[::3] == [0.0, 0.25, 0.5, 0.75]
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


def test_bar_makes_room_for_other_output(played, terminal):
    """Where ``on_step`` is called, the line is empty."""
    cleared = []
    played().follow(
        [1.0],
        Steps(first=0.5, least=0.5),
        on_step=lambda _: cleared.append(lines(terminal.getvalue())[-1:]),
    )
    agree(set(map(tuple, cleared)) == {("",) if COMM.rank == 0 else ()}, cleared)


# -- a wall


def small_wall() -> Wall:
    return wall(tube(around=6, along=2), degree=1)


def follow_wall(
    body: Wall,
    problem: NonlinearProblem,
    targets: list[float],
    steps: Steps,
    **arguments: object,
) -> list[LoadStep]:
    return follow_load(
        problem,
        lambda pressure: setattr(body.load, "value", loads.mmhg(pressure)),
        targets,
        steps,
        state=[body.u, body.p],
        **arguments,
    )


def test_wall_up_and_down():
    """The way does not matter: as solved at once, in steps, and on the way back."""
    tight = {"snes_rtol": 1e-11}
    direct, stepped = small_wall(), small_wall()
    direct.inflate(direct.problem(4, tight), [4.0])
    problem = stepped.problem(4, tight)
    steps = Steps(first=1.0, least=0.25)
    for start, targets in ((0.0, [4.0]), (4.0, [7.0, 4.0])):
        record = follow_wall(
            stepped, problem, targets, steps, start=start, unloading=len(targets) > 1
        )
        agree(record[-1].load == 4.0 and not any(step.failures for step in record))
        equal(by_place(stepped.u), by_place(direct.u), 1e-8)
        equal(by_place(stepped.p), by_place(direct.p), 1e-7)
        small(max(s.linear_residual for step in record for s in step.history), 1e-8)


def test_wall_with_steps_that_fail():
    """Too few Newton steps for the wanted increment, enough for a half of it."""
    body = small_wall()
    problem = body.problem(4, {"snes_max_it": 3})
    record = follow_wall(body, problem, [60.0], Steps(first=60.0, least=0.1))
    agree(sum(step.failures for step in record) > 0 and record[-1].load == 60.0)
    direct = small_wall()
    direct.inflate(direct.problem(4, {"snes_rtol": 1e-11}), [10.0, 30.0, 60.0])
    equal(by_place(body.u), by_place(direct.u), 1e-6)
