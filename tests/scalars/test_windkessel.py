# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Windkessels: exponential decay behind rigid walls, the order in Δt, an elastic tube, restarts."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from collective import COMM, agree, equal, raises, small
from inflated import balloon, thick_tube, tube_pressure, tube_volume
from scipy.integrate import solve_ivp

from dolfinx_feti.loading import Checkpoint, Motion, Steps, TimeSteps, follow_load, follow_time
from dolfinx_feti.scalars import Cavity, Windkessel

#: R [kPa s/mm³], C [mm³/kPa] and Z [kPa s/mm³]: a time constant of one second.
R = 2.0
C = 0.5
Z = 0.3


def march(windkessel, problem, dt, count, flow):
    """Make equal time steps.

    Args:
        windkessel: The Windkessel.
        problem: Problem of the wall, with the Windkessel.
        dt: Length of a step.
        count: Number of steps.
        flow: Inflow as a function of time.

    Returns:
        Pressure of the cavity after each step, (count,).
    """
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
    """BDF2 has two unequal steps; the first step of a run has one, and is exact for lines."""
    ball = balloon(2)
    windkessel = Windkessel(Cavity(ball.u, ball.ds(1)), resistance=R, compliance=C)
    windkessel.history.value[0] = last_dt
    windkessel.begin_step(0.2)
    times = np.array([0.0, -0.2, -0.2 - last_dt])  # of y, y_n and y_{n−1}
    powers = np.arange(3 if last_dt > 0.0 else 2)
    derivatives = np.where(powers == 1, 1.0, 0.0)  # of 1, t and t² at t = 0
    equal(windkessel._rates.value @ times[:, None] ** powers, derivatives, 1e-14)


@pytest.mark.parametrize(("unit", "stiffness", "second"), [(1e3, 1e-6, 1e-3), (1e-3, 1e6, 60.0)])
def test_pressures_scale_with_units_and_steps_do_not(unit, stiffness, second):
    """R, C and Z are in the same units as the balloon."""

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


def rigid_windkessel(start, **parameters):
    """Return a Windkessel behind a wall that hardly moves, and its problem."""
    ball = balloon(2, stiffness=1e9)
    cavity = Cavity(ball.u, ball.ds(1), pressure=start)
    windkessel = Windkessel(cavity, resistance=R, compliance=C, **parameters)
    return windkessel, ball.problem([windkessel], subdomains=2)


@pytest.mark.parametrize("impedance", [0.0, Z])
@pytest.mark.parametrize("flow", [0.0, 3.0])
def test_pressure_behind_a_rigid_wall_has_second_order(impedance, flow):
    """A constant flow fills vessels that empty; half the step gives a quarter of the error."""
    errors = []
    for count in (10, 20, 40):
        start = 10.0 if flow == 0.0 else impedance * flow
        distal = {} if flow == 0.0 else {"distal_pressure": 0.0}  # else that of the cavity
        windkessel, problem = rigid_windkessel(start, impedance=impedance, **distal)
        decay = np.exp(-np.arange(1, count + 1) / count)
        exact = (start - impedance * flow) * decay + flow * (R * (1.0 - decay) + impedance)
        pressures = march(windkessel, problem, 1.0 / count, count, lambda t: flow)
        errors.append(np.abs(pressures - exact)[count // 10 - 1 :: count // 10].max())
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    agree(1.7 < orders.min() and orders.max() < 2.4, (errors, orders))


def test_thick_tube_has_the_pressure_of_its_closed_form():
    """In plane strain, within 0.1 %, up to 1.5 times the radius."""
    slice_ = thick_tube()
    cavity = Cavity(slice_.u, slice_.ds(1), volume=1.0, axis=(0.0, 0.0, 1.0))
    problem = slice_.problem([cavity])
    errors = []
    for radius in (1.1, 1.2, 1.35, 1.5):
        cavity.volume.value = tube_volume(radius)
        problem.solve()
        errors.append(float(cavity.pressure.value) / tube_pressure(tube_volume(radius)) - 1.0)
    small(np.abs(errors).max(), 1e-3)


@pytest.fixture
def windkessel_of_balloon():
    """Return a Windkessel and the balloon that it belongs to."""
    ball = balloon(2)
    return Windkessel(Cavity(ball.u, ball.ds(1)), resistance=R, compliance=C), ball


def test_solve_needs_a_time_step(windkessel_of_balloon):
    """Rates of the Windkessel are those of a time step."""
    windkessel, ball = windkessel_of_balloon
    problem = ball.problem([windkessel])
    with raises(ValueError, "No time step"):
        problem.solve()


def test_time_step_must_be_positive(windkessel_of_balloon):
    """A step of length zero would divide by zero."""
    windkessel, _ = windkessel_of_balloon
    with raises(ValueError, "length = 0.0: give a positive"):
        windkessel.begin_step(0.0)


def test_inflow_must_be_finite(windkessel_of_balloon):
    """The value is set by the user between two solves, so that the solve has to check it."""
    windkessel, ball = windkessel_of_balloon
    problem = ball.problem([windkessel])
    windkessel.begin_step(0.1)
    windkessel.inflow.value = np.nan
    with raises(ValueError, "inflow = nan: give a finite"):
        problem.solve()


DENSITY = 1e-2  # so that the first natural period of the tube is about half a second


def pulse_flow(t):
    """Return the flow into the tube [mm³/s]."""
    return 0.3 * np.sin(np.pi * t / 0.4) ** 2


def follow_beat(
    dt,
    *,
    inertia=False,
    impedance=Z,
    targets=(0.1, 0.2),
    after_step=None,
    checkpoint=None,
    rtol=None,
):
    """Follow an elastic tube with a Windkessel through a pulse of flow.

    Args:
        dt: Length of the first step, which may be halved.
        inertia: Whether the wall has inertia.
        impedance: Impedance of the Windkessel [kPa s/mm³].
        targets: Times to be met [s].
        after_step: Called with the number of steps after each one; None for no call.
        checkpoint: Where the run is stored, or continued from.
        rtol: Tolerance of rough solves before a target; None for accurate ones.

    Returns:
        Time, pressure and volume after each step, (steps, 3), and the history of the Windkessel.
    """
    slice_ = thick_tube((2, 3))
    motion = Motion(slice_.u, DENSITY)
    if inertia:
        slice_ = replace(slice_, energy=slice_.energy + motion.inertia)
    cavity = Cavity(slice_.u, slice_.ds(1), axis=(0.0, 0.0, 1.0))
    windkessel = Windkessel(cavity, resistance=R, compliance=C, impedance=impedance)
    problem = slice_.problem([windkessel], subdomains=2, petsc_options={"snes_rtol": 1e-10})
    records = []

    def set_time(t):
        windkessel.inflow.value = pulse_flow(t)

    def on_step(step):
        records.append((step.load, float(cavity.pressure.value), cavity.present_volume()))
        if after_step is not None:
            after_step(len(records))

    keywords = {"on_step": on_step, "checkpoint": checkpoint}
    if inertia:
        steps = TimeSteps(first=dt, least=dt / 2)
        follow_time(problem, motion, set_time, targets, steps, **keywords)
    else:
        steps = Steps(first=dt, least=dt / 2, growth=1.0, rtol=rtol)
        follow_load(problem, set_time, targets, steps, **keywords)
    return np.array(records), np.array(windkessel.history.value)


def tube_at_the_end(impedance, inertia):
    """Return pressure and volume of the tube at t = 0.2, of its differential equations.

    The material is incompressible. With f = a ȧ of the inner radius a, its inertia is ρ (ḟ ln(b/a)
    + f²/2 (b⁻² − a⁻²)).
    """
    V_0 = tube_volume(1.0)

    def moving(t, y):
        V, f, p_c = y
        a = np.sqrt(V / V_0)
        b = np.sqrt(1.5**2 + V / V_0 - 1.0)
        Q = pulse_flow(t) - 2.0 * V_0 * f
        rest = p_c + impedance * Q - tube_pressure(V) - DENSITY / 2.0 * (b**-2 - a**-2) * f**2
        return [2.0 * V_0 * f, rest / (DENSITY * np.log(b / a)), (Q - p_c / R) / C]

    def at_rest(t, y):
        V, p_c = y
        if impedance:
            Q = (tube_pressure(V) - p_c) / impedance
            return [pulse_flow(t) - Q, (Q - p_c / R) / C]
        slope = (tube_pressure(V + 1e-6) - tube_pressure(V - 1e-6)) / 2e-6
        rate = (pulse_flow(t) - tube_pressure(V) / R) / (1.0 + C * slope)
        return [rate, slope * rate]

    rates, start = (moving, [V_0, 0.0, 0.0]) if inertia else (at_rest, [V_0, 0.0])
    V, *f, p_c = solve_ivp(rates, (0.0, 0.2), start, rtol=1e-10, atol=1e-13).y[:, -1]
    p = p_c + impedance * (pulse_flow(0.2) - 2.0 * V_0 * f[0]) if inertia else tube_pressure(V)
    return np.array([p, V])


@pytest.mark.serial
@pytest.mark.parametrize("impedance", [0.0, Z])
@pytest.mark.parametrize("inertia", [False, True])
def test_tube_with_a_windkessel_has_second_order(inertia, impedance):
    """Half the step gives a quarter of the error, and the last run agrees with the ODEs."""
    runs = [
        follow_beat(0.2 / n, inertia=inertia, impedance=impedance, targets=[0.2])[0][:, 1:]
        for n in (10, 20, 40)
    ]
    errors = [np.abs(coarse - fine[1::2]).max(axis=0) for coarse, fine in itertools.pairwise(runs)]
    orders = np.log2(errors[0] / errors[1])
    agree(orders.min() > 1.8 and orders.max() < 2.4, (errors, orders))
    small(np.abs(runs[-1][-1] / tube_at_the_end(impedance, inertia) - 1.0).max(), 2e-3)


@pytest.mark.parametrize("inertia", [False, True])
def test_restarted_run_continues_the_beat(tmp_path, inertia):
    """The checkpoint has Δt and the history of the Windkessel."""
    expected, history = follow_beat(0.02, inertia=inertia)

    def interrupt(number):
        if number == 5:
            raise InterruptedError

    with raises(InterruptedError, ""):
        follow_beat(
            0.02, inertia=inertia, after_step=interrupt, checkpoint=Checkpoint(tmp_path, COMM)
        )
    checkpoint = Checkpoint(tmp_path, COMM, restart=True)
    continued, continued_history = follow_beat(0.02, inertia=inertia, checkpoint=checkpoint)
    agree(len(continued) in (5, 6), len(continued))
    small(np.abs(continued / expected[-len(continued) :] - 1.0).max(), 1e-10)
    small(np.abs(continued_history / history - 1.0).max(), 1e-10)


@pytest.mark.parametrize("inertia", [False, True])
def test_times_that_differ_by_rounding_are_one_time(inertia):
    """A step of 3e-17 s between 0.15 and 3 · 0.05 would spoil BDF2."""
    expected, _ = follow_beat(0.05, inertia=inertia, targets=[0.1, 0.15, 0.2])
    repeated, _ = follow_beat(0.05, inertia=inertia, targets=[0.1, 0.15, 3 * 0.05, 0.2])
    agree(len(repeated) == len(expected), (len(repeated), len(expected)))
    small(np.abs(repeated / expected - 1.0).max(), 1e-12)


def test_restart_repeats_a_step_that_was_solved_roughly(tmp_path):
    """It begins with the history before the step, as in a run without interruption.

    Rates of the Windkessel belong to one step: solved twice, it would fill twice.
    """
    whole = tmp_path / "whole"
    parts = tmp_path / "parts"
    checkpoint_of_whole = Checkpoint(whole, COMM)  # so that rough solves begin alike
    expected, history = follow_beat(
        0.04, targets=[0.08, 0.2], checkpoint=checkpoint_of_whole, rtol=1e-2
    )

    def interrupt(number):
        if number == 3:
            raise InterruptedError

    with raises(InterruptedError, ""):
        follow_beat(
            0.04, targets=[0.2], after_step=interrupt, checkpoint=Checkpoint(parts, COMM), rtol=1e-2
        )
    checkpoint = Checkpoint(parts, COMM, restart=True)
    continued, continued_history = follow_beat(
        0.04, targets=[0.08, 0.2], checkpoint=checkpoint, rtol=1e-2
    )
    agree(continued[0, 0] == 0.08, continued[:, 0])
    small(np.abs(continued / expected[-len(continued) :] - 1.0).max(), 1e-7)
    small(np.abs(continued_history / history - 1.0).max(), 1e-7)
