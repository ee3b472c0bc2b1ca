# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Motion: the generalised-α method beside MUMPS, closed forms, and its own restart."""

from __future__ import annotations

import math

import numpy as np
import pytest
from collective import COMM, agree, equal, raises, small, uniform
from newton_by_hand import newton_by_hand
from problems import cube, dirichlet, left, owned
from walls import symmetric, tube, wall

import basix.ufl
import dolfinx
import ufl

from dolfinx_feti import ConvergenceError, NonlinearProblem, kinematics, materials, supports
from dolfinx_feti.loading import Checkpoint, Motion, Steps, TimeSteps, follow_load, follow_time

DENSITY = 1e-6  # kg/mm³
END = 4e-4  # s


def soft(u: dolfinx.fem.Function):
    """The energy of a soft, compressible body."""
    F = kinematics.deformation_gradient(u)
    J = kinematics.jacobian(F)
    return materials.neo_hookean(F.T * F, c=3.0, J=J) + materials.volumetric(J, 10.0)


class Swinging:
    """A block that is held at one face and begins to move."""

    def __init__(self, *, rho: float = 0.8) -> None:
        self.mesh = cube(3, 2)
        V = dolfinx.fem.functionspace(self.mesh, ("Lagrange", 2, (3,)))
        self.u, v = dolfinx.fem.Function(V, name="u"), ufl.TestFunction(V)
        self.t = dolfinx.fem.Constant(self.mesh, 0.0)
        dx = ufl.dx(metadata={"quadrature_degree": 4})
        self.elastic = soft(self.u) * dx
        self.forces = 10.0 * self.t / END * v[1] * dx  # kPa/mm
        self.motion = Motion(self.u, DENSITY, rho=rho)
        load = ufl.action(self.forces, self.u)
        self.bcs = [dirichlet(V, left)]
        self.problem = NonlinearProblem(
            self.elastic - load + self.motion.inertia,
            self.u,
            bcs=self.bcs,
            subdomains=4,
            quadrature_degree=4,
            petsc_options={"snes_rtol": 1e-11, "ksp_rtol": 1e-10},
        )
        self.motion.velocity.interpolate(lambda x: 100.0 * np.stack([0 * x[0], x[0], 0 * x[0]]))

    def set_time(self, t: float) -> None:
        self.t.value = t

    def follow(self, steps: TimeSteps):
        return follow_time(
            self.problem, self.motion, self.set_time, [END], steps,
            energy=self.elastic, forces=self.forces,
        )  # fmt: skip


def fixed(dt: float) -> TimeSteps:
    return TimeSteps(first=dt, least=dt / 8.0)


@pytest.mark.processes(1, 2)
def test_pulse_beside_dolfinx():
    """A pulse in the quarter of a tube, with dashpots outside: FETI, and dolfinx alone.

    There the whole wall has one matrix, of u and p, and the generalised-α method is written anew.
    """
    steps, dt, dashpot = 6, 5e-5, 5e-3
    body = wall(tube(quarter=True, around=3, along=1), quarter=True)
    mesh, V = body.u.function_space.mesh, body.u.function_space
    v = ufl.TestFunction(V)

    def set_time(t: float) -> None:
        body.load.value = 5.0 * math.sin(math.pi * t / (8 * dt)) ** 2  # kPa

    motion = Motion(body.u, DENSITY)
    extra = ufl.derivative(motion.inertia, body.u, v)
    extra += dashpot * ufl.inner(motion.rate, v) * ufl.dx
    problem = NonlinearProblem(
        [body.F_u + extra, body.F_p],
        body.u,
        bcs=body.bcs,
        J=body.J + ufl.derivative(extra, body.u, ufl.TrialFunction(V)),
        condense=body.p,
        subdomains=4,
        petsc_options={"snes_rtol": 1e-11, "ksp_rtol": 1e-10},
    )
    follow_time(problem, motion, set_time, [steps * dt], fixed(dt))

    element = basix.ufl.mixed_element([V.ufl_element(), body.p.function_space.ufl_element()])
    W = dolfinx.fem.functionspace(mesh, element)
    w, (v1, q1) = dolfinx.fem.Function(W), ufl.TestFunctions(W)
    u1, p1 = ufl.split(w)
    un, vn, an, ün = (dolfinx.fem.Function(V) for _ in range(4))
    rho = 0.8
    α_m, α_f = (2 * rho - 1) / (rho + 1), rho / (rho + 1)
    γ, β = 0.5 - α_m + α_f, 0.25 * (1 - α_m + α_f) ** 2
    a1 = (u1 - un - dt * vn - dt**2 * (0.5 - β) * an) / (β * dt**2)
    v_next = vn + dt * ((1 - γ) * an + γ * a1)
    ü = ((1 - α_m) * a1 + α_m * an - α_f * ün) / (1 - α_f)
    known = {body.u: u1, body.p: p1, v: v1, ufl.TestFunction(body.p.function_space): q1}
    whole = ufl.replace(body.F_u + body.F_p, known)
    whole += DENSITY * ufl.inner(ü, v1) * ufl.dx
    whole += dashpot * ufl.inner(v_next, v1) * ufl.dx
    bcs = symmetric(W.sub(0))
    for n in range(steps):
        set_time((n + 1) * dt)
        newton_by_hand(whole, w, bcs)
        new = dolfinx.fem.Function(V)
        new.interpolate(w.sub(0).collapse())
        u, x, y, z = (f.x.array for f in (new, un, vn, an))
        a = (u - x - dt * y - dt**2 * (0.5 - β) * z) / (β * dt**2)
        y += dt * ((1 - γ) * z + γ * a)
        ün.x.array[:] = ((1 - α_m) * a + α_m * z - α_f * ün.x.array) / (1 - α_f)
        x[:], z[:] = u, a
    scale = COMM.allreduce(float(np.abs(un.x.array).max()), op=max)
    agree(scale > 0.01, scale)
    small(np.abs(body.u.x.array - un.x.array).max() / scale, 1e-8)
    scale = COMM.allreduce(float(np.abs(vn.x.array).max()), op=max)
    small(np.abs(motion.velocity.x.array - vn.x.array).max() / scale, 1e-7)


@pytest.mark.serial
@pytest.mark.parametrize("rho", [1.0, 0.0])
def test_second_order_and_balance(rho):
    """Halving Δt divides errors by four, and what lacks in the balance of energies, too."""
    found, lost = [], []
    for n in (8, 16, 32):
        block = Swinging(rho=rho)
        begun = block.motion.kinetic_energy()
        steps = block.follow(fixed(END / n))
        found.append(owned(block.u))
        work = sum(step.work for step in steps)
        lost.append(abs(begun + work - steps[-1].kinetic - steps[-1].stored) / begun)
    ratio = np.linalg.norm(found[0] - found[1]) / np.linalg.norm(found[1] - found[2])
    agree(3.2 < ratio < 4.8, ratio)
    agree(lost[2] < lost[0] / 10.0, lost)


@pytest.mark.processes(1, 2)
def test_free_flight():
    """Without forces a free body keeps its velocity; with a mass no subdomain has a kernel."""
    mesh = cube(3, 2)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    u = dolfinx.fem.Function(V)
    psi = soft(u)
    motion = Motion(u, DENSITY)
    problem = NonlinearProblem(psi * ufl.dx + motion.inertia, u, quadrature_degree=2, subdomains=4)
    motion.velocity.interpolate(lambda x: np.stack([3.0 + 0 * x[0], -2.0 + 0 * x[0], 0 * x[0]]))
    follow_time(problem, motion, lambda t: None, [1e-2], fixed(2.5e-3))
    uniform(u.x.array[0::3], 0.03, 1e-8)
    uniform(u.x.array[1::3], -0.02, 1e-8)
    uniform(motion.velocity.x.array[0::3], 3.0, 1e-6)


def test_initial_acceleration():
    """A body at rest under a load per mass of g begins with g."""
    mesh = cube(3, 2)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (3,)))
    u = dolfinx.fem.Function(V)
    psi = soft(u)
    motion = Motion(u, DENSITY)
    energy = (psi + DENSITY * 9810.0 * u[2]) * ufl.dx
    problem = NonlinearProblem(energy + motion.inertia, u, quadrature_degree=4, subdomains=4)
    motion.start(problem.F, [])
    uniform(motion.acceleration.x.array[2::3], -9810.0, 1e-6)
    uniform(motion.acceleration.x.array[0::3], 0.0, 1e-6)


@pytest.mark.processes(1, 2)
def test_damping():
    """A dashpot under all of a rigid body: v falls as e^{−ηt/ρ}, and takes ½ ρ v² with it."""
    mesh = cube(3, 1)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    u, v = dolfinx.fem.Function(V), ufl.TestFunction(V)
    psi = soft(u)
    motion = Motion(u, DENSITY)
    eta = 1e-3  # kPa s/mm²
    residual = ufl.derivative(psi * ufl.dx + motion.inertia, u, v)
    residual += eta * ufl.inner(motion.rate, v) * ufl.dx
    problem = NonlinearProblem(residual, u, quadrature_degree=2, subdomains=2)
    motion.velocity.interpolate(lambda x: np.stack([1.0 + 0 * x[0], 0 * x[0], 0 * x[0]]))
    steps = follow_time(problem, motion, lambda t: None, [1e-3], fixed(2.5e-5))
    uniform(motion.velocity.x.array[0::3], math.exp(-1.0), 1e-3)
    taken = sum(step.dissipated for step in steps)
    small(taken / (DENSITY / 2.0 * (1.0 - math.exp(-2.0))) - 1.0, 1e-3)
    small(taken / (DENSITY / 2.0 - steps[-1].kinetic) - 1.0, 1e-3)


@pytest.mark.parametrize("inertia", [True, False])
def test_dashpots_with_one_last_displacement(inertia):
    """Two surfaces, two time steps, one last displacement: both resist as one with both does."""
    ends = []
    for together in (True, False):
        mesh = cube(3, 2)
        V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (3,)))
        u, last = dolfinx.fem.Function(V), dolfinx.fem.Function(V)
        psi = soft(u)
        push = dolfinx.fem.Constant(mesh, 0.0)
        motion = Motion(u, 1e-3)
        energy = (psi - push * u[0]) * ufl.dx
        if inertia:
            energy += motion.inertia
        dts = [dolfinx.fem.Constant(mesh, 0.1) for _ in range(2)]
        ds = ufl.ds(mesh)
        if together:
            energy += supports.dashpot_energy(0.5, u, last, dts[0], ds, "all")
        else:
            for eta, dt in zip((0.2, 0.3), dts, strict=True):
                energy += supports.dashpot_energy(eta, u, last, dt, ds, "all")
        problem = NonlinearProblem(
            energy, u, bcs=[dirichlet(V, left)], quadrature_degree=2, subdomains=2,
            petsc_options={"snes_rtol": 1e-12, "ksp_rtol": 1e-10},
        )  # fmt: skip

        def set_time(t: float, push=push) -> None:
            push.value = t

        if inertia:
            steps = follow_time(problem, motion, set_time, [0.1, 0.3, 0.4], TimeSteps(0.1, 0.01))
            ends.append(np.append(u.x.array, [step.dissipated for step in steps]))
        else:
            follow_load(problem, set_time, [0.1, 0.2], Steps(0.1, 0.1, 1.0))
            ends.append(u.x.array.copy())
    equal(ends[0], ends[1], 1e-10)


@pytest.mark.processes(1, 2)
def test_adapted_steps():
    """Each step keeps its tolerance, and the lengths vary."""
    block = Swinging()
    tolerance = 2e-5
    steps = block.follow(
        TimeSteps(first=END / 2, least=END / 512, longest=END, tolerance=tolerance)
    )
    agree(max(step.error for step in steps) <= tolerance and steps[-1].load == END)
    agree(sum(step.failures for step in steps) >= 1)
    agree(max(s.increment for s in steps) > 1.2 * min(s.increment for s in steps))


@pytest.mark.processes(1, 2)
def test_no_step_is_short_enough():
    block = Swinging()
    before = owned(block.u).copy()
    with raises(ConvergenceError, r"is the least allowed. A step of .* estimated error"):
        block.follow(TimeSteps(first=END, least=END / 2, tolerance=1e-12))
    equal(owned(block.u), before, 0.0)
    small(float(block.t.value), 0.0)


def test_restart(tmp_path):
    """With a condensed pressure, a run that goes on has the steps of one run, and its end."""
    ends, dt = [], 5e-5
    for legs in ([4], [2, 4, 4]):  # the last one has nothing left to do
        for i, end in enumerate(legs):
            body = wall(tube(quarter=True, around=3, along=1), quarter=True, degree=1)
            motion, v = Motion(body.u, DENSITY), ufl.TestFunction(body.u.function_space)
            inertia = ufl.derivative(motion.inertia, body.u, v)
            problem = NonlinearProblem(
                [body.F_u + inertia, body.F_p], body.u, bcs=body.bcs, condense=body.p,
                subdomains=4, petsc_options={"snes_rtol": 1e-12, "ksp_rtol": 1e-10},
            )  # fmt: skip
            checkpoint = Checkpoint(tmp_path / f"{len(legs)}", COMM, restart=i > 0)
            found = follow_time(
                problem, motion, lambda t, load=body.load: setattr(load, "value", 5.0 * t / dt),
                [n * dt for n in range(1, end + 1)], fixed(dt), checkpoint=checkpoint,
            )  # fmt: skip
        agree([round(step.load / dt) for step in found] == [1, 2, 3, 4], found)
        fields = body.u, body.p, motion.velocity, motion.acceleration
        begun = [step.history[0].residual for step in found]
        ends.append([*map(owned, fields), [step.kinetic for step in found], begun])
    for one, other in zip(*ends, strict=True):
        agree(np.abs(one).max(initial=0.0) > 0.0)
        equal(other, one, 1e-10)
