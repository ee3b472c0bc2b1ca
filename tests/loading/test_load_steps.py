# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The loads on the way: targets, increments, and what follows a failure."""

from __future__ import annotations

import itertools
import math
import re

import numpy as np
import pytest
from collective import agree, equal, raises
from played import ROUNDING, truth

from dolfinx_feti import ConvergenceError
from dolfinx_feti.loading.steps import LoadStep, Steps


def increments(steps: list[LoadStep]) -> np.ndarray:
    return np.abs([step.increment for step in steps])


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


@pytest.mark.parametrize("cost", [3, 4])
def test_increments_grow_after_quick_steps(played, cost):
    """And keep their length after slow ones."""
    problem = played(cost=lambda increment: cost)
    steps = problem.follow([100.0], Steps(first=1.0, least=1.0, growth=2.0, quick=3))
    found = increments(steps)
    agree(found[0] == 1.0)
    agree(np.all(found[1:] <= 2 * found[:-1] * (1 + ROUNDING)), found)
    agree(len(found) == (7 if cost == 3 else 100), found)  # 1 + 2 + 4 + … > 100 with seven terms


@pytest.mark.parametrize("cost", [1, 9])
def test_increments_keep_their_length_over_a_target(played, cost):
    """A short step to a target nearby, quick or slow, does not make the next ones short."""
    problem = played(cost=lambda increment: cost)
    steps = problem.follow([1.0, 1.01, 2.01], Steps(first=0.5, least=0.1, growth=1.0, quick=3))
    equal(increments(steps), [0.5, 0.5, 0.01, 0.5, 0.5], 1e-9)


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


def test_preconditioner_serves_from_load_to_load(played):
    """It begins anew on a new path, and after a failure."""
    problem = played(fails=lambda before, load: load > 0.5 and load - before > 0.1)
    problem.follow([1.0], Steps(first=0.2, least=0.01))
    follows_failure = [False, *(not attempt.converged for attempt in problem.attempts[:-1])]
    expected = [i == 0 or after for i, after in enumerate(follows_failure)]
    agree([attempt.renewed for attempt in problem.attempts] == expected and sum(expected) > 1)
    agree(any(not attempt.renewed for attempt in problem.attempts))


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


@pytest.mark.parametrize(
    ("said", "match"),
    [
        ("The tangent is indefinite.", "limit point .* Prescribe a displacement or a volume"),
        ("It fails: the linear solver: add conditions.", "add conditions.$"),
    ],
)
def test_remedy_fits_the_failure(played, said, match):
    """At a limit point no increment helps, and an unsupported body has its advice already."""

    def fails(before: float, load: float) -> bool:
        if load > 0.5:
            problem.u.x.array[:] = math.nan
            raise ConvergenceError(said)
        return False

    problem = played(fails=fails)
    with raises(ConvergenceError, match):
        problem.follow([1.0], Steps(first=0.25, least=0.1))
