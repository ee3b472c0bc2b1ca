# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Load steps: the prediction, the tolerances, and what the caller sees."""

from __future__ import annotations

import math

import numpy as np
import pytest
from collective import COMM, agree, equal, raises, small
from played import OWN, ROUNDING, STEP, truth

from dolfinx_feti import ConvergenceError
from dolfinx_feti.loading.load_steps import follow_load
from dolfinx_feti.loading.steps import LoadStep, Steps


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
    steps, last = Steps(first=1.0, least=1.0), COMM.rank == COMM.size - 1
    with raises(ValueError, r"targets=\[1.0, (nan|inf)\]: loads are finite numbers"):
        problem.follow([1.0, bad if last else 2.0], steps)
    with raises(ValueError, "start=(nan|inf)"):
        follow_load(problem, lambda _: None, [1.0], steps, start=bad if last else 0.0)
    agree(not problem.attempts)
