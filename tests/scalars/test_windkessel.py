# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Windkessels: exponential decay behind rigid walls, the order in Δt, and an elastic tube."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from collective import COMM, agree, equal, raises, small
from inflated import balloon, tube, tube_pressure, tube_volume
from scipy.integrate import solve_ivp

from dolfinx_feti.loading import Checkpoint, Motion, Steps, TimeSteps, follow_load, follow_time
from dolfinx_feti.scalars import Cavity, Windkessel

#: R [kPa s/mm³], C [mm³/kPa] and Z [kPa s/mm³]: a time constant of one second.
R = 2.0
C = 0.5
Z = 0.3


def march(windkessel, problem, dt, count, flow):
    """Make equal steps; return the pressure of the cavity after each."""
    pressures = []
    for n in range(count):
        windkessel.inflow.value = flow((n + 1) * dt)
        windkessel.begin_step(dt)
        problem.solve(renew=False)
        windkessel.accept()
        pressures.append(float(windkessel.cavity.pressure.value))
    return np.array(pressures)


@pytest.mark.parametrize("last_dt", [0.0, 0.1, 0.3], ids=["first-step", "longer", "shorter"])
def test_rates_are_exact_for_parabolas(last_dt):
    """BDF2 of two unequal steps; the first step has no second one, and is exact for lines."""
    ball = balloon(2)
    windkessel = Windkessel(Cavity(ball.u, ball.ds(1)), resistance=R, compliance=C)
    windkessel.history.value[0] = last_dt
    windkessel.begin_step(0.2)
    times = np.array([0.0, -0.2, -0.2 - last_dt])  # of y, y_n and y_{n−1}
    powers = np.arange(3 if last_dt > 0.0 else 2)
    derivatives = np.where(powers == 1, 1.0, 0.0)  # of 1, t and t² at t = 0
    equal(windkessel._rates.value @ times[:, None] ** powers, derivatives, 1e-14)


@pytest.mark.parametrize(("unit", "stiffness", "second"), [(1e3, 1e-6, 1e-3), (1e-3, 1e6, 60.0)])
def test_law_of_units(unit, stiffness, second):
    """Pressures scale as they must, and steps not at all, for R, C and Z in the same units."""

    def filled(unit, stiffness, second):
        flow = unit**3 / second
        ohm = stiffness * second / unit**3
        ball = balloon(2, unit=unit, stiffness=stiffness)
        cavity = Cavity(ball.u, ball.ds(1))
        windkessel = Windkessel(
            cavity, resistance=R * ohm, compliance=C * unit**3 / stiffness, impedance=Z * ohm
        )
        far = {"snes_rtol": 1e-6}  # from all residuals
        problem = ball.problem([windkessel], subdomains=2, petsc_options=far)
        pressures = march(windkessel, problem, 0.1 * second, 3, lambda t: 0.1 * flow)
        return pressures / stiffness, len(problem.history)

    (expected, steps) = filled(1.0, 1.0, 1.0)
    (pressures, others) = filled(unit, stiffness, second)
    equal(pressures, expected, 1e-6)
    agree(steps == others, (steps, others))


def rigid(start, **parameters):
    """Return a Windkessel behind a wall that hardly moves, and its problem."""
    ball = balloon(2, stiffness=1e9)
    cavity = Cavity(ball.u, ball.ds(1), pressure=start)
    windkessel = Windkessel(cavity, resistance=R, compliance=C, **parameters)
    return windkessel, ball.problem([windkessel], subdomains=2)


@pytest.mark.parametrize("impedance", [0.0, Z])
@pytest.mark.parametrize("flow", [0.0, 3.0])
def test_order_of_convergence(impedance, flow):
    """A constant flow fills vessels that empty; half the step, a quarter of the error."""
    errors = []
    for count in (10, 20, 40):
        start = 10.0 if flow == 0.0 else impedance * flow
        distal = {} if flow == 0.0 else {"distal_pressure": 0.0}  # else that of the cavity
        windkessel, problem = rigid(start, impedance=impedance, **distal)
        decay = np.exp(-np.arange(1, count + 1) / count)
        exact = (start - impedance * flow) * decay + flow * (R * (1.0 - decay) + impedance)
        pressures = march(windkessel, problem, 1.0 / count, count, lambda t: flow)
        errors.append(np.abs(pressures - exact)[count // 10 - 1 :: count // 10].max())
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    agree(1.7 < orders.min() and orders.max() < 2.4, (errors, orders))


def test_thick_tube_in_plane_strain():
    """P over V of the closed form, within 0.1 %, up to 1.5 times the radius."""
    slice_ = tube()
    cavity = Cavity(slice_.u, slice_.ds(1), volume=1.0, axis=(0.0, 0.0, 1.0))
    problem = slice_.problem([cavity])
    errors = []
    for radius in (1.1, 1.2, 1.35, 1.5):
        cavity.volume.value = tube_volume(radius)
        problem.solve()
        errors.append(float(cavity.pressure.value) / tube_pressure(tube_volume(radius)) - 1.0)
    small(np.abs(errors).max(), 1e-3)


def test_what_does_not_fit():
    """A solve without a time step, a step of length zero, and a flow that is NaN."""
    ball = balloon(2)
    windkessel = Windkessel(Cavity(ball.u, ball.ds(1)), resistance=R, compliance=C)
    problem = ball.problem([windkessel])
    with raises(ValueError, "No time step"):
        problem.solve()
    with raises(ValueError, "length = 0.0: give a positive"):
        windkessel.begin_step(0.0)
    windkessel.begin_step(0.1)
    windkessel.inflow.value = np.nan
    with raises(ValueError, "inflow = nan: give a finite"):
        problem.solve()


DENSITY = 1e-2  # so that the first natural period of the tube is about half a second


def pulse(t):
    """Return the flow into the tube [mm³/s]."""
    return 0.3 * np.sin(np.pi * t / 0.4) ** 2


def beat(
    dt, *, inertia=False, impedance=Z, targets=(0.1, 0.2), look=None, checkpoint=None, rtol=None
):
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
        steps = Steps(first=dt, least=dt / 2, growth=1.0, rtol=rtol)
        follow_load(problem, set_time, targets, steps, **keywords)
    return np.array(seen), np.array(windkessel.history.value)


def tube_at_the_end(impedance, inertia):
    """Return pressure and volume of a tube of an incompressible material at t = 0.2, closed form.

    With f = a ȧ of the inner radius a, its inertia is ρ (ḟ ln(b/a) + f²/2 (b⁻² − a⁻²)).
    """
    V_0 = tube_volume(1.0)

    def moving(t, y):
        V, f, p_c = y
        a = np.sqrt(V / V_0)
        b = np.sqrt(1.5**2 + V / V_0 - 1.0)
        Q = pulse(t) - 2.0 * V_0 * f
        rest = p_c + impedance * Q - tube_pressure(V) - DENSITY / 2.0 * (b**-2 - a**-2) * f**2
        return [2.0 * V_0 * f, rest / (DENSITY * np.log(b / a)), (Q - p_c / R) / C]

    def at_rest(t, y):
        V, p_c = y
        if impedance:
            Q = (tube_pressure(V) - p_c) / impedance
            return [pulse(t) - Q, (Q - p_c / R) / C]
        slope = (tube_pressure(V + 1e-6) - tube_pressure(V - 1e-6)) / 2e-6
        rate = (pulse(t) - tube_pressure(V) / R) / (1.0 + C * slope)
        return [rate, slope * rate]

    rates, start = (moving, [V_0, 0.0, 0.0]) if inertia else (at_rest, [V_0, 0.0])
    V, *f, p_c = solve_ivp(rates, (0.0, 0.2), start, rtol=1e-10, atol=1e-13).y[:, -1]
    p = p_c + impedance * (pulse(0.2) - 2.0 * V_0 * f[0]) if inertia else tube_pressure(V)
    return np.array([p, V])


@pytest.mark.serial
@pytest.mark.parametrize("impedance", [0.0, Z])
@pytest.mark.parametrize("inertia", [False, True])
def test_order_on_a_path(inertia, impedance):
    """Half the step, a quarter of the error; the last one is beside the closed form."""
    runs = [
        beat(0.2 / n, inertia=inertia, impedance=impedance, targets=[0.2])[0][:, 1:]
        for n in (10, 20, 40)
    ]
    errors = [np.abs(coarse - fine[1::2]).max(axis=0) for coarse, fine in itertools.pairwise(runs)]
    orders = np.log2(errors[0] / errors[1])
    agree(orders.min() > 1.8 and orders.max() < 2.4, (errors, orders))
    small(np.abs(runs[-1][-1] / tube_at_the_end(impedance, inertia) - 1.0).max(), 2e-3)


@pytest.mark.parametrize("inertia", [False, True])
def test_restart_in_the_middle_of_a_beat(tmp_path, inertia):
    """The path knows Δt and keeps the Windkessel's history; a run that was stopped goes on."""
    whole_run, history = beat(0.02, inertia=inertia)

    def look(number):
        if number == 5:
            raise InterruptedError

    with raises(InterruptedError, ""):
        beat(0.02, inertia=inertia, look=look, checkpoint=Checkpoint(tmp_path, COMM))
    checkpoint = Checkpoint(tmp_path, COMM, restart=True)
    rest, after = beat(0.02, inertia=inertia, checkpoint=checkpoint)
    agree(len(rest) in (5, 6), len(rest))
    small(np.abs(rest / whole_run[-len(rest) :] - 1.0).max(), 1e-10)
    small(np.abs(after / history - 1.0).max(), 1e-10)


@pytest.mark.parametrize("inertia", [False, True])
def test_times_that_differ_by_rounding_alone(inertia):
    """0.15 and 3 · 0.05 are one time: a step of 3e-17 s between them would spoil BDF2."""
    expected, _ = beat(0.05, inertia=inertia, targets=[0.1, 0.15, 0.2])
    found, _ = beat(0.05, inertia=inertia, targets=[0.1, 0.15, 3 * 0.05, 0.2])
    agree(len(found) == len(expected), (len(found), len(expected)))
    small(np.abs(found / expected - 1.0).max(), 1e-12)


def test_restart_at_a_time_that_was_met_roughly(tmp_path):
    """The step to it is taken again, from the history before it: as in a run without interruption.

    Rates of the Windkessel belong to one step: solved twice, it would fill twice.
    """
    whole = tmp_path / "whole"
    parts = tmp_path / "parts"
    kept = Checkpoint(whole, COMM)  # so that rough solves begin alike
    expected, history = beat(0.04, targets=[0.08, 0.2], checkpoint=kept, rtol=1e-2)

    def look(number):
        if number == 3:
            raise InterruptedError

    with raises(InterruptedError, ""):
        beat(0.04, targets=[0.2], look=look, checkpoint=Checkpoint(parts, COMM), rtol=1e-2)
    checkpoint = Checkpoint(parts, COMM, restart=True)
    found, after = beat(0.04, targets=[0.08, 0.2], checkpoint=checkpoint, rtol=1e-2)
    agree(found[0, 0] == 0.08, found[:, 0])
    small(np.abs(found / expected[-len(found) :] - 1.0).max(), 1e-7)
    small(np.abs(after / history - 1.0).max(), 1e-7)
