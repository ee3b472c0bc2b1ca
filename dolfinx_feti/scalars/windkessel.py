# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Windkessels with two and three elements, as outflow of a cavity.

.. math:: Q = q - \dot V(u), \qquad p = p_c + Z Q, \qquad C\, \dot p_c + (p_c - p_v)/R = Q

(docs/volumes.md). Rates are differences of second order (BDF2) over the present step Δt and the
last one Δt₀, with Δt = ω Δt₀. In the first step they are of first order (implicit Euler, ω = 0):

.. math:: \dot y ≈ \frac{1}{Δt} \left( \frac{1 + 2ω}{1 + ω} y - (1 + ω) y_n
          + \frac{ω^2}{1 + ω} y_{n-1} \right)
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import dolfinx

from dolfinx_feti.runtime.values import require_finite, require_not_negative, require_positive
from dolfinx_feti.scalars.cavity import Cavity
from dolfinx_feti.scalars.equations import Coupling, ScalarEquation

__all__ = ["Windkessel"]


class Windkessel(Coupling):
    """Vessels downstream of a cavity: resistance and compliance, with or without an impedance.

    Example::

        cavity = Cavity(u, ds(lumen), axis=(0, 0, 1))
        windkessel = Windkessel(cavity, resistance=1.0, compliance=0.1, impedance=0.05)
        problem = NonlinearProblem(energy, u, bcs=bcs, scalars=[windkessel])
        windkessel.inflow.value = 1.0  # mm³/s
        follow_load(problem, lambda time: None, [0.2], Steps(first=0.1, least=1e-3))

    Attributes:
        cavity: The cavity; its pressure p is the unknown.
        inflow: q [mm³/s], whose value may change.
        history: (Δt₀, V_n, V_{n−1}, p_{c,n}, p_{c,n−1}), (5,): all that a step needs of earlier
            ones. It is a Constant because paths restore the Constants of the forms after a failed
            step.
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
        """Create the Windkessel of a cavity; it starts with the present volume. Collective.

        Args:
            cavity: A cavity without a prescribed volume.
            resistance: R [kPa s/mm³], positive.
            compliance: C [mm³/kPa], positive.
            impedance: Z [kPa s/mm³], positive with three elements, zero with two.
            inflow: q at the start [mm³/s].
            venous_pressure: p_v, pressure downstream of R [kPa].
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
                "The cavity of a Windkessel has a prescribed volume, but the flow determines it: "
                "leave volume= out."
            )
        mesh = cavity.u.function_space.mesh
        self.cavity = cavity
        self.inflow = dolfinx.fem.Constant(mesh, np.float64(inflow))
        self._R = resistance
        self._C = compliance
        self._Z = impedance
        self._venous = venous_pressure
        volume = cavity.present_volume()
        self.history = dolfinx.fem.Constant(mesh, np.array([0.0, volume, volume, p_c, p_c]))
        self._rates = dolfinx.fem.Constant(mesh, np.zeros(3))  # of y, y_n and y_{n−1} in ẏ
        self._dt = 0.0  # Δt of the present step; 0 before the first one

    def begin_step(self, length: float) -> None:
        """Prepare a step of the length Δt [s], from the present history."""
        require_positive(length=length)
        dt = length
        last_dt = self.history.value[0]
        ω = dt / last_dt if last_dt > 0.0 else 0.0  # without a last step: first order
        self._rates.value = np.array([(1 + 2 * ω) / (1 + ω), -(1 + ω), ω**2 / (1 + ω)]) / dt
        self._dt = dt

    def accept(self) -> None:
        """Store the present state as the last one. Collective."""
        _, V_n, _, p_n, _ = self.history.value  # p_n is p_{c,n}
        volume = self.cavity.present_volume()
        flow = self.outflow(volume)
        p_c = float(self.cavity.pressure.value) - self._Z * flow  # p_c = p − Z Q
        self.history.value = [self._dt, volume, V_n, p_c, p_n]

    def outflow(self, volume: float | None = None) -> float:
        """Return the flow Q into the vessels in the present step [mm³/s]. Collective."""
        V = self.cavity.present_volume() if volume is None else volume
        past = self._rates.value[1:] @ self.history.value[1:3]
        return float(self.inflow.value - self._rates.value[0] * V - past)

    @property
    def equation(self) -> ScalarEquation:
        """The equation C ṗ_c + (p_c − p_v)/R − Q = 0, with the pressure of the cavity as unknown.

        Rates are ẏ = a y + y', where y' is the part of earlier steps. With Q = Q' − a V(u),
        Q' = q − V', p_c = p − Z Q and g = C a + 1/R, the equation is
        g (p − Z Q') + C p_c' − p_v/R − Q' + (g Z + 1) a V(u) = 0.
        """
        cavity = self.cavity
        a = self._rates[0]
        _, V_n, V_before, p_n, p_before = self.history
        V_rate = self._rates[1] * V_n + self._rates[2] * V_before  # V'
        p_rate = self._rates[1] * p_n + self._rates[2] * p_before  # p_c'
        g = self._C * a + 1.0 / self._R
        Q = self.inflow - V_rate  # Q'
        rest = g * (cavity.pressure - self._Z * Q) + self._C * p_rate
        rest = rest - self._venous / self._R - Q
        c = (g * self._Z + 1.0) * a * cavity.form + cavity.spread(rest)
        return ScalarEquation(cavity.pressure, (c,), cavity.work)

    def check(self, bcs: Sequence[dolfinx.fem.DirichletBC]) -> None:
        """Check the cavity. Collective."""
        self.cavity.check(bcs)

    def check_values(self) -> None:
        """Check that a step has begun, and that the inflow is finite."""
        if not self._rates.value[0] > 0.0:
            raise ValueError("No time step of the Windkessel has begun: call begin_step before.")
        require_finite(inflow=float(self.inflow.value))
