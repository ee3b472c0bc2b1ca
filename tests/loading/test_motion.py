# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Motions satisfy the generalised-α equations and closed forms, and restart exactly."""

from __future__ import annotations

import math

import numpy as np
import pytest
from collective import COMM, agree, equal, norm, raises, small, uniform
from problems import cube, dirichlet, free_residual, left, owned
from walls import Wall, tube, wall

import dolfinx
import ufl

from dolfinx_feti import ConvergenceError, NonlinearProblem, kinematics, materials, supports
from dolfinx_feti.loading import (
    Checkpoint,
    Motion,
    Steps,
    TimeStep,
    TimeSteps,
    follow_load,
    follow_time,
)

DENSITY = 1e-6  # kg/mm³
END = 4e-4  # s


def soft(u: dolfinx.fem.Function):
    """Return the energy of a soft, compressible body."""
    F = kinematics.deformation_gradient(u)
    J = kinematics.jacobian(F)
    return materials.neo_hookean(F.T * F, c=3.0, J=J) + materials.volumetric(J, 10.0)


class Swinging:
    """A block that is clamped at one face and begins with a velocity."""

    def __init__(self, *, rho: float = 0.8) -> None:
        mesh = cube(3, 2)
        V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (3,)))
        self.u = dolfinx.fem.Function(V)
        v = ufl.TestFunction(V)
        self.t = dolfinx.fem.Constant(mesh, 0.0)
        dx = ufl.dx(metadata={"quadrature_degree": 4})
        self.elastic = soft(self.u) * dx
        self.forces = 10.0 * self.t / END * v[1] * dx  # kPa/mm
        self.motion = Motion(self.u, DENSITY, rho=rho)
        energy = self.elastic - ufl.action(self.forces, self.u) + self.motion.inertia
        self.problem = NonlinearProblem(
            energy,
            self.u,
            bcs=[dirichlet(V, left)],
            subdomains=4,
            quadrature_degree=4,
            petsc_options={"snes_rtol": 1e-11, "ksp_rtol": 1e-10},
        )
        self.motion.velocity.interpolate(lambda x: 100.0 * np.stack([0 * x[0], x[0], 0 * x[0]]))

    def follow(self, steps: TimeSteps, *, start: float = 0.0):
        return follow_time(
            self.problem,
            self.motion,
            lambda t: setattr(self.t, "value", t - start),
            [start + END],
            steps,
            start=start,
            energy=self.elastic,
            forces=self.forces,
        )


def moving_wall(
    degree: int, rho: float = 0.8, dashpot: float = 0.0
) -> tuple[Wall, Motion, NonlinearProblem]:
    """Return a quarter tube with inertia and dashpots in its volume, its Motion and its problem."""
    body = wall(tube(quarter=True, around=3, along=1), quarter=True, degree=degree)
    u = body.u
    motion = Motion(body.u, DENSITY, rho=rho)
    v = ufl.TestFunction(u.function_space)
    extra = ufl.derivative(motion.inertia, u, v)
    extra += dashpot * ufl.inner(motion.rate, v) * ufl.dx(u.function_space.mesh)
    problem = NonlinearProblem(
        [body.F_u + extra, body.F_p],
        u,
        bcs=body.bcs,
        J=body.J + ufl.derivative(extra, u),
        condense=body.p,
        subdomains=4,
        petsc_options={"snes_rtol": 1e-12, "ksp_rtol": 1e-10},
    )
    return body, motion, problem


def fixed(dt: float) -> TimeSteps:
    """Return time steps of one length."""
    return TimeSteps(first=dt, least=dt / 8.0)


@pytest.mark.processes(1, 2)
def test_pulsating_tube_satisfies_the_generalised_alpha_equations():
    """In a pulsating tube with dashpots each generalised-α equation holds, assembled by dolfinx."""
    dt = 5e-5
    dashpot = 5e-3
    rho = 0.8
    body, motion, problem = moving_wall(2, rho, dashpot)
    u = body.u
    rate = motion.velocity
    ü = motion.acceleration
    a = motion.algorithmic_acceleration
    v = ufl.TestFunction(u.function_space)
    balance = body.F_u + ufl.inner(DENSITY * ü + dashpot * rate, v) * ufl.dx
    p_scale = ufl.inner(1.0, ufl.TestFunction(body.p.function_space)) * ufl.dx
    α_m = (2 * rho - 1) / (rho + 1)
    α_f = rho / (rho + 1)
    γ = 0.5 - α_m + α_f
    β = 0.25 * (1 - α_m + α_f) ** 2
    states = [[f.x.array.copy() for f in (u, rate, ü, a)]]

    def look(step: TimeStep) -> None:
        small(np.divide(*free_residual(balance, body.bcs)), 1e-8)
        small(free_residual(body.F_p, [])[0] / free_residual(p_scale, [])[0], 1e-10)
        states.append([f.x.array.copy() for f in (u, rate, ü, a)])
        (un, vn, ün, an), (u1, v1, ü1, a1) = states[-2:]
        equal(u1, un + dt * vn + dt**2 * ((0.5 - β) * an + β * a1), 1e-10)
        equal(v1, vn + dt * ((1 - γ) * an + γ * a1), 1e-10)
        equal((1 - α_m) * a1 + α_m * an, (1 - α_f) * ü1 + α_f * ün, 1e-10)

    def set_time(t: float) -> None:
        body.load.value = 5.0 * math.sin(math.pi * t / (8 * dt)) ** 2  # kPa

    follow_time(problem, motion, set_time, [6 * dt], fixed(dt), on_step=look)
    agree(len(states) == 7 and norm(owned(u)) > 0.01)


@pytest.mark.serial
@pytest.mark.parametrize("rho", [1.0, 0.0])
def test_second_order_and_balance(rho):
    """Halving Δt divides the errors of u by four, and the energy balance converges as well."""
    found = []
    lost = []
    for n in (8, 16, 32):
        block = Swinging(rho=rho)
        begun = block.motion.kinetic_energy()
        steps = block.follow(fixed(END / n))
        found.append(owned(block.u))
        work = sum(step.work for step in steps)
        lost.append(abs(begun + work - steps[-1].kinetic - steps[-1].stored) / begun)
    ratio = np.linalg.norm(found[0] - found[1]) / np.linalg.norm(found[1] - found[2])
    agree(3.2 < ratio < 4.8)
    agree(lost[2] < lost[0] / 10.0, lost)


@pytest.mark.parametrize("rho", [1.0, 0.8, 0.0])
def test_estimated_error_of_a_step(rho):
    """The estimated error is exact for u = j t³/6, a linear acceleration from rest."""
    dt = 0.1
    j = np.array([3.0, -4.0, 12.0])
    u = dolfinx.fem.Function(dolfinx.fem.functionspace(cube(3, 1), ("Lagrange", 1, (3,))))
    motion = Motion(u, DENSITY, rho=rho)
    motion.begin_step(dt)
    α_m = (2 * rho - 1) / (rho + 1)
    α_f = rho / (rho + 1)
    β = 0.25 * (1 - α_m + α_f) ** 2
    by_newmark = β * dt**2 * j * dt  # a is zero at the beginning, and j Δt at the end
    u.x.array[:] = np.tile(by_newmark, len(u.x.array) // 3)
    exact = j * dt**3 / 6
    equal(motion.error_of_step(), np.abs(by_newmark - exact).max(), 1e-12)


def body(n: int, degree: int) -> tuple[dolfinx.fem.Function, ufl.Form]:
    """Return the displacement of a soft cube, and its energy."""
    u = dolfinx.fem.Function(dolfinx.fem.functionspace(cube(3, n), ("Lagrange", degree, (3,))))
    return u, soft(u) * ufl.dx


def test_initial_acceleration():
    """A body at rest under a load per mass of g begins with the acceleration g."""
    u, energy = body(2, 2)
    motion = Motion(u, DENSITY)
    energy += DENSITY * 9810.0 * u[2] * ufl.dx + motion.inertia
    motion.balance(NonlinearProblem(energy, u, quadrature_degree=4, subdomains=4).F, [])
    uniform(motion.acceleration.x.array.reshape(-1, 3) / 9810.0, [0.0, 0.0, -1.0], 1e-10)


@pytest.mark.processes(1, 2)
@pytest.mark.parametrize(("eta", "tolerance"), [(0.0, 1e-8), (1e-3, 1e-3)])  # kPa s/mm²
def test_dashpots_slow_a_free_body_exponentially(eta, tolerance):
    """The velocity of a free rigid body with dashpots decays as e^{−ηt/ρ}.

    The dashpot dissipates what ½ ρ v² loses. With a mass no subdomain has a kernel.
    """
    u, energy = body(2, 1)
    motion = Motion(u, DENSITY)
    v = ufl.TestFunction(u.function_space)
    residual = ufl.derivative(energy + motion.inertia, u, v)
    residual += eta * ufl.inner(motion.rate, v) * ufl.dx(u.function_space.mesh)
    problem = NonlinearProblem(residual, u, quadrature_degree=2, subdomains=4)
    start = np.array([3.0, -2.0, 0.0])
    end = 1e-3
    motion.velocity.interpolate(lambda x: np.outer(start, np.ones_like(x[0])))
    steps = follow_time(problem, motion, lambda t: None, [end], fixed(2.5e-5))
    left = math.exp(-eta * end / DENSITY)
    way = end if eta == 0.0 else DENSITY / eta * (1.0 - left)
    uniform(u.x.array.reshape(-1, 3) / way, start, tolerance)
    uniform(motion.velocity.x.array.reshape(-1, 3), left * start, 3.0 * tolerance)
    taken = sum(step.dissipated for step in steps)
    begun = DENSITY / 2.0 * start @ start
    small(taken / begun - (1.0 - left**2), tolerance)
    small((taken + steps[-1].kinetic) / begun - 1.0, tolerance)


@pytest.mark.parametrize("inertia", [True, False])
def test_dashpots_with_one_last_displacement(inertia):
    """Two dashpots with one last displacement act as one with the sum of their viscosities."""
    ends = []
    for viscosities in ([0.5], [0.2, 0.3]):
        u, energy = body(2, 1)
        V = u.function_space
        mesh = u.function_space.mesh
        last = dolfinx.fem.Function(V)
        push = dolfinx.fem.Constant(mesh, 0.0)
        motion = Motion(u, 1e-3)
        energy -= push * u[0] * ufl.dx
        for eta in viscosities:
            dt = dolfinx.fem.Constant(mesh, 0.1)
            energy += supports.dashpot_energy(eta, u, last, dt, ufl.ds(mesh), "all")
        problem = NonlinearProblem(
            energy + motion.inertia if inertia else energy,
            u,
            bcs=[dirichlet(V, left)],
            quadrature_degree=2,
            subdomains=2,
            petsc_options={"snes_rtol": 1e-12, "ksp_rtol": 1e-10},
        )

        def set_time(t: float, push=push) -> None:
            push.value = t

        dissipated = []
        if inertia:
            steps = follow_time(problem, motion, set_time, [0.1, 0.3, 0.4], TimeSteps(0.1, 0.01))
            dissipated = [step.dissipated for step in steps]
        else:
            follow_load(problem, set_time, [0.1, 0.2], Steps(0.1, 0.1, 1.0))
        ends.append(np.append(u.x.array, dissipated))
    equal(ends[0], ends[1], 1e-10)


@pytest.mark.processes(1, 2)
def test_adapted_steps():
    """Adapted time steps keep their tolerance and do not depend on rounding of the time."""
    tolerance = 2e-5
    first = END / 2
    lengths = TimeSteps(first=first, least=END / 512, longest=END, tolerance=tolerance)
    paths = [Swinging().follow(lengths, start=share * END) for share in (0.0, 0.3, 1.7)]
    for steps in paths:
        agree(max(step.error for step in steps) <= tolerance)
        agree(sum(step.failures for step in steps) >= 1)
        agree(max(s.increment for s in steps) > 1.2 * min(s.increment for s in steps))
        equal([s.increment for s in steps], [s.increment for s in paths[0]], 1e-6)


@pytest.mark.processes(1, 2)
def test_no_step_is_short_enough():
    """If the least time step is too inaccurate, the path raises with state and time unchanged."""
    block = Swinging()
    before = owned(block.u).copy()
    with raises(ConvergenceError, r"is the least allowed. A step of .* estimated error"):
        block.follow(TimeSteps(first=END, least=END / 2, tolerance=1e-12))
    equal(owned(block.u), before, 0.0)
    small(float(block.t.value), 0.0)


def test_restart(tmp_path):
    """With a condensed pressure, a restarted motion repeats the steps and end of one run."""
    ends = []
    dt = 5e-5
    for legs in ([4], [2, 4, 4]):  # the last one has nothing left to do
        for i, end in enumerate(legs):
            body, motion, problem = moving_wall(1)
            checkpoint = Checkpoint(tmp_path / f"{len(legs)}", COMM, restart=i > 0)
            found = follow_time(
                problem,
                motion,
                lambda t, load=body.load: setattr(load, "value", 5.0 * t / dt),
                [n * dt for n in range(1, end + 1)],
                fixed(dt),
                checkpoint=checkpoint,
            )
        agree([round(step.load / dt) for step in found] == [1, 2, 3, 4], found)
        fields = body.u, body.p, motion.velocity, motion.acceleration
        begun = [step.history[0].residual for step in found]
        ends.append([*map(owned, fields), [step.kinetic for step in found], begun])
    for one, other in zip(*ends, strict=True):
        agree(np.abs(one).max(initial=0.0) > 0.0)
        equal(other, one, 1e-10)
