# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Searches for the step length α along a Newton direction ΔU (docs/theory.md).

α is one unless the trial state turns a cell inside out, has a NaN, or is not accepted
(``step_test``). SNES's ``cp`` and ``bt`` do not watch det F, add lengths u − g to forces, and know
no Π.

A further line search is a class in this file, with the two methods of :class:`LineSearch`, and an
entry in ``SPECIAL_SEARCHES``. It chooses among the states of a :class:`Line` by any criterion: the
acceptance of ``step_test`` is an argument that it may ignore, and :func:`shortened` serves any
search whose whole step leaves det F > 0.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from dolfinx_feti.problems.iteration.line import Line, Trial
from dolfinx_feti.problems.iteration.step_test import OVERSHOOT, StepTest

#: Shortest α that is tried where shorter ones may leave det F > 0: ten halvings. A path halves its
#: load step at that length.
SHORTEST = 1.0 / 1024

#: Longest α of a shifted step, after four doublings. The next step begins with σ/16 (``shifts``),
#: which lengthens a step that σ dominates by as much.
LONGEST = 16.0

#: Largest number of trials of a step that overshoots: a first tangent can be too soft by many
#: orders, and each trial shortens at most tenfold. A bound, not measured.
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

#: Largest share of the bracket that a trial leaves: bisection.
LONGEST_CUT = 0.5

#: Smallest share of the bracket that a trial leaves: a secant may be misled by a kink of g.
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
            The trial where the state is: the last one of ``line.move``, perhaps through
            ``test.judge``, or that of ``line.stay`` if no step length is admissible. A trial that
            is not accepted counts as an overshoot of a body in contact (``overshoots``).
        """


class Shortening:
    """The longest accepted step of at most one, by bisection and secants."""

    def serves(self, line: Line) -> bool:
        """Return True: it serves all directions."""
        return True

    def search(self, line: Line, test: StepTest) -> Trial:
        """Shorten the whole step until it is accepted."""
        return shortened(line, test, test.judge(line.move(1.0)))


class WholeStep:
    """The whole step for a body in contact, wherever it ends, if its forces are finite."""

    def serves(self, line: Line) -> bool:
        """Return True if the step may overshoot."""
        return line.allows_overshoot

    def search(self, line: Line, test: StepTest) -> Trial:
        """Move by ΔU; shorten a step that leaves det F > 0."""
        trial = test.judge(line.move(1.0))
        if np.isfinite(trial.ratio):
            return trial
        return shortened(line, test, trial)


class Lengthening:
    """A step that a shift may have made too short: doubled while Π falls steeply."""

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
    """Shorten a step until it is accepted; once it has overshot, up to the zero of g. Collective.

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
