# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The step length in one unknown, where every rule can be followed by hand, and the shift."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest

from dolfinx_feti.problems.direction import LARGEST_SHIFT, LEAST_SHIFT, SHIFT_GROWTH, fallen, raised
from dolfinx_feti.problems.line_search import LONGEST, line_search
from dolfinx_feti.problems.system import Residual

pytestmark = pytest.mark.serial
NOTHING = np.zeros(0)


class OneUnknown:
    """A system with r(u) and, if given, Π(u); cells are inside out where ``inverted`` says so."""

    def __init__(
        self,
        r: Callable[[float], float],
        *,
        potential: Callable[[float], float] | None = None,
        inverted: Callable[[float], bool] = lambda u: False,
        moves: bool = False,
    ) -> None:
        self.u = 0.0
        self.visited: list[float] = []
        self._r, self._potential, self._inverted = r, potential, inverted
        self._moves = moves
        self.has_potential = potential is not None
        self.scalars = SimpleNamespace(size=0)

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        return np.array([self.u]), NOTHING

    def set_state(self, state: tuple[np.ndarray, np.ndarray]) -> None:
        self.u = float(state[0][0])
        self.visited.append(self.u)

    def increment(self, here: Residual, du: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return du, NOTHING

    def residual(self) -> Residual:
        r = np.array([self._r(self.u)])
        return Residual(r, r, np.zeros(1), None)

    def boundary_moves(self, here: Residual) -> bool:
        return self._moves

    def multiply(self, d: np.ndarray) -> np.ndarray:
        return 0.0 * d

    def free(self, r: np.ndarray) -> np.ndarray:
        return r

    def least_volume_ratio(self) -> float:
        return -1.0 if self._inverted(self.u) else 1.0

    def potential(self) -> float:
        return self._potential(self.u)

    def dot(self, a: np.ndarray, b: np.ndarray) -> float:
        return float(a @ b)


def search(system: OneUnknown, du: float, *, shifted: bool = False) -> tuple[float, float]:
    """Search along ΔU; return α and the residual; the state is the one found."""
    known = np.nan if system.has_potential else None
    here, step = system.residual(), np.array([du])
    found = line_search(system, here, step, shifted=shifted, potential=known)
    assert system.u == found.alpha * du and found.residual.condensed[0] == system._r(system.u)
    assert np.isnan(found.potential) or found.potential == system.potential()
    return found.alpha, float(found.residual.condensed[0])


@pytest.mark.parametrize("stiffness", [1.0, 1.7, 0.0])
def test_a_whole_step_within_bounds(stiffness):
    """g(1)/g(0) = 1 − stiffness, between −0.8 and 1.8."""
    system = OneUnknown(lambda u: stiffness * u - 1.0)
    assert search(system, 1.0)[0] == 1.0 and system.visited == [1.0]


def test_a_step_that_overshoots_goes_to_the_zero_of_the_secant():
    system = OneUnknown(lambda u: 4.0 * u - 1.0)
    assert search(system, 1.0) == (0.25, 0.0)


@pytest.mark.parametrize("energy", [False, True])
@pytest.mark.parametrize("jump", [1.0, 20.0, 1e6])
@pytest.mark.parametrize("kink", [0.9, 0.06, 1e-5])
def test_a_step_ends_close_to_a_kink(kink, jump, energy):
    """g(α)/g(0) is 1 up to the kink and −jump after it: no other step length is close."""
    potential = lambda u: -u if u < kink else jump * (u - kink) - kink  # noqa: E731
    system = OneUnknown(
        lambda u: -1.0 if u < kink else jump, potential=potential if energy else None
    )
    alpha, _ = search(system, 1.0)
    assert kink / 1.3 <= alpha <= kink and len(system.visited) < 40


def test_a_step_is_halved_until_no_cell_is_inside_out():
    system = OneUnknown(lambda u: u - 1.0, inverted=lambda u: u > 0.2)
    assert search(system, 1.0)[0] == 0.125 and system.visited == [1.0, 0.5, 0.25, 0.125]


def test_without_an_admissible_step_it_stays():
    system = OneUnknown(lambda u: u - 1.0, inverted=lambda u: u > 0.0)
    assert search(system, 1.0) == (0.0, -1.0) and system.u == 0.0


def test_nan_is_refused():
    system = OneUnknown(lambda u: np.nan if u > 0.3 else u - 1.0)
    assert search(system, 1.0)[0] == 0.25


def test_a_potential_has_to_fall():
    """By g alone the whole step would be taken, beyond the pit at 0.2."""
    system = OneUnknown(lambda u: -1.0, potential=lambda u: (u - 0.2) ** 2)
    assert search(system, 1.0)[0] == 0.25
    system.u = 0.0
    given = line_search(system, system.residual(), np.ones(1), shifted=False, potential=0.04)
    assert given.potential == system.potential() < 0.04, "what was known, and what is known now"
    free = OneUnknown(lambda u: -1.0)
    assert search(free, 1.0)[0] == 1.0


@pytest.mark.parametrize(
    ("moves", "height"), [(True, 0.0), (False, 1e12)], ids=["boundary moves", "rounding"]
)
def test_where_the_potential_has_no_say(moves, height):
    """While prescribed displacements move, and where its change drowns in rounding."""
    system = OneUnknown(lambda u: u - 1.0, potential=lambda u: height + u, moves=moves)
    assert search(system, 1.0)[0] == 1.0


@pytest.mark.parametrize(("pit", "alpha"), [(5.0, 8.0), (100.0, LONGEST), (0.6, 1.0)])
def test_a_step_that_a_shift_has_made_short_is_doubled(pit, alpha):
    """While the potential falls, and up to a bound; a plain one is not, and ends before a pit."""
    system = OneUnknown(
        lambda u: -1.0 if u < pit else 1.0, potential=lambda u: -min(u, pit) + max(u - pit, 0.0) / 4
    )
    assert search(system, 1.0, shifted=True)[0] == alpha
    system.u = 0.0
    assert search(system, 1.0)[0] == (1.0 if pit > 1.0 else 0.5)


def test_the_shift_grows_from_nothing_to_the_largest():
    sigma, seen = raised(0.0), []
    while sigma is not None:
        seen.append(sigma)
        sigma = raised(sigma)
    assert seen == [LEAST_SHIFT * SHIFT_GROWTH**k for k in range(8)] and seen[-1] == LARGEST_SHIFT


@pytest.mark.parametrize(("grown", "steps"), [(True, 9), (False, 5)])
def test_the_shift_falls_to_nothing(grown, steps):
    sigma, seen = LARGEST_SHIFT, []
    while sigma > 0.0:
        sigma = fallen(sigma, grown=grown)
        seen.append(sigma)
    assert len(seen) == steps and all(s >= LEAST_SHIFT / SHIFT_GROWTH for s in seen[:-1])
    assert fallen(0.0, grown=grown) == 0.0
