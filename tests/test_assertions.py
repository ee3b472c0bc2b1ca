# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A failing assertion shows on all processes what was compared, and the values."""

from __future__ import annotations

import re

import numpy as np
import pytest
from collective import COMM, agree, equal, raises, small, uniform


class Record:
    """An object whose attribute is compared."""

    exact = 3


report = Record()
GROWING = np.arange(5.0) ** 2


def failure(check: object) -> str:
    """Return the message of a check that fails on all processes."""
    assert callable(check)
    with pytest.raises(AssertionError) as caught:
        check()
    message = str(caught.value)
    assert len(set(COMM.allgather(message))) == 1, "processes have different messages"
    return message


CONDITIONS = {
    "comparison": (lambda: agree(report.exact == 2), ["report.exact == 2", "report.exact = 3"]),
    "both-sides": (
        lambda: agree(len([1, 2, *range(3)]) < report.exact),
        ["len([1, 2, *range(3)]) = 5", "report.exact = 3"],
    ),
    "equivalence": (
        lambda: agree((report.exact > 2) == (COMM.size == 0)),
        ["report.exact > 2 = True", "report.exact = 3", "COMM.size == 0 = False", "COMM.size = "],
    ),
    "chain": (lambda: agree(0 < report.exact <= 2), ["report.exact = 3"]),
    "and": (lambda: agree(COMM.size > 0 and report.exact == 2), ["report.exact = 3"]),
    "or": (lambda: agree(COMM.size < 1 or report.exact == 2), ["COMM.size = ", "report.exact = 3"]),
    "not": (lambda: agree(not report.exact), ["report.exact = 3"]),
    "in": (lambda: agree("word" in str(report.exact)), ["str(report.exact) = '3'"]),
    "call": (lambda: agree(str(report.exact).startswith("2")), ["str(report.exact) = '3'"]),
    "all": (lambda: agree(all(k < report.exact for k in range(9))), ["k = 3", "report.exact = 3"]),
    "np.all": (
        lambda: agree(np.all(GROWING < 3.0 * report.exact)),
        ["False for 2 of 5 entries, the first of which is [3]", "(GROWING)[3] = 9.0", "= 9.0"],
    ),
    "method-all": (
        lambda: agree((GROWING > 1.0).all()),
        ["False for 2 of 5", "(GROWING)[0] = 0.0"],
    ),
    "not-any": (lambda: agree(not GROWING.any()), ["GROWING = array([ 0.,  1.,  4.,  9., 16.])"]),
    "not-any-comparison": (
        lambda: agree(not np.any(GROWING == 9.0)),
        ["True for 1 of 5 entries, the first of which is [3]", "(GROWING)[3] = 9.0"],
    ),
    "branch": (
        lambda: agree(report.exact == 2 if COMM.size > 0 else False),
        ["COMM.size > 0 = True", "report.exact = 3"],
    ),
    "list-of-a-call": (lambda: agree(not sorted([3, report.exact])), ["= [3, 3]"]),
    "value": (lambda: agree(report.exact - 3), ["report.exact - 3 = 0"]),
    "context": (lambda: agree(report.exact == 2, "after two steps"), ["after two steps"]),
    "small": (lambda: small(-2.5 * report.exact, 1e-3), ["|-2.5 * report.exact| = 7.5 > 0.001"]),
    "small-nan": (lambda: small(float("nan"), 1e-3), ["|float('nan')| = nan > 0.001"]),
    "equal": (
        lambda: equal([[1.0, 2.0], [4.0, 8.0]], [[1.0, 2.0], [3.0, 8.0]], 1e-2),
        [
            "[[1.0, 2.0], [4.0, 8.0]] and [[1.0,",
            "differ by 1.0 > 0.08",
            "entry [1, 0]: 4.0 instead of 3.0",
        ],
    ),
    "equal-nan": (lambda: equal([1.0, np.nan], [1.0, 2.0]), ["entry [1]: nan instead of 2.0"]),
    "shapes": (lambda: equal(np.ones(2), np.ones(3)), ["shapes (2,) and (3,)"]),
    "uniform": (lambda: uniform([1.0, 4.0], 1.0, 0.5), ["3.0 > 0.5", "4.0 instead of 1.0"]),
}


@pytest.mark.parametrize("name", CONDITIONS)
def test_failure_shows_the_condition_and_its_operands(name):
    """The condition is that of the source, and each operand has its value."""
    check, expected = CONDITIONS[name]
    message = failure(check)
    missing = [part for part in expected if part not in message]
    assert not missing, message


@pytest.mark.parametrize(
    "context",
    [np.arange(3.0), np.zeros(0), [1.5], "1.5"],
    ids=["array", "empty-array", "list", "text"],
)
def test_failure_shows_a_context_of_any_type(context):
    """An array, too, although its comparison with a text has no truth value."""
    with pytest.raises(AssertionError) as caught:
        agree(False, context)
    assert str(context) in str(caught.value)


def test_failure_names_the_processes_where_the_condition_fails():
    """Processes where it holds fail with the same message."""
    last = COMM.size - 1
    message = failure(lambda: agree(last > COMM.rank))
    assert re.findall(r"rank (\d+): ", message) == [str(last)], message
    assert f"COMM.rank = {last}" in message


def test_operands_may_be_collective():
    """They are evaluated again on all processes, in the same order."""
    message = failure(lambda: agree(COMM.allreduce(COMM.rank) == -1 and COMM.rank >= 0))
    assert message.count(f"COMM.allreduce(COMM.rank) = {sum(range(COMM.size))}") == COMM.size


def test_operands_that_cannot_be_evaluated_again_show_the_error():
    """A second evaluation may fail, as that of ``values.pop()``."""
    values = [report.exact]
    assert "<raised IndexError" in failure(lambda: agree(values.pop() == 2))


def test_operands_may_have_local_names_of_the_caller():
    """So may the variables of a generator in the condition."""
    bound = 2
    assert "bound = 2" in failure(lambda: agree(report.exact <= bound))
    rows = np.arange(6).reshape(2, 3)
    message = failure(lambda: agree(all(row.sum() < bound * k for k, row in enumerate(rows))))
    assert "k = 0" in message and "row.sum() = 3" in message, message


def test_failed_any_shows_its_names():
    """No element is the cause, so that the values of all names are shown."""
    message = "the residual stagnates"
    text = failure(lambda: agree(any(word in message for word in ("scale", "rounding"))))
    assert "message = 'the residual stagnates'" in text, text


CHECKS_IN_LOOPS = {
    "agree": lambda load: agree(load < 2.0),
    "small": lambda load: small(load, 1.0),
    "equal": lambda load: equal([load], [1.0]),
    "uniform": lambda load: uniform([load], 1.0, 0.0),
}


@pytest.mark.parametrize("name", CHECKS_IN_LOOPS)
def test_failure_in_a_loop_shows_which_case_fails(name):
    """Variables of all loops around a check are shown, those of the functions that call it too."""

    def check_loads(unit: str) -> None:
        for _step, load in enumerate((1.0, 2.0)):
            CHECKS_IN_LOOPS[name](load)

    def check_units() -> None:
        for unit in ("kPa", "mmHg"):
            check_loads(unit)

    message = failure(check_units)
    for line in ("_step = 1", "load = 2.0", "unit = 'kPa'"):
        assert message.splitlines().count(f"    {line}") == COMM.size, message


def test_variables_of_loops_that_have_ended_are_not_shown():
    """A variable keeps its last value after a loop, which has nothing to do with the failure."""

    def check() -> None:
        for step in range(3):
            agree(step < 3)
        small(2.0, 1.0)

    assert "step" not in failure(check)


def test_long_values_are_shortened():
    """A failure stays readable; the context is printed in full."""
    text = "x" * 10_000
    assert len(failure(lambda: agree(text == ""))) < 1000 * COMM.size


def test_raises_reports_another_error():
    """The failure has the error that was raised and the one that was expected."""

    def check() -> None:
        with raises(ValueError, "too thin"):
            raise KeyError("too thick")

    message = failure(check)
    assert "KeyError('too thick')" in message and "ValueError" in message, message


def test_checks_that_hold_evaluate_nothing_twice():
    """Operands may have side effects."""
    values = [2]
    agree(values.pop() == 2)
    small(0.5, 0.5)
    equal([1.0, 2.0], [1.0, 2.0])
    uniform([1.0, 1.25], 1.0, 0.25)
    assert values == []
