# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Step lengths of the line search on problems with one unknown."""

from __future__ import annotations

from types import SimpleNamespace

from mpi4py import MPI

import numpy as np
import pytest
from cases import each

from dolfinx_feti.problems.equations.state import StateValues
from dolfinx_feti.problems.equations.system import Residual
from dolfinx_feti.problems.iteration import line_search
from dolfinx_feti.problems.iteration.iterate import Direction, Iterate
from dolfinx_feti.problems.iteration.line import Line, Trial
from dolfinx_feti.problems.iteration.line_search import LONGEST, find_step_length
from dolfinx_feti.problems.iteration.step_test import StepTest

pytestmark = pytest.mark.serial


def unchanged(r):
    """Return the residual itself, as no dof is fixed."""
    return r


class OneUnknown:
    """A System with r(u) and perhaps Π(u), whose cells are inverted if ``inverted(u)``."""

    def __init__(self, r, potential=None, inverted=lambda u: False, moves=False):
        self.u = 0.0
        self.visited = []
        self.moves = moves
        self._r = r
        self.comm = MPI.COMM_SELF
        self.has_potential = potential is not None
        self.scalars = SimpleNamespace(size=0)
        self.state = SimpleNamespace(values=self._values, set=self._set)
        self.conditions = SimpleNamespace(free=unchanged)
        self.tangent = SimpleNamespace(multiply=np.zeros_like)
        self._potential = potential
        self._inverted = inverted

    def potential(self):
        return self._potential(self.u)

    def smallest_volume_ratio(self):
        return -1.0 if self._inverted(self.u) else 1.0

    def increment(self, _residual, du, _ds):
        return StateValues(du, np.zeros(0), np.zeros(0))

    def _values(self):
        return StateValues(np.array([self.u]), np.zeros(0), np.zeros(0))

    def _set(self, values):
        self.u = float(values.u[0])
        self.visited.append(self.u)

    def residual(self):
        r = np.array([self._r(self.u)])
        return Residual(r, r, np.zeros(1), None)

    def iterate(self):
        residual = self.residual()
        return Iterate(residual, abs(residual.force[0]), 0.0, violates_constraints=self.moves)


def line_of(system: OneUnknown, *, shifted: bool = False) -> Line:
    """Return the line along ΔU = 1."""
    direction = Direction(
        np.ones(1), np.zeros(0), float(shifted), (1,), None, is_descent=system.has_potential
    )
    return Line(system, system.iterate(), direction)


def step_along(system: OneUnknown, line: Line) -> Trial:
    """Return the trial that the line search accepts."""
    return find_step_length(line, StepTest(system, line))


def search(system: OneUnknown, *, shifted: bool = False) -> float:
    """Search along ΔU = 1; return α, and assert that state and trial are those at α."""
    trial = step_along(system, line_of(system, shifted=shifted))
    assert system.u == trial.alpha
    assert trial.residual.condensed[0] == system._r(system.u)
    if not np.isnan(trial.potential):
        assert trial.potential == system.potential()
    return trial.alpha


def valley(pit):
    """Return r(u) of opposite signs on the two sides of a pit, and its potential."""
    return {
        "r": lambda u: -1.0 if u < pit else 1.0,
        "potential": lambda u: -min(u, pit) + max(u - pit, 0.0) / 4,
    }


SINGLE = {"r": lambda u: u - 1.0}
#: −g(α)/g(0) is 3 at the whole step, 0.7 at the zero of its secant, 1/4, and −0.1 at half of that.
OVERSHOOTING = {"r": lambda u: float(np.interp(u, [0.0, 0.125, 0.25, 1.0], [-1.0, -0.1, 0.7, 3.0]))}
WEAK = {"r": lambda u: -1.0}
CASES = {
    "whole, to the zero": (SINGLE, False, 1.0),
    "whole, g(1)/g(0) = −0.7": ({"r": lambda u: 1.7 * u - 1.0}, False, 1.0),
    "whole, g(1)/g(0) = 1": (WEAK, False, 1.0),
    "zero of the secant": ({"r": lambda u: 4.0 * u - 1.0}, False, 0.25),
    "halved until no cell is inside out": ({**SINGLE, "inverted": lambda u: u > 0.2}, False, 0.125),
    "shorter still after an overshoot": (OVERSHOOTING, False, 0.125),
    "no admissible step": ({**SINGLE, "inverted": lambda u: u > 0.0}, False, 0.0),
    "NaN": ({"r": lambda u: np.nan if u > 0.3 else u - 1.0}, False, 0.25),
    "Π has to fall": ({**WEAK, "potential": lambda u: (u - 0.2) ** 2}, False, 0.25),
    "no say while it moves": ({**SINGLE, "potential": lambda u: u, "moves": True}, False, 1.0),
    "no say in rounding": ({**SINGLE, "potential": lambda u: 1e12 + u}, False, 1.0),
    "shifted: doubled down to the pit": (valley(5.0), True, 8.0),
    "shifted: doubled up to a bound": (valley(100.0), True, LONGEST),
    "shifted: whole": (valley(0.6), True, 1.0),
    "plain: not doubled": (valley(5.0), False, 1.0),
    "plain: before the pit": (valley(0.6), False, 0.5),
}


@each(("system", "shifted", "alpha"), CASES)
def test_step_length(system, shifted, alpha):
    """The step length of each case is the one worked out by hand."""
    assert search(OneUnknown(**system), shifted=shifted) == alpha


def test_only_trials_that_are_needed():
    """The line search evaluates no trial beyond those that decide the step length."""
    for system, visited in ((SINGLE, [1.0]), (CASES["NaN"][0], [1.0, 0.5, 0.25])):
        one = OneUnknown(**system)
        search(one)
        assert one.visited == visited


@pytest.mark.parametrize("energy", [False, True])
@pytest.mark.parametrize("jump", [1.0, 20.0, 1e6])
@pytest.mark.parametrize("kink", [0.9, 0.06, 1e-5])
def test_a_step_ends_close_to_a_kink(kink, jump, energy):
    """A step ends just before a kink of the energy, where g(α)/g(0) jumps from 1 to −jump."""

    def potential(u):
        return -u if u < kink else jump * (u - kink) - kink

    system = OneUnknown(lambda u: -1.0 if u < kink else jump, potential if energy else None)
    assert kink / 1.3 <= search(system) <= kink and len(system.visited) < 40


class Tenth:
    """A user's line search that takes α = 1/10 in each step."""

    def serves(self, line):
        return True

    def search(self, line, test):
        return line.move(0.1)


def test_a_further_search_is_a_class_and_an_entry(monkeypatch):
    """A line search added to ``SPECIAL_SEARCHES`` precedes the default one."""
    monkeypatch.setattr(line_search, "SPECIAL_SEARCHES", (*line_search.SPECIAL_SEARCHES, Tenth()))
    assert search(OneUnknown(**SINGLE)) == 0.1


def test_contact_takes_whole_steps_and_shortens_those_that_invert_a_cell():
    """With contact a whole step may overshoot, g(1)/g(0) = −3, but must not invert a cell."""
    for inverted, alpha in ((lambda u: False, 1.0), (lambda u: u > 0.6, 0.25)):
        system = OneUnknown(lambda u: 4.0 * u - 1.0, inverted=inverted)
        line = line_of(system)
        line.allows_overshoot = True
        trial = step_along(system, line)
        assert isinstance(trial, Trial) and trial.alpha == alpha
        assert system.visited[0] == 1.0 and system.visited.count(1.0) == 1
