# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Windkessels: exponential decay behind rigid walls, the order in Δt, and an elastic tube."""

from __future__ import annotations

import itertools
import os
import signal
from dataclasses import replace

import numpy as np
import pytest
from collective import COMM, agree, equal, raises, small
from inflated import balloon, tube, tube_pressure, tube_volume
from scipy.integrate import solve_ivp

from dolfinx_feti.loading import Checkpoint, Motion, Steps, TimeSteps, follow_load, follow_time
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


@pytest.mark.parametrize(("unit", "stiffness", "second"), [(1e3, 1e-6, 1e-3), (1e-3, 1e6, 60.0)])
def test_law_of_units(unit, stiffness, second):
    """Pressures scale as they must, and steps not at all, for R, C and Z in the same units."""

    def filled(unit, stiffness, second):
        flow, ohm = unit**3 / second, stiffness * second / unit**3
        ball = balloon(2, unit=unit, stiffness=stiffness)
        cavity = Cavity(ball.u, ball.ds(1))
        windkessel = Windkessel(
            cavity, resistance=R * ohm, compliance=C * unit**3 / stiffness, impedance=Z * ohm
        )
        far = {"snes_rtol": 1e-6}  # from all residuals
        problem = ball.problem([windkessel], subdomains=2, petsc_options=far)
        pressures = march(windkessel, problem, 0.1 * second, 3, lambda t: 0.1 * flow)
        return pressures / stiffness, len(problem.history)

    (expected, steps), (pressures, others) = filled(1.0, 1.0, 1.0), filled(unit, stiffness, second)
    equal(pressures, expected, 1e-6)
    agree(steps == others, (steps, others))


def rigid(start, **parameters):
    """Return a Windkessel behind a wall that hardly moves, and its problem."""
    ball = balloon(2, stiffness=1e9)
    cavity = Cavity(ball.u, ball.ds(1), pressure=start)
    windkessel = Windkessel(cavity, resistance=R, compliance=C, **parameters)
    return windkessel, ball.problem([windkessel], subdomains=2)


@pytest.mark.parametrize("impedance", [0.0, Z])
def test_decay_behind_a_rigid_wall(impedance):
    """P = p₀ exp(−t/RC), within 0.5 % over two time constants of 100 steps each."""
    windkessel, problem = rigid(10.0, impedance=impedance)
    exact = 10.0 * np.exp(-np.arange(1, 201) / 100.0)
    pressures = march(windkessel, problem, 0.01, 200, lambda t: 0.0)
    small(np.abs(pressures / exact - 1.0).max(), 1e-3)


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


def test_what_does_not_fit():
    """A prescribed volume; no time step; a length and a flow that are none."""
    ball = balloon(2)
    with raises(ValueError, "prescribed volume"):
        Windkessel(Cavity(ball.u, ball.ds(1), volume=1.0), resistance=R, compliance=C)
    windkessel = Windkessel(Cavity(ball.u, ball.ds(1)), resistance=R, compliance=C)
    problem = ball.problem([windkessel])
    with raises(ValueError, "No time step"):
        problem.solve()
    with raises(ValueError, "dt = 0.0: give a positive"):
        windkessel.begin(0.0)
    windkessel.begin(0.1)
    windkessel.inflow.value = np.nan
    with raises(ValueError, "inflow = nan: give a finite"):
        problem.solve()


DENSITY = 1e-2  # so that the first natural period of the tube is about half a second


def pulse(t):
    """Return the flow into the tube [mm³/s]."""
    return 0.3 * np.sin(np.pi * t / 0.4) ** 2


def beat(dt, *, inertia=False, impedance=Z, targets=(0.1, 0.2), look=None, checkpoint=None):
    """Follow a tube through a pulse of flow; return times, pressures and volumes, and history."""
    slice_ = tube((2, 3))
    motion = Motion(slice_.u, DENSITY)
    if inertia:
        slice_ = replace(slice_, energy=slice_.energy + motion.inertia)
    cavity = Cavity(slice_.u, slice_.ds(1), axis=(0.0, 0.0, 1.0))
    windkessel = Windkessel(cavity, resistance=R, compliance=C, impedance=impedance)
    problem = slice_.problem([windkessel], subdomains=2, petsc_options={"snes_rtol": 1e-10})
    seen = []

    def set_time(t):
        windkessel.inflow.value = pulse(t)

    def on_step(step):
        seen.append((step.load, float(cavity.pressure.value), cavity.present_volume()))
        if look is not None:
            look(len(seen))

    keywords = {"on_step": on_step, "checkpoint": checkpoint}
    if inertia:
        steps = TimeSteps(first=dt, least=dt / 2)
        follow_time(problem, motion, set_time, targets, steps, **keywords)
    else:
        steps = Steps(first=dt, least=dt / 2, growth=1.0)
        follow_load(problem, set_time, targets, steps, **keywords)
    return np.array(seen), np.array(windkessel.history.value)


def moving_tube(impedance):
    """Return the pressure in a tube of an incompressible material at t = 0.2, in closed form.

    With f = a ȧ of the inner radius a, its inertia is ρ (ḟ ln(b/a) + f²/2 (b⁻² − a⁻²)).
    """

    def mass(V):
        a, b = np.sqrt(V / tube_volume(1.0)), np.sqrt(1.5**2 + V / tube_volume(1.0) - 1.0)
        return DENSITY * np.log(b / a), DENSITY / 2.0 * (b**-2 - a**-2)

    def rates(t, y):
        V, f, p_c = y
        Q = pulse(t) - 2.0 * tube_volume(1.0) * f
        m, n = mass(V)
        rest = p_c + impedance * Q - tube_pressure(V) - n * f**2
        return [2.0 * tube_volume(1.0) * f, rest / m, (Q - p_c / R) / C]

    start = [tube_volume(1.0), 0.0, 0.0]
    _, _, p_c = y = solve_ivp(rates, (0.0, 0.2), start, rtol=1e-10, atol=1e-13).y[:, -1]
    return p_c + impedance * (pulse(0.2) - 2.0 * tube_volume(1.0) * y[1]), y[0]


@pytest.mark.serial
@pytest.mark.parametrize("impedance", [0.0, Z])
@pytest.mark.parametrize("inertia", [False, True])
def test_order_on_a_path(inertia, impedance):
    """Half the step, a quarter of the error; with inertia beside the moving tube's closed form."""
    runs = [beat(0.2 / n, inertia=inertia, impedance=impedance, targets=[0.2])[0][:, 1:]
            for n in (10, 20, 40)]  # fmt: skip
    errors = [np.abs(coarse - fine[1::2]).max(axis=0) for coarse, fine in itertools.pairwise(runs)]
    orders = np.log2(errors[0] / errors[1])
    agree(orders.min() > 1.8 and orders.max() < 2.4, (errors, orders))
    if inertia:
        small(np.abs(runs[-1][-1] / np.array(moving_tube(impedance)) - 1.0).max(), 2e-3)


def _raise(_number):
    raise InterruptedError


INTERRUPTS = {
    "exception": (InterruptedError, _raise),
    "signal": (SystemExit, lambda _number: os.kill(os.getpid(), signal.SIGTERM)),
}


@pytest.mark.parametrize("how", INTERRUPTS)
@pytest.mark.parametrize("inertia", [False, True])
def test_restart_in_the_middle_of_a_beat(tmp_path, inertia, how):
    """The path knows Δt and keeps the Windkessel's history; a run that was killed goes on."""
    kind, interrupt = INTERRUPTS[how]
    whole_run, history = beat(0.02, inertia=inertia)

    def look(number):
        if number == 5:
            interrupt(number)

    caught = None
    try:
        beat(0.02, inertia=inertia, look=look, checkpoint=Checkpoint(tmp_path, COMM))
    except BaseException as error:
        caught = error
    agree(isinstance(caught, kind), repr(caught))
    checkpoint = Checkpoint(tmp_path, COMM, restart=True)
    rest, after = beat(0.02, inertia=inertia, checkpoint=checkpoint)
    agree(len(rest) in (5, 6), len(rest))
    small(np.abs(rest / whole_run[-len(rest) :] - 1.0).max(), 1e-10)
    small(np.abs(after / history - 1.0).max(), 1e-10)
