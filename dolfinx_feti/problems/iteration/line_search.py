# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Searches for the step length α along a Newton direction ΔU (docs/theory.md).

α is one unless the trial state has a cell inside out or a NaN, or is not accepted (``step_test``).
PETSc's own searches ``cp`` and ``bt`` are not used: they do not check det F, they add the lengths
u − g of Dirichlet dofs to forces, and they do not evaluate Π.

A further line search is a class in this file with the two methods of :class:`LineSearch`, and an
entry in ``SPECIAL_SEARCHES``. It moves the state along a :class:`Line` by any criterion. It may
accept trials by ``step_test``, or ignore that and set ``Trial.is_accepted`` itself. If its first
trial is not accepted, it can pass that trial to :func:`shortened`. It must not end in a trial whose
ratio is NaN.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from dolfinx_feti.problems.iteration.line import Line, Trial
from dolfinx_feti.problems.iteration.step_test import OVERSHOOT, StepTest

#: Shortest α that is tried after a trial with a cell inside out or a NaN: ten halvings. The search
#: then fails, and a path halves its load step.
SHORTEST = 1.0 / 1024

#: Longest α of a shifted step: four doublings. The next step begins with σ/16 (``shifts``). If σ
#: dominates the matrix, that lengthens the next step by the same factor.
LONGEST = 16.0

#: Largest number of trials of a step that overshoots: a first tangent can be too soft by many
#: orders of magnitude, and each trial shortens at most tenfold. A bound, not measured.
MAX_TRIALS = 40

#: After a step that overshoots, a trial with g(α)/g_0 below minus this value is still too long. The
#: secant from there costs one trial. It is a choice, not measured.
MAX_REVERSAL = 0.25

#: A shifted step, or a trial after one that has overshot, is too short with g(α)/g_0 above this
#: value (Wolfe's usual 0.9).
TOO_SHORT = 0.9

#: After a step that overshoots, the search ends once α is known within this factor: g jumps there,
#: as in total variation. A closer α is not worth a trial; it is a choice, not measured.
BRACKET_RATIO = 1.3

#: Largest position of a trial in the bracket, from its short end, as a share: bisection.
LONGEST_CUT = 0.5

#: Smallest position of a trial in the bracket, as a share: a kink of g may mislead the secant.
SHORTEST_CUT = 0.1


class LineSearch(Protocol):
    """A rule for the step length. All methods are collective."""

    def serves(self, line: Line) -> bool:
        """Return True if this search is meant for such an iterate and direction."""

    def search(self, line: Line, test: StepTest) -> Trial:
        """Find a step length.

        Args:
            line: The states along the direction; the state is at α = 0.
            test: The package's acceptance of trials.

        Returns:
            The trial where the state is: the last one of ``line.move``, passed through
            ``test.judge`` or not; that of ``line.stay`` if no step length is admissible. A step
            with α > 0 is taken even if its trial is not accepted. It then counts as an overshoot,
            if the body is in contact (``overshoots``). A trial whose ratio is NaN must not be
            returned: if a cell is inside out, its residual is not that of its state.
        """


class Shortening:
    """The whole step, shortened by bisection and secants until it is accepted."""

    def serves(self, line: Line) -> bool:
        """Return True: it serves all directions."""
        return True

    def search(self, line: Line, test: StepTest) -> Trial:
        """Shorten the whole step until it is accepted."""
        return shortened(line, test, test.judge(line.move(1.0)))


class WholeStep:
    """The whole step for a body in contact, wherever it ends, if the forces there are finite."""

    def serves(self, line: Line) -> bool:
        """Return True if the step may overshoot."""
        return line.allows_overshoot

    def search(self, line: Line, test: StepTest) -> Trial:
        """Move by ΔU; shorten the step only if a cell is inside out or a force is not finite."""
        trial = test.judge(line.move(1.0))
        if np.isfinite(trial.ratio):
            return trial
        return shortened(line, test, trial)


class Lengthening:
    """A step that a shift may have made too short: doubled while g has hardly changed."""

    def serves(self, line: Line) -> bool:
        """Return True if the direction has a shift."""
        return line.direction.is_shifted

    def search(self, line: Line, test: StepTest) -> Trial:
        """Shorten the step until it is accepted, or lengthen an accepted whole step."""
        trial = shortened(line, test, test.judge(line.move(1.0)))
        while trial.ratio > TOO_SHORT and 1.0 <= trial.alpha < LONGEST:
            longer = test.judge(line.move(2.0 * trial.alpha))
            if not longer.is_accepted:
                return test.judge(line.move(trial.alpha))
            trial = longer
        return trial


#: Searches for special steps, in the order of their precedence: the first one that serves a step
#: finds its length.
SPECIAL_SEARCHES: tuple[LineSearch, ...] = (WholeStep(), Lengthening())

#: The search for all other steps.
DEFAULT_SEARCH: LineSearch = Shortening()


def find_step_length(line: Line, test: StepTest) -> Trial:
    """Return the trial where a step ends, with the state moved there. Collective.

    The first special search that serves the line finds it, or else the default one.

    Args:
        line: The states along the direction; the state is at α = 0.
        test: The package's acceptance of trials.

    Returns:
        A trial with α = 0 if no step length is admissible.
    """
    for search in SPECIAL_SEARCHES:
        if search.serves(line):
            return search.search(line, test)
    return DEFAULT_SEARCH.search(line, test)


def shortened(line: Line, test: StepTest, trial: Trial) -> Trial:
    """Shorten a step until it is accepted. Collective.

    A step that has overshot is shortened further, until it ends close to the zero of g.

    Args:
        line: The line.
        test: The acceptance of trials.
        trial: Its first trial, where the state is.

    Returns:
        The accepted trial; one with α = 0 if there is none.
    """
    short = line.start
    long = trial
    has_overshot = False
    for count in range(1, MAX_TRIALS + 1):
        is_close_to_zero = -MAX_REVERSAL <= trial.ratio <= TOO_SHORT
        if trial.is_accepted and (is_close_to_zero or not has_overshot):
            return trial
        has_overshot |= trial.ratio < -OVERSHOOT
        if trial.is_accepted and trial.ratio > 0.0:
            short = trial
        else:
            long = trial
        if long.alpha <= BRACKET_RATIO * short.alpha:  # g jumps between the two
            if short is trial:
                return trial
            return test.judge(line.move(short.alpha))
        alpha = _next_alpha(short, long)
        is_too_short = alpha < SHORTEST and np.isnan(trial.ratio)
        if count == MAX_TRIALS or is_too_short:
            break
        trial = test.judge(line.move(alpha))
    return line.stay()


def _next_alpha(short: Trial, long: Trial) -> float:
    """Return the next α: the zero of the secant of g, but within the lower half of the bracket."""
    cut = LONGEST_CUT
    if long.ratio < 0.0 < short.ratio:
        cut = short.ratio / (short.ratio - long.ratio)
    cut = min(max(cut, SHORTEST_CUT), LONGEST_CUT)
    return short.alpha + cut * (long.alpha - short.alpha)
