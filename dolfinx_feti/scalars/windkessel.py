# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Windkessels with two and three elements, which a cavity empties into.

.. math:: Q = q - \dot V(u), \qquad p = p_c + Z Q, \qquad C\, \dot p_c + (p_c - p_v)/R = Q

(docs/volumes.md). Rates are differences of second order (BDF2) over the present step Δt and the
last one, Δt = ω Δt₀; the first step takes those of first order (implicit Euler, ω = 0):

.. math:: \dot y ≈ \frac{1}{Δt} \left( \frac{1 + 2ω}{1 + ω} y - (1 + ω) y_n
          + \frac{ω^2}{1 + ω} y_{n-1} \right)
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import dolfinx

from dolfinx_feti.mechanics.values import require_finite, require_not_negative, require_positive
from dolfinx_feti.scalars.cavity import Cavity
from dolfinx_feti.scalars.equations import Coupling, ScalarEquation

__all__ = ["Windkessel"]


class Windkessel(Coupling):
    """Vessels behind a cavity: a resistance and a compliance, perhaps with an impedance before.

    Example::

        cavity = Cavity(u, ds(lumen), axis=(0, 0, 1), pressure=10.0)
        windkessel = Windkessel(cavity, resistance=R, compliance=C, impedance=Z)
        problem = NonlinearProblem(F, u, bcs=bcs, scalars=[windkessel])
        follow_load(problem, set_inflow, times, steps, state=[u])

    Attributes:
        cavity: The cavity; its pressure p is the unknown.
        inflow: q, a constant that may change [mm³/s].
        history: Δt₀, V_n, V_{n−1}, p_c at the same times, as a constant, (5,): all that a step
            needs to know of earlier ones.
    """

    def __init__(
        self,
        cavity: Cavity,
        *,
        resistance: float,
        compliance: float,
        impedance: float = 0.0,
        inflow: float = 0.0,
        venous_pressure: float = 0.0,
        distal_pressure: float | None = None,
    ) -> None:
        """Couple a cavity; the present volume is that of the start. Collective.

        Args:
            cavity: A cavity without a prescribed volume.
            resistance: R [kPa s/mm³], positive.
            compliance: C [mm³/kPa], positive.
            impedance: Z [kPa s/mm³], positive with three elements, zero with two.
            inflow: q at first [mm³/s].
            venous_pressure: Pressure behind R [kPa].
            distal_pressure: p_c at the start [kPa]; the cavity's pressure if not given.

        Raises:
            ValueError: A parameter is out of its range, or the cavity has a prescribed volume.
        """
        if not isinstance(cavity, Cavity):
            raise ValueError(f"cavity is {cavity!r}: give a Cavity.")
        require_positive(resistance=resistance, compliance=compliance)
        require_not_negative(impedance=impedance)
        require_finite(inflow=inflow, venous_pressure=venous_pressure)
        p_c = float(cavity.pressure.value) if distal_pressure is None else distal_pressure
        require_finite(distal_pressure=p_c)
        if cavity.volume is not None:
            raise ValueError(
                "The cavity of a Windkessel has a prescribed volume: the flow determines it. Leave "
                "volume= out."
            )
        mesh = cavity.u.function_space.mesh
        self.cavity = cavity
        self.inflow = dolfinx.fem.Constant(mesh, np.float64(inflow))
        self._R, self._C, self._Z = resistance, compliance, impedance
        self._venous = venous_pressure
        volume = cavity.present_volume()
        self.history = dolfinx.fem.Constant(mesh, np.array([0.0, volume, volume, p_c, p_c]))
        self._rates = dolfinx.fem.Constant(mesh, np.zeros(3))  # of y, y_n and y_{n−1} in ẏ

    def begin(self, dt: float) -> None:
        """Prepare a step of the length Δt [s], from the present history."""
        require_positive(dt=dt)
        last = self.history.value[0]
        ω = dt / last if last > 0.0 else 0.0  # none: first order
        self._rates.value = np.array([(1 + 2 * ω) / (1 + ω), -(1 + ω), ω**2 / (1 + ω)]) / dt
        self._dt = dt

    def accept(self) -> None:
        """Let the present state be the last one. Collective."""
        _, V, _, p_c, _ = self.history.value
        volume = self.cavity.present_volume()
        flow = self.outflow(volume)
        p = float(self.cavity.pressure.value) - self._Z * flow
        self.history.value = [self._dt, volume, V, p, p_c]

    def outflow(self, volume: float | None = None) -> float:
        """Return the flow Q into the vessels in the present step [mm³/s]. Collective."""
        V = self.cavity.present_volume() if volume is None else volume
        past = self._rates.value[1:] @ self.history.value[1:3]
        return float(self.inflow.value - self._rates.value[0] * V - past)

    @property
    def equation(self) -> ScalarEquation:
        """C ṗ_c + (p_c − p_v)/R = Q, for the pressure of the cavity."""
        cavity, rate, last = self.cavity, self._rates[0], self.history
        of_V, of_p = (self._rates[1] * last[i] + self._rates[2] * last[i + 1] for i in (1, 3))
        of_p_c = self._C * rate + 1.0 / self._R
        Q = self.inflow - of_V  # and − rate V
        rest = of_p_c * (cavity.pressure - self._Z * Q) + self._C * of_p
        rest = rest - self._venous / self._R - Q
        c = (of_p_c * self._Z + 1.0) * rate * cavity.form + cavity.spread(rest)
        return ScalarEquation(cavity.pressure, (c,), cavity.work)

    def check(self, bcs: Sequence[dolfinx.fem.DirichletBC]) -> None:
        """Check the cavity. Collective."""
        self.cavity.check(bcs)

    def check_values(self) -> None:
        """Require a step that has begun, and a flow."""
        if not self._rates.value[0] > 0.0:
            raise ValueError("No time step of the Windkessel has begun: call begin(dt) before.")
        require_finite(inflow=float(self.inflow.value))
