# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Cavities with prescribed volumes: through a limit point, in any units, by arc length."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np
import pytest
from collective import agree, equal, logged_messages, raises, small
from inflated import balloon, balloon_cavity, balloon_pressure, create_rubber_body
from problems import dirichlet

import dolfinx

from dolfinx_feti import ConvergenceError, NonlinearProblem
from dolfinx_feti.loading import Steps, follow_load
from dolfinx_feti.mechanics.loads import pressure_potential
from dolfinx_feti.scalars import ArcLength, Cavity

STRETCHES = [1.2, 1.38, 1.43, 1.6, 1.9, 2.2, 2.5]


def inflate(ball, stretches, **options):
    """Return the pressure at each stretch, (stretches,), and the number of Newton steps."""
    cavity = balloon_cavity(ball)
    rest = cavity.present_volume()
    problem = ball.problem([cavity], **options)
    pressures = []
    steps = 0
    for stretch in stretches:
        cavity.volume.value = rest * stretch**3
        problem.solve()
        steps += len(problem.history)
        pressures.append(float(cavity.pressure.value))
        small(abs(cavity.present_volume() / cavity.volume.value - 1.0), 1e-8)
    return np.array(pressures), steps


def test_balloon_follows_the_exact_pressure_through_its_limit_point():
    """The pressure grows up to a stretch of 1.426 and falls then; every step converges."""
    pressures, steps = inflate(balloon(), STRETCHES)
    exact = np.array([balloon_pressure(stretch) for stretch in STRETCHES])
    small(np.abs(pressures / exact - 1.0).max(), 5e-3)
    agree(pressures.argmax() in (1, 2) and steps <= 60, (pressures, steps))


@pytest.mark.parametrize("stiffness", [1.0, 1e9])
def test_residual_that_is_only_rounding_causes_no_warning(caplog, stiffness):
    """A new volume begins at an equilibrium, whose residual is no force of the problem."""
    ball = balloon(3, stiffness=stiffness, kappa=1e6)
    with caplog.at_level(logging.WARNING, "dolfinx_feti"):
        inflate(ball, [1.1, 1.2, 1.3, 1.4], petsc_options={"snes_rtol": 1e-13})
    warnings = logged_messages(caplog)
    agree(not warnings, warnings)


@pytest.mark.parametrize("form", ["dual", "primal"])
def test_both_formulations_give_the_same_pressures(form):
    """On both sides of the limit point and close to it; far behind it K is indefinite."""
    stretches = [1.2, 1.35, 1.425, 1.5, 1.7, 2.0]
    options = {"feti_formulation": form, "snes_rtol": 1e-10}
    pressures, _ = inflate(balloon(3), stretches, petsc_options=options)
    expected, _ = inflate(balloon(3), stretches, petsc_options={"snes_rtol": 1e-10})
    equal(pressures, expected, 1e-6)


@pytest.mark.parametrize(("unit", "stiffness"), [(1e-3, 1.0), (1e3, 1e-6), (1.0, 1e9)])
def test_pressures_scale_with_units_and_steps_do_not(unit, stiffness):
    """Volumes scale by the cube of the length, pressures by the stiffness."""
    far = {"snes_rtol": 1e-6}  # from all residuals: 4e-7 and 1e-10 of the last ones, for 1e-8
    expected, steps = inflate(balloon(3), [1.2, 1.35], petsc_options=far)
    ball = balloon(3, unit=unit, stiffness=stiffness)
    pressures, others = inflate(ball, [1.2, 1.35], petsc_options=far)
    equal(pressures / stiffness, expected, 1e-8)
    agree(steps == others, (steps, others))


def test_volume_out_of_reach_does_not_converge():
    """Newton's method fails as usual for a radius of 40 times the present one."""
    ball = balloon(2)
    problem = ball.problem([balloon_cavity(ball, 40.0)], petsc_options={"snes_max_it": 6})
    with raises(ConvergenceError, "did not converge"):
        problem.solve()


@pytest.mark.parametrize("volume", [0.0, -1.0, np.nan])
def test_volume_must_be_positive(volume):
    """The value is set by the user between two solves, so that the solve has to check it."""
    ball = balloon(2)
    cavity = balloon_cavity(ball, 1.1)
    problem = ball.problem([cavity])
    cavity.volume.value = volume
    with raises(ValueError, rf"volume = {volume}: give a positive number"):
        problem.solve()


def test_volume_must_depend_on_a_free_dof():
    """The inner surface is fixed."""
    ball = balloon(2)
    fixed = dirichlet(ball.u.function_space, lambda x: np.linalg.norm(x, axis=0) < 1.01)
    problem = replace(ball, bcs=[*ball.bcs, fixed]).problem([balloon_cavity(ball, 1.1)])
    with raises(ValueError, "depend neither on a free dof of u"):
        problem.solve()


def test_cavity_must_have_the_inner_surface():
    """With the outer surface, whose normals point away, the volume is negative."""
    mesh = balloon(2).u.function_space.mesh
    outer = create_rubber_body(mesh, [], [lambda x: np.linalg.norm(x, axis=0) > 1.09])
    with raises(ValueError, "not positive: give the inner surface"):
        Cavity(outer.u, outer.ds(1), volume=1.0)


def test_arc_length_passes_the_limit_point():
    """All steps of `follow_load` lie on the exact curve, and none fails."""
    ball = balloon()
    pressure = dolfinx.fem.Constant(ball.u.function_space.mesh, 0.0)
    arc = ArcLength(ball.u, pressure)
    problem = NonlinearProblem(
        ball.energy + pressure_potential(pressure, ball.u, ball.ds(1)),
        ball.u,
        bcs=ball.bcs,
        condense=ball.p,
        subdomains=6,
        quadrature_degree=4,
        scalars=[arc],
    )
    volume = Cavity(ball.u, ball.ds(1))
    curve = []
    rest = volume.present_volume()

    def record(step):
        curve.append((np.cbrt(volume.present_volume() / rest), float(pressure.value)))

    steps = follow_load(
        problem, lambda s: None, [1.0], Steps(first=0.04, least=1e-3), on_step=record
    )
    stretches, pressures = np.transpose(curve)
    agree(stretches[-1] > 2.5 and not any(step.failures for step in steps), (stretches, steps))
    exact = np.array([balloon_pressure(stretch) for stretch in stretches])
    small(np.abs(pressures / exact - 1.0).max(), 5e-3)
    agree(len(steps) < 20)
