# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Windkessels: exponential decay behind rigid walls, the order in Δt, and an elastic tube."""

from __future__ import annotations

import numpy as np
import pytest
from collective import COMM, agree, raises, small
from inflated import balloon, tube, tube_pressure, tube_volume
from scipy.integrate import solve_ivp

from dolfinx_feti.loading import Checkpoint, Steps, follow_load
from dolfinx_feti.scalars import Cavity, Windkessel

#: R [kPa s/mm³], C [mm³/kPa] and Z [kPa s/mm³]: a time constant of one second.
R, C, Z = 2.0, 0.5, 0.3


def march(windkessel, problem, dt, count, flow):
    """Take equal steps; return the pressure of the cavity after each."""
    pressures = []
    for n in range(count):
        windkessel.inflow.value = flow((n + 1) * dt)
        windkessel.begin(dt)
        problem.solve(renew=False)
        windkessel.accept()
        pressures.append(float(windkessel.cavity.pressure.value))
    return np.array(pressures)


def rigid(start, **parameters):
    """Return a Windkessel behind a wall that hardly moves, and its problem."""
    ball = balloon(2, stiffness=1e9)
    cavity = Cavity(ball.u, ball.ds(1), pressure=start)
    windkessel = Windkessel(cavity, resistance=R, compliance=C, **parameters)
    return windkessel, ball.problem([windkessel], subdomains=2)


def test_decay_behind_a_rigid_wall():
    """P = p₀ exp(−t/RC), within 0.5 % over two time constants of 100 steps each."""
    windkessel, problem = rigid(10.0)
    t = np.arange(1, 201) / 100.0
    small(
        np.abs(
            march(windkessel, problem, 0.01, 200, lambda t: 0.0) / (10.0 * np.exp(-t)) - 1.0
        ).max(),
        1e-3,
    )


@pytest.mark.parametrize("impedance", [0.0, Z])
def test_order_of_convergence(impedance):
    """A constant flow fills two and three elements; half the step, a quarter of the error."""
    errors = []
    for count in (10, 20, 40):
        windkessel, problem = rigid(impedance * 3.0, impedance=impedance, distal_pressure=0.0)
        exact = 3.0 * (R * (1.0 - np.exp(-1.0)) + impedance)
        pressures = march(windkessel, problem, 1.0 / count, count, lambda t: 3.0)
        errors.append(abs(pressures[-1] - exact))
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    agree(1.7 < orders.min() and orders.max() < 2.4, (errors, orders))


@pytest.mark.parametrize("impedance", [0.0, Z])
def test_elastic_tube(impedance):
    """The closed form of P over V closes the equations of a point: filled, then drained."""
    slice_ = tube((2, 3), stiffness=1.0)
    cavity = Cavity(slice_.u, slice_.ds(1), axis=(0.0, 0.0, 1.0))
    windkessel = Windkessel(cavity, resistance=R, compliance=C, impedance=impedance)
    problem = slice_.problem([windkessel], subdomains=2)
    V_0, dt, count = tube_volume(1.0), 0.01, 50

    def flow(t):
        return 0.3 * np.sin(np.pi * t / 0.4) ** 2 if t < 0.4 else 0.0

    def rates(t, y):
        V, p_c = y
        p, q = tube_pressure(V), flow(t)
        if impedance:
            Q = (p - p_c) / impedance
            return [q - Q, (Q - p_c / R) / C]
        slope = (tube_pressure(V + 1e-6) - tube_pressure(V - 1e-6)) / 2e-6
        rate = (q - p / R) / (1.0 + C * slope)
        return [rate, slope * rate]

    pressures = march(windkessel, problem, dt, count, flow)
    exact, y = [], [V_0, 0.0]
    for n in range(count):
        span = (n * dt, (n + 1) * dt)
        y = solve_ivp(rates, span, y, rtol=1e-9, atol=1e-12).y[:, -1]
        exact.append(tube_pressure(y[0]))
    agree(max(pressures) > 0.05)
    small(np.abs(pressures - exact).max() / max(exact), 5e-3)


def test_thick_tube_in_plane_strain():
    """P over V of the closed form, within 0.1 %, up to 1.5 times the radius."""
    slice_ = tube()
    cavity = Cavity(slice_.u, slice_.ds(1), volume=1.0, axis=(0.0, 0.0, 1.0))
    problem, errors = slice_.problem([cavity]), []
    for radius in (1.1, 1.2, 1.35, 1.5):
        cavity.volume.value = tube_volume(radius)
        problem.solve()
        errors.append(float(cavity.pressure.value) / tube_pressure(tube_volume(radius)) - 1.0)
    small(np.abs(errors).max(), 1e-3)


BAD = {
    "R": ({"resistance": 0.0, "compliance": C}, "resistance=0.0: give a positive"),
    "C": ({"resistance": R, "compliance": -1.0}, "compliance=-1.0: give a positive"),
    "R is none": ({"resistance": np.nan, "compliance": C}, "resistance=nan"),
    "Z": ({"resistance": R, "compliance": C, "impedance": -0.1}, "impedance=-0.1"),
}


@pytest.mark.parametrize(("parameters", "message"), BAD.values(), ids=BAD)
def test_bad_parameters(parameters, message):
    ball = balloon(2)
    with raises(ValueError, message):
        Windkessel(Cavity(ball.u, ball.ds(1)), **parameters)


def test_what_does_not_fit():
    """A prescribed volume; no time step; a length that is none."""
    ball = balloon(2)
    with raises(ValueError, "prescribed volume"):
        Windkessel(Cavity(ball.u, ball.ds(1), volume=1.0), resistance=R, compliance=C)
    windkessel = Windkessel(Cavity(ball.u, ball.ds(1)), resistance=R, compliance=C)
    problem = ball.problem([windkessel])
    with raises(ValueError, "No time step"):
        problem.solve()
    with raises(ValueError, "dt=0.0"):
        windkessel.begin(0.0)
    with raises(ValueError, "has no volume"):
        ball.problem([Cavity(ball.u, ball.ds(1))])


def beat(folder, *, kill=None, restart=False):
    """Follow a tube through a pulse of flow; return what was seen, and the history."""
    slice_ = tube((2, 3))
    cavity = Cavity(slice_.u, slice_.ds(1), axis=(0.0, 0.0, 1.0))
    windkessel = Windkessel(cavity, resistance=R, compliance=C, impedance=Z)
    problem = slice_.problem([windkessel], subdomains=2, petsc_options={"snes_rtol": 1e-10})
    seen = []

    def set_time(t):
        windkessel.inflow.value = 0.3 * np.sin(np.pi * t / 0.4) ** 2

    def look(step):
        seen.append((step.load, float(cavity.pressure.value), cavity.present_volume()))
        if kill is not None and len(seen) == kill + 1:
            raise InterruptedError

    follow_load(
        problem,
        set_time,
        [0.1, 0.2],
        Steps(first=0.02, least=0.01, growth=1.0),
        on_step=look,
        checkpoint=Checkpoint(folder, COMM, restart=restart),
    )
    return np.array(seen), np.array(windkessel.history.value)


def test_restart_in_the_middle_of_a_beat(tmp_path):
    """The path knows Δt and keeps the Windkessel's history; a run that was killed goes on."""
    whole_run, history = beat(tmp_path / "whole")
    with raises(InterruptedError, ""):
        beat(tmp_path / "parts", kill=4)
    rest, after = beat(tmp_path / "parts", restart=True)
    agree(len(rest) == len(whole_run) - 4, (len(rest), len(whole_run)))
    small(np.abs(rest / whole_run[4:] - 1.0).max(), 1e-10)
    small(np.abs(after / history - 1.0).max(), 1e-10)
