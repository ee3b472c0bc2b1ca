# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Loads and times that differ by rounding are one place, with no step between them."""

from __future__ import annotations

import numpy as np
import pytest
from collective import COMM, agree, equal, raises
from fake_problem import ROUNDING, truth

from dolfinx_feti.loading import Checkpoint, Steps
from dolfinx_feti.loading.places import PlaceTolerance, check_places

STEPS = Steps(first=0.1, least=1e-3, growth=1.0)

#: Ten thousand steps of 0.1, added one by one: 1.6e-10 off 1000.
SUM = float(np.cumsum(np.full(10_000, 0.1))[-1])


@pytest.mark.parametrize(
    ("a", "b", "largest", "least", "expected"),
    [
        pytest.param(0.3, 3 * 0.1, 1.0, 1e-3, True, id="product"),
        pytest.param(1000.0, SUM, 1000.0, 1e-3, True, id="sum-of-10000"),
        pytest.param(0.0, 3 * 0.1 - 0.3, 0.3, 1e-3, True, id="difference"),
        pytest.param(-0.3, -3 * 0.1, 1.0, 1e-3, True, id="negative"),
        pytest.param(3e8, 3e9 * 0.1, 1e9, 1e6, True, id="large-unit"),
        pytest.param(0.3, 3 * 0.1, 1.0, 1e-12, True, id="small-least"),
        pytest.param(0.9, 0.9 + 1e-9, 1.0, 1e-2, False, id="honest"),
        pytest.param(0.0, 1e-8, 1e6, 1e-3, False, id="decades"),
        pytest.param(1e6, 1e6 + 1e-7, 1e6, 1e-9, False, id="longer-than-least"),
        pytest.param(0.3, -0.3, 1.0, 1.0, False, id="sign"),
    ],
)
def test_places_are_equal_up_to_rounding(a, b, largest, least, expected):
    """Two places are equal if their distance is rounding, and far below the least step."""
    tolerance = PlaceTolerance(largest, least)
    assert tolerance.are_equal(a, b) == expected, f"{a} and {b} differ by {abs(a - b)}"
    assert tolerance.are_equal(b, a) == expected, f"{b} and {a} differ by {abs(a - b)}"


def test_targets_that_turn_back_by_rounding_are_merged():
    """Targets that turn back by rounding are merged, and by more are refused."""
    tolerance = PlaceTolerance(0.6, 1e-3)
    assert tolerance.without_repeats(0.0, [3 * 0.1, 0.3, 0.6]) == [3 * 0.1, 0.6]
    assert tolerance.without_repeats(3 * 0.1, [0.3, 0.6]) == [0.6]
    check_places(0.0, [3 * 0.1, 0.3, 0.6], 1e-3, unloading=False)
    check_places(3 * 0.1, [0.3, 0.6], 1e-3, unloading=False)
    with raises(ValueError, "the load turns back"):
        check_places(0.0, [0.3 + 1e-9, 0.3], 1e-3, unloading=False)


@pytest.mark.parametrize(
    ("targets", "unloading"),
    [
        pytest.param([0.3, 3 * 0.1, 0.6, 6 * 0.1, 0.7, 7 * 0.1, 1.0], False, id="up"),
        pytest.param([3 * 0.1, 0.3, 1.0], False, id="first-is-larger"),
        pytest.param([0.3, 3 * 0.1, 0.1, 0.3, 3 * 0.1], True, id="up-and-down"),
    ],
)
def test_path_takes_no_step_between_equal_targets(create_fake_problem, targets, unloading):
    """A path meets all targets in order, and takes no step between equal ones."""
    problem = create_fake_problem()
    steps = problem.follow(targets, STEPS, unloading=unloading)
    shortest = min(abs(step.increment) for step in steps)
    agree(shortest > 0.05, f"the shortest step is {shortest}")
    places = iter([step.load for step in steps])
    last = None
    for target in targets:
        if last is not None and abs(target - last) < 1e-15:
            continue
        agree(any(abs(place - target) < 1e-15 for place in places), f"{target} is not met in order")
        last = target
    equal(problem.state(), truth(targets[-1]), ROUNDING)


def test_path_that_begins_at_its_only_target_takes_no_step(create_fake_problem):
    """A path that begins at its only target, up to rounding, takes no step."""
    problem = create_fake_problem(start=0.1 + 0.2)
    agree(problem.follow([0.3], STEPS) == [] and not problem.attempts, problem.attempts)


def test_target_reached_before_a_restart_is_not_solved_again(create_fake_problem, tmp_path):
    """After a restart, a target that equals the reached load up to rounding is not solved again.

    The first run makes three steps of 0.1. The second one returns all six, and solves the last
    three.
    """
    earlier = create_fake_problem()
    earlier.follow([0.3], STEPS, checkpoint=Checkpoint(tmp_path, COMM))
    restarted = create_fake_problem()
    steps = restarted.follow(
        [3 * 0.1, 0.6], STEPS, checkpoint=Checkpoint(tmp_path, COMM, restart=True)
    )
    equal([step.load for step in steps], np.arange(1, 7) / 10, ROUNDING)
    solved = [attempt.load for attempt in restarted.attempts]
    equal(solved, [0.4, 0.5, 0.6], ROUNDING)
