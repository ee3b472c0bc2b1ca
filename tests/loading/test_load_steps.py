# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Load steps: targets, increments, attempts after a failure, prediction, tolerances."""

from __future__ import annotations

import itertools
import json
import math
import re
from dataclasses import asdict, dataclass

import numpy as np
import pytest
from collective import COMM, agree, equal, raises, small
from fake_problem import OWN, ROUNDING, STEP, truth
from mixed import by_place
from walls import tube, wall

from dolfinx_feti import ConvergenceError, loads
from dolfinx_feti.errors import IndefiniteTangentError, LinearSolverError, ToolCrossedError
from dolfinx_feti.loading.load_step import LoadStep, read_step
from dolfinx_feti.loading.load_steps import follow_load
from dolfinx_feti.loading.step_length import StepLengthRule
from dolfinx_feti.loading.steps import Steps

LAST = COMM.rank == COMM.size - 1


def increments(steps: list[LoadStep]) -> np.ndarray:
    """Return the increments of load steps."""
    return np.abs([step.increment for step in steps])


@pytest.mark.parametrize(
    ("first", "targets"),
    [
        (0.07, [1.0]),
        (0.07, [0.1, 0.3, 1 / 3, 1.1]),
        (0.07, [-0.7]),
        (0.07, [0.9, 0.2, -math.pi / 10, 0.55]),
        (0.07, [0.9, 0.9 + 1e-9]),
        (0.2, [0.1, 0.2, 0.1, 0.2, 0.1]),  # loads that are met twice do not break the prediction
    ],
)
def test_targets_are_met_exactly_one_after_the_other(create_fake_problem, first, targets):
    """Load steps reach all targets exactly, in their order."""
    problem = create_fake_problem(start=0.05)
    turns = len(set(np.sign(np.diff([0.05, *targets])))) > 1
    steps = problem.follow(targets, Steps(first=first, least=0.01), unloading=turns)
    path = [0.05, *(step.load for step in steps)]
    corners = iter(path)
    agree(all(target in corners for target in targets), path)  # each behind the one before
    agree(path[-1] == targets[-1] == problem.load)
    for (a, b), step in zip(itertools.pairwise(path), steps, strict=True):
        agree(step.increment == b - a)
        ahead = next(t for t in [*targets, b] if min(a, t) <= b <= max(a, t))
        agree((b - a) * (ahead - a) > 0, "never beyond a target")
    agree(all(np.isfinite(attempt.guess).all() for attempt in problem.attempts))
    equal(problem.state(), truth(targets[-1]), ROUNDING)


@pytest.mark.parametrize("targets", [[], [0.3], [0.3, 0.3]])
def test_reached_targets_need_no_load_step(create_fake_problem, targets):
    """Targets equal to the present load need no load step."""
    problem = create_fake_problem(start=0.3)
    agree(problem.follow(targets, Steps(first=1.0, least=1.0)) == [] and not problem.attempts)


@pytest.mark.parametrize(
    ("cost", "targets", "first", "growth", "expected"),
    [
        (9, [1.0], 0.4, 1.5, np.full(3, 1 / 3)),  # evenly: no small rest before a target
        (4, [100.0], 1.0, 2.0, np.ones(100)),  # they keep their length after slow steps
        (1, [1.0, 1.01, 2.01], 0.5, 1.0, [0.5, 0.5, 0.01, 0.5, 0.5]),  # and over a target nearby,
        (9, [1.0, 1.01, 2.01], 0.5, 1.0, [0.5, 0.5, 0.01, 0.5, 0.5]),  # whatever it costs
    ],
)
def test_increments_follow_from_cost_growth_and_targets(
    create_fake_problem, cost, targets, first, growth, expected
):
    """The increments of a path are those expected from cost, growth and targets."""
    problem = create_fake_problem(cost=lambda increment: cost)
    steps = problem.follow(targets, Steps(first=first, least=0.1, growth=growth, quick=3))
    equal(increments(steps), expected, 1e-9)


def test_increments_grow_after_quick_steps(create_fake_problem):
    """An increment grows after a load step with few Newton steps."""
    problem = create_fake_problem(cost=lambda increment: 3)
    steps = problem.follow([100.0], Steps(first=1.0, least=1.0, growth=2.0, quick=3))
    found = increments(steps)
    agree(found[0] == 1.0 and len(found) == 7, found)  # 1 + 2 + 4 + … > 100 with seven terms
    agree(np.all(found[1:] <= 2 * found[:-1] * (1 + ROUNDING)), found)


class Doubling(StepLengthRule[LoadStep]):
    """A step-length rule that doubles each increment."""

    def adapt(self, step, *, n_updates):
        self.present = 2.0 * abs(step.increment)


@dataclass(frozen=True)
class DoubledSteps(Steps):
    """Steps with the rule that doubles each increment."""

    def length_rule(self):
        return Doubling(self.first, self.least)


def test_a_further_rule_is_a_class_and_a_line(create_fake_problem):
    """A user's step-length rule decides the increments, also after slow load steps."""
    problem = create_fake_problem(cost=lambda increment: 99)
    steps = problem.follow([7.0], DoubledSteps(first=1.0, least=1.0, quick=3))
    equal(increments(steps), [1.0, 2.0, 4.0], ROUNDING)


def test_increment_is_halved_until_it_succeeds(create_fake_problem):
    """Attempts are halved from the last equilibrium, each with a new preconditioner."""
    problem = create_fake_problem(
        fails=lambda before, load: load - before > 0.3, cost=lambda increment: 9
    )
    steps = problem.follow([4.0], Steps(first=1.0, least=0.01, quick=3))
    equal([a.load for a in problem.attempts[:4]], [1.0, 0.5, 0.25, 0.5], ROUNDING)
    agree([step.failures for step in steps] == [2] + 15 * [0])
    agree([len(step.lost) for step in steps] == [18] + 15 * [0])
    read = read_step(json.loads(json.dumps(asdict(steps[0]))), LoadStep)  # as from a checkpoint
    agree(repr(read) == repr(steps[0]))
    agree([len(step.all_steps) for step in steps] == [27] + 15 * [9])
    for attempt in problem.attempts[:3]:
        equal(attempt.linearised, (0.0, *truth(0.0)), ROUNDING)
    agree([attempt.renewed for attempt in problem.attempts] == 3 * [True] + 15 * [False])
    equal(problem.state(), truth(4.0), ROUNDING)


def test_increment_does_not_grow_in_a_step_that_failed_first(create_fake_problem):
    """An increment does not grow after a load step that needed a second attempt."""
    problem = create_fake_problem(fails=lambda before, load: before == 0.0 and load > 0.3)
    steps = problem.follow([8.0], Steps(first=1.0, least=0.01, growth=2.0, quick=3))
    equal(increments(steps)[:2], [0.25, 0.25], 0.01)
    agree(increments(steps)[2] > 0.4)


@pytest.mark.parametrize(
    ("start", "target", "first", "least", "last"),
    [
        (0.0, 1.0, 1.0, 0.1, 0.0),  # halved
        (1.0, 1.2, 0.1, 0.1, 1.0),  # the first one
        (0.0, -1.0, 0.5, 0.5, 0.0),  # down
        (1e6, 1e6 + 1, 1.0, 1e-9, 1e6),  # up to rounding
        (0.0, 5.0, 0.5, 0.25, 2.0),  # far along the way
    ],
)
def test_path_ends_at_the_least_increment_with_a_remedy(
    create_fake_problem, start, target, first, least, last
):
    """At the least increment a path ends in the last equilibrium, with a remedy in its error."""
    problem = create_fake_problem(
        start=start, fails=lambda before, load: abs(load - start) > last - start
    )
    before = problem.solver.getTolerances()
    seen = [start]
    with raises(
        ConvergenceError,
        rf"beyond a load of {re.escape(f'{last:g}')}: an increment of .* {least:g} is the least "
        "allowed. The spring broke. Allow smaller increments",
    ):
        problem.follow(
            [target],
            Steps(first=first, least=least, growth=1.0, rtol=0.5),
            on_step=lambda step: seen.append(step.load),
        )
    equal(seen, np.arange(start, last + first / 2, first), ROUNDING)
    agree(problem.load == seen[-1] and problem.solver.getTolerances() == before)
    agree(all(a.rtol == (OWN if a.load == target else 0.5) for a in problem.attempts))
    equal(problem.state(), truth(problem.load), ROUNDING)
    tried = np.abs([attempt.load - last for attempt in problem.attempts[len(seen) - 1 :]])
    agree(np.all(tried[1:] < tried[:-1]) and tried[-1] >= 0.5 * least, tried)


@pytest.mark.parametrize(
    ("error", "match"),
    [
        pytest.param(
            IndefiniteTangentError("It fails."),
            "limit point .* prescribe a displacement or a volume",
            id="indefinite",
        ),
        pytest.param(LinearSolverError("Add conditions."), "Add conditions.$", id="linear-solver"),
        pytest.param(ToolCrossedError("Use small steps."), "Use small steps.$", id="tool"),
        pytest.param(ConvergenceError("It fails."), "It fails. Allow smaller incr", id="other"),
    ],
)
def test_remedy_fits_the_failure(create_fake_problem, error, match):
    """The remedy fits the failure: smaller increments, unless the error has its own remedy."""

    def fails(before: float, load: float) -> bool:
        if load > 0.5:
            problem.u.x.array[:] = math.nan
            raise error
        return False

    problem = create_fake_problem(fails=fails)
    with raises(ConvergenceError, match):
        problem.follow([1.0], Steps(first=0.25, least=0.1))


@pytest.mark.parametrize("growth", [1.0, 1.7])
def test_prediction_is_exact_for_parabolas(create_fake_problem, growth):
    """The prediction is exact for quadratic paths, after turns and failures too.

    The first steps begin with the tangent of the last equilibrium. The tolerance refers to that
    under the new load, not to the prediction.
    """
    problem = create_fake_problem(fails=lambda before, load: before > 0.5 and load - before > 0.3)
    steps = Steps(first=0.15, least=0.01, growth=growth)
    problem.follow([2.0, 0.3, 1.0], steps, unloading=True)
    agree(len(problem.attempts) > 8)
    for attempt in problem.attempts[:2]:
        equal(attempt.linearised, (attempt.before, *truth(attempt.before)), ROUNDING)
        equal(attempt.guess, truth(attempt.before), ROUNDING)
        agree(attempt.referred is None)
    for attempt in problem.attempts[2:]:
        agree(attempt.linearised is None)
        equal(attempt.guess, truth(attempt.load), 1e-9)
        agree(attempt.referred == (attempt.load, *truth(attempt.before)), attempt)
    if growth > 1.0:
        agree(not all(attempt.converged for attempt in problem.attempts), problem.attempts)


def test_inadmissible_prediction_gives_way_to_the_tangent(create_fake_problem):
    """After an inadmissible prediction, the solve begins with the last tangent."""
    problem = create_fake_problem(
        inside_out=lambda load: load > 0.5, fails=lambda before, load: load == 0.8
    )
    steps = problem.follow([1.0], Steps(first=0.2, least=0.01, growth=1.0))
    agree([step.failures for step in steps] == [0, 0, 0, 1, 0, 0, 0], steps)
    for step in (attempt for attempt in problem.attempts if attempt.load > 0.5):
        if step.linearised is not None:
            agree(step.linearised[0] == step.before)
            equal(step.linearised[1:], truth(step.before), ROUNDING)
    agree(sum(attempt.linearised is not None for attempt in problem.attempts) >= 6)


@pytest.mark.parametrize("rough", [None, 1e-2, OWN / 100])
def test_rough_on_the_way_and_exact_at_the_targets(create_fake_problem, rough):
    """Steps between targets use the looser of their own tolerances and the solver's."""
    problem = create_fake_problem(fails=lambda before, load: load == 0.5 and load - before > 0.15)
    solvers = (problem.solver, problem.solver.getKSP())
    before = [solver.getTolerances() for solver in solvers]
    steps = Steps(first=0.2, least=0.01, growth=1.0, rtol=rough, linear_rtol=rough and rough / 10)
    problem.follow([0.5, 1.0], steps)
    agree([solver.getTolerances() for solver in solvers] == before)
    agree(not all(attempt.converged for attempt in problem.attempts))
    for attempt in problem.attempts:
        rougher = 0.0 if attempt.load in (0.5, 1.0) else rough or 0.0
        small(attempt.rtol - max(rougher, OWN), 0.0)
        small(attempt.linear_rtol - max(rougher / 10, OWN), 0.0)


def test_on_step_is_called_in_each_equilibrium_on_all_processes(create_fake_problem):
    """``on_step`` is called on all processes, in the state of each load step."""
    problem = create_fake_problem(
        cost=lambda increment: 2, fails=lambda before, load: load - before > 0.25
    )
    seen: list[LoadStep] = []

    def look(step: LoadStep) -> None:
        equal(problem.state(), truth(step.load), ROUNDING)
        agree(problem.load == step.load and step.history == (STEP, STEP))
        seen.append(step)

    steps = problem.follow([1.0], Steps(first=0.4, least=0.1), on_step=look)
    agree(seen == steps and COMM.bcast([s.load for s in seen]) == [s.load for s in seen])
    agree(sum(step.failures for step in steps) > 0 and all(step.seconds >= 0 for step in steps))


@pytest.mark.parametrize(
    ("start", "targets", "match"),
    [
        (0.0, [1.0, 0.5], r"targets=.*: the load turns back.* unloading=True"),
        (0.0, [0.5, 0.7, -1.0], "the load turns back"),
        (0.0, [-1.0, 0.0], "the load turns back"),
        (0.0, [1.0, math.nan], r"targets=\[1.0, nan\]: loads are finite numbers"),
        (0.0, [1.0, math.inf], r"targets=\[1.0, inf\]: loads are finite numbers"),
        (math.nan, [1.0], "start=nan"),
        (-math.inf, [1.0], "start=-inf"),
    ],
)
def test_bad_loads(create_fake_problem, start, targets, match):
    """Bad loads, even on one process only, raise on all before the first load step."""
    problem = create_fake_problem()
    if not LAST:
        start = 0.0
        targets = [1.0]
    with raises(ValueError, match):
        follow_load(problem, lambda _: None, targets, Steps(first=0.5, least=0.5), start=start)
    agree(not problem.attempts)


@pytest.mark.parametrize("where", ["set_load", "on_step"])
def test_call_that_fails_on_one_process(create_fake_problem, where):
    """A callback's error on one process raises on all, in the last equilibrium."""
    problem = create_fake_problem()

    def call(name: str, load: float) -> None:
        if name == "set_load":
            problem.load = load
        if LAST and name == where and load > 0.3:
            raise ZeroDivisionError("not this load")

    with raises(ZeroDivisionError, "not this load"):
        follow_load(
            problem,
            lambda load: call("set_load", load),
            [1.0],
            Steps(first=0.2, least=0.1),
            state=[problem.u, problem.p],
            on_step=lambda step: call("on_step", step.load),
        )
    last = problem.attempts[-1].load
    agree(len(problem.attempts) == {"set_load": 1, "on_step": 2}[where])
    agree(problem.load == last and problem.solver.getTolerances()[0] == OWN)
    equal(problem.state(), truth(last), ROUNDING)


def test_wall_up_and_down():
    """A wall solved at once, in steps and after unloading has the same solution."""
    tight = {"snes_rtol": 1e-11}
    direct, stepped = (wall(tube(around=6, along=2), degree=1) for _ in range(2))
    direct.inflate(direct.problem(4, tight), [4.0])
    problem = stepped.problem(4, tight)
    for start, targets in ((0.0, [4.0]), (4.0, [7.0, 4.0])):
        record = follow_load(
            problem,
            lambda pressure: setattr(stepped.load, "value", loads.mmhg(pressure)),
            targets,
            Steps(first=1.0, least=0.25),
            start=start,
            unloading=True,
        )
        agree(record[-1].load == 4.0 and not any(step.failures for step in record))
        equal(by_place(stepped.u), by_place(direct.u), 1e-8)
        equal(by_place(stepped.p), by_place(direct.p), 1e-7)
        small(max(s.linear_residual / s.linear_rtol for r in record for s in r.history), 1.0)
