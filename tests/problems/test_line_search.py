# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The line search along one unknown."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from dolfinx_feti.problems.line_search import LONGEST, line_search
from dolfinx_feti.problems.system import Residual

pytestmark = pytest.mark.serial


class OneUnknown:
    """A system with r(u) and, if given, Π(u); cells are inside out where ``inverted`` says so."""

    def __init__(self, r, potential=None, inverted=lambda u: False, moves=False):
        self.u, self.visited = 0.0, []
        self._r = r
        self.has_potential, self.scalars = potential is not None, SimpleNamespace(size=0)
        self.potential = lambda: potential(self.u)
        self.least_volume_ratio = lambda: -1.0 if inverted(self.u) else 1.0
        self.boundary_moves = lambda here: moves
        self.increment = lambda here, du: (du, np.zeros(0))
        self.multiply, self.free = lambda d: 0.0 * d, lambda r: r
        self.dot = lambda a, b: float(a @ b)

    def state(self):
        return np.array([self.u]), np.zeros(0)

    def set_state(self, state):
        self.u = float(state[0][0])
        self.visited.append(self.u)

    def residual(self):
        r = np.array([self._r(self.u)])
        return Residual(r, r, np.zeros(1), None)


def search(system: OneUnknown, *, shifted: bool = False) -> float:
    """Search along ΔU = 1; return α, which the state and the trial that is found tell, too."""
    height = system.potential() if system.has_potential else np.nan
    found = line_search(system, system.residual(), np.ones(1), shifted=shifted, height=height)
    assert system.u == found.alpha and found.residual.condensed[0] == system._r(system.u)
    assert np.isnan(found.potential) or found.potential == system.potential()
    return found.alpha


def valley(pit):
    """A constant force down to a pit, and one up beyond it."""
    return {
        "r": lambda u: -1.0 if u < pit else 1.0,
        "potential": lambda u: -min(u, pit) + max(u - pit, 0.0) / 4,
    }


SINGLE = {"r": lambda u: u - 1.0}
WEAK = {"r": lambda u: -1.0}
CASES = {
    "whole, to the zero": (SINGLE, False, 1.0),
    "whole, g(1)/g(0) = −0.7": ({"r": lambda u: 1.7 * u - 1.0}, False, 1.0),
    "whole, g(1)/g(0) = 1": (WEAK, False, 1.0),
    "zero of the secant": ({"r": lambda u: 4.0 * u - 1.0}, False, 0.25),
    "halved until no cell is inside out": ({**SINGLE, "inverted": lambda u: u > 0.2}, False, 0.125),
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


@pytest.mark.parametrize(("system", "shifted", "alpha"), CASES.values(), ids=CASES)
def test_step_length(system, shifted, alpha):
    assert search(OneUnknown(**system), shifted=shifted) == alpha


def test_only_trials_that_are_needed():
    """A whole step is one trial, a halved one has those before it."""
    for system, visited in ((SINGLE, [1.0]), (CASES["NaN"][0], [1.0, 0.5, 0.25])):
        one = OneUnknown(**system)
        search(one)
        assert one.visited == visited


@pytest.mark.parametrize("energy", [False, True])
@pytest.mark.parametrize("jump", [1.0, 20.0, 1e6])
@pytest.mark.parametrize("kink", [0.9, 0.06, 1e-5])
def test_a_step_ends_close_to_a_kink(kink, jump, energy):
    """g(α)/g(0) is 1 up to the kink and −jump after it: no other step length is close."""
    potential = lambda u: -u if u < kink else jump * (u - kink) - kink  # noqa: E731
    system = OneUnknown(lambda u: -1.0 if u < kink else jump, potential if energy else None)
    assert kink / 1.3 <= search(system) <= kink and len(system.visited) < 40
