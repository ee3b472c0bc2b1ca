# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A block whose motion is one scalar: memory, dashpots, a moving base, pressure, inertia, a plate.

The block fills the unit cube, moves only along x, and has one cell in this direction. If its base
is at u = g and its other face at u = s, the stretch is 1 + s − g everywhere. :class:`Block`
computes the motion by finite elements. :class:`Scalar` makes the same steps for the scalar s alone,
and :func:`exact` integrates its differential equation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from mpi4py import MPI

import numpy as np
import scipy.integrate
import scipy.optimize
from problems import right, tagged

import basix.ufl
import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, kinematics, materials, supports
from dolfinx_feti.contact import Contact, half_space
from dolfinx_feti.loading import Motion, Steps, TimeSteps, follow_load, follow_time
from dolfinx_feti.mechanics import memory

C1 = 1.0  # c of the neo-Hookean energy [kPa]
KAPPA = 3.0  # stiffness of the volumetric energy [kPa]
TAU = 0.3  # relaxation time of the Maxwell branch [s]
DENSITY = 0.05  # mass per reference volume [kg/mm³]


@dataclass(frozen=True)
class Law:
    """Material, loads and supports of a sequence of steps; the default of each leaves it out."""

    inertia: float | None = None  # ρ_∞ of the motion; None for equilibria
    share: float = 0.0  # β of the Maxwell branch
    viscosity: float = 0.0  # of the dashpots on the face [kPa s/mm]
    base: float = 0.0  # amplitude of the motion of the base [mm]
    pressure: float = 0.0  # amplitude of the pressure on the face [kPa]
    stop: float | None = None  # displacement at which the face meets a plate; None without one

    def g(self, t: float) -> float:
        """Displacement of the base [mm]."""
        return self.base * math.sin(2.0 * t) ** 2

    def p(self, t: float) -> float:
        """Pressure on the other face [kPa]."""
        return self.pressure * (0.5 * t + math.sin(3.0 * t))


def slope(stretch: float) -> float:
    """Return ∂Ψ̄/∂λ of ½ c (Ī₁ − 3) under F = diag(λ, 1, 1) [kPa]."""
    return 2.0 * C1 / 3.0 * (stretch ** (1.0 / 3.0) - stretch ** (-5.0 / 3.0))


@dataclass
class Scalar:
    """The same steps by hand; entry 0 of u, v, ü and a is the base, entry 1 the face."""

    law: Law
    t: float = 0.0
    u: np.ndarray = field(default_factory=lambda: np.zeros(2))
    v: np.ndarray = field(default_factory=lambda: np.zeros(2))
    ü: np.ndarray = field(default_factory=lambda: np.zeros(2))
    a: np.ndarray = field(default_factory=lambda: np.zeros(2))  # algorithmic acceleration
    S: float = 0.0  # second Piola stress without the overstress
    Q: float = 0.0  # overstress of the Maxwell branch
    seen: float = 0.0  # largest stretch so far
    contact: float = 0.0  # force of the plate on the face
    h: float = 0.0  # length of the last step
    dissipated: float = 0.0  # work of the dashpots in the last step

    def start(self, h: float) -> None:
        """Compute v, ü and a at the start of a path whose first step has a length of about h."""
        if self.law.inertia is None:
            return
        g = [self.law.g(self.t + x) for x in (0.0, h / 2.0, h)]
        self.v[0] = (4.0 * g[1] - 3.0 * g[0] - g[2]) / h
        self.ü[0] = 4.0 * (g[0] - 2.0 * g[1] + g[2]) / h**2
        force = self._force(self.u, self.v, self.t, self.h)
        force += self.contact
        self.ü[1] = -(force + DENSITY * self.ü[0] / 6.0) / (DENSITY / 3.0)
        self.a = self.ü.copy()
        self.h = 0.0

    def _fading(self, h: float) -> tuple[float, float]:
        return math.exp(-h / TAU), self.law.share * math.exp(-h / (2.0 * TAU))

    def _force(self, u: np.ndarray, v: np.ndarray, t: float, h: float) -> float:
        """Return the force on the face, without inertia, at time t after a step of length h."""
        stretch = 1.0 + u[1] - u[0]
        (fades, δ) = self._fading(h)
        force = (1.0 + δ) * slope(stretch) + (fades * self.Q - δ * self.S) * stretch
        return force + KAPPA * (stretch - 1.0) + self.law.p(t) + self.law.viscosity * v[1]

    def step(self, h: float) -> None:
        """Make a step of length h, by the generalised-α method if the law has inertia."""
        law = self.law
        last = self.u.copy()
        t = self.t + h
        fades, δ = self._fading(h)
        if law.inertia is None:

            def rates(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
                return (u - last) / h, np.zeros(2)

        else:
            ρ = law.inertia
            α_m = (2.0 * ρ - 1.0) / (ρ + 1.0)
            α_f = ρ / (ρ + 1.0)
            γ = 0.5 - α_m + α_f
            β = 0.25 * (1.0 - α_m + α_f) ** 2
            a = self.ü + (h / self.h if self.h > 0.0 else 1.0) * (self.a - self.ü)

            def new_a(u: np.ndarray) -> np.ndarray:
                return (u - last - h * self.v - h**2 * (0.5 - β) * a) / (β * h**2)

            def rates(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
                v = self.v + h * ((1.0 - γ) * a + γ * new_a(u))
                return v, ((1.0 - α_m) * new_a(u) + α_m * a - α_f * self.ü) / (1.0 - α_f)

        def balance(s: float) -> float:
            u = np.array([law.g(t), s])
            v, ü = rates(u)
            return self._force(u, v, t, h) + DENSITY * (ü[1] / 3.0 + ü[0] / 6.0)

        s = scipy.optimize.brentq(balance, last[1] - 0.6, last[1] + 0.6, xtol=1e-15, rtol=1e-14)
        self.contact = 0.0
        if law.stop is not None and s > law.stop:
            s = law.stop
            self.contact = -balance(s)
        self.u = np.array([law.g(t), s])
        v, ü = rates(self.u)
        self.dissipated = law.viscosity * (self.v[1] + v[1]) / 2.0 * (s - last[1])
        if law.inertia is not None:
            self.a = new_a(self.u)
        self.v = v
        self.ü = ü
        self.t = t
        self.h = h
        stretch = 1.0 + s - self.u[0]
        self.seen = max(self.seen, stretch)
        S = slope(stretch) / stretch
        self.Q = fades * self.Q + δ * (S - self.S)
        self.S = S


def exact(law: Law, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Integrate the differential equation of the face, with Q̇ = −Q/τ + β Ṡ.

    Returns:
        Displacement of the face and dissipated work ∫ η v² dt at each of the times.
    """

    def g(t: float, k: int) -> float:
        """g, ġ and g̈."""
        return law.base * (math.sin(2 * t) ** 2, 2 * math.sin(4 * t), 8 * math.cos(4 * t))[k]

    def stress(stretch: float, z: float) -> float:
        S = slope(stretch) / stretch
        force = slope(stretch) + (law.share * S - z) * stretch  # Q = β S − z
        return force + KAPPA * (stretch - 1.0)

    def change(t: float, y: np.ndarray) -> list[float]:
        stretch = 1.0 + y[0] - g(t, 0)
        ż = (law.share * slope(stretch) / stretch - y[1]) / TAU
        force = stress(stretch, y[1]) + law.p(t)
        if law.inertia is None:
            return [-force / law.viscosity, ż, force**2 / law.viscosity]
        force += law.viscosity * y[2]
        ü = -(force + DENSITY * g(t, 2) / 6.0) / (DENSITY / 3.0)
        return [y[2], ż, ü, law.viscosity * y[2] ** 2]

    start = [0.0] * (3 if law.inertia is None else 4)
    solution = scipy.integrate.solve_ivp(
        change, (0.0, times[-1]), start, t_eval=times, rtol=1e-10, atol=1e-12, method="LSODA"
    )
    return solution.y[0], solution.y[-1]


class Block:
    """The block of finite elements, on a communicator."""

    def __init__(self, comm: MPI.Comm, inertia: float | None, *, stopped: bool = False) -> None:
        self.comm = comm
        self.mesh = mesh = dolfinx.mesh.create_box(
            comm, [(0, 0, 0), (1, 1, 1)], (1, 3, 1), dolfinx.mesh.CellType.hexahedron
        )
        V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (3,)))
        self.u = dolfinx.fem.Function(V, name="u")
        self.dt, self.time_step, self.share, self.viscosity, self.g, self.p = (
            dolfinx.fem.Constant(mesh, 0.0) for _ in range(6)
        )
        self.motion = None if inertia is None else Motion(self.u, DENSITY, rho=inertia)
        if self.motion is not None:
            self.dt = self.motion.dt
        W = dolfinx.fem.functionspace(
            mesh, basix.ufl.quadrature_element("hexahedron", value_shape=(3, 3), degree=2)
        )
        self.S = dolfinx.fem.Function(W, name="S")
        self.Q = dolfinx.fem.Function(W, name="Q")
        self.seen = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)), name="seen")
        self.last = dolfinx.fem.Function(V, name="last")
        F = kinematics.deformation_gradient(self.u)
        C = kinematics.right_cauchy_green(F)
        J = kinematics.jacobian(F)
        psi, update = memory.viscoelastic(
            materials.neo_hookean(C, c=C1, J=J),
            F,
            self.S,
            [memory.MaxwellBranch(self.Q, share=self.share, time=TAU)],
            dt=self.dt,
        )
        psi += materials.volumetric(J, KAPPA)
        ds = tagged(mesh, right)(1)
        energy = psi * ufl.dx + self.p * self.u[0] * ds
        viscous = self.viscosity, self.u, self.last, self.time_step
        energy += supports.dashpot_energy(*viscous, ds, "all")
        if self.motion is not None:
            energy += self.motion.inertia

        def held(k: int, value: dolfinx.fem.Constant | float, far: float) -> object:
            part = V.sub(k)
            dofs = dolfinx.fem.locate_dofs_geometrical(
                (part, part.collapse()[0]), lambda x: x[0] < far
            )
            return dolfinx.fem.dirichletbc(value, dofs[0], part)

        self.stop = dolfinx.fem.Constant(mesh, 0.0)
        plate = half_space((-1, 0, 0), (1, 0, 0), offset=-self.stop)
        self.contacts = [Contact(self.u, ds, plate)] if stopped else []
        self.problem = NonlinearProblem(
            ufl.derivative(energy, self.u, ufl.TestFunction(V)),
            self.u,
            bcs=[held(0, self.g, 0.5), held(1, 0.0, 2.0), held(2, 0.0, 2.0)],
            subdomains=3,
            quadrature_degree=2,
            contacts=self.contacts,
            contact_tolerance=1e-13,
            internal_variables=update | {self.seen: ufl.max_value(self.seen, F[0, 0])},
            petsc_options={"snes_rtol": 1e-13, "snes_atol": 1e-14, "ksp_rtol": 1e-8},
        )
        x = V.tabulate_dof_coordinates()
        self._face = 3 * np.flatnonzero(np.isclose(x[:, 0], 1.0))

    def reset(self, law: Law, value: float = 0.0) -> None:
        """Set all values that a step changes to ``value``, and the parameters to those of a law."""
        changing = [self.u, self.S, self.Q, self.seen, self.last]
        changing += [] if self.motion is None else self.motion.histories
        changing += [contact.multiplier for contact in self.contacts]
        for f in changing:
            f.x.array[:] = value
        self.dt.value = value
        for constant in (self.g, self.p):
            constant.value = value
        self.time_step.value = np.inf
        self.share.value = law.share
        self.viscosity.value = law.viscosity
        if law.stop is not None:
            self.stop.value = law.stop

    def ends(self, values: np.ndarray) -> tuple[float, float]:
        """Return the least and the largest of all values."""
        least = self.comm.allreduce(float(values.min(initial=np.inf)), op=MPI.MIN)
        return least, self.comm.allreduce(float(values.max(initial=-np.inf)), op=MPI.MAX)

    def face(self) -> tuple[float, float]:
        """Return the least and the largest displacement of the face."""
        return self.ends(self.u.x.array[self._face])

    def remembered(self) -> tuple[float, float, float]:
        """Return S₁₁, Q₁₁ and the largest stretch so far, each equal at all points."""
        values = []
        for f, size in ((self.S, 9), (self.Q, 9), (self.seen, 1)):
            least, most = self.ends(f.x.array[::size])
            assert most - least <= 1e-11, f.name
            values.append(least)
        return values[0], values[1], values[2]

    def follow(self, law: Law, targets, first: float, *, start=0.0, growth=1.0, **arguments):
        """Follow the times by ``follow_time``, or by ``follow_load`` if the law has no inertia.

        Args:
            law: Parameters of the sequence.
            targets: Times that are met exactly [s].
            first: Length of the first step [s].
            start: Time of the present state [s].
            growth: Largest quotient of the lengths of two steps.
            arguments: Further arguments of the path; ``on_step`` is required.
        """
        last_time = [start]
        checkpoint = arguments.get("checkpoint")
        on_step = arguments.pop("on_step")
        if checkpoint is not None and checkpoint.restart:
            last_time = [checkpoint.record["loads"][-1]]

        def set_time(t: float) -> None:
            self.g.value = law.g(t)
            self.p.value = law.p(t)
            if self.motion is None and t != last_time[0]:
                self.dt.value = self.time_step.value = abs(t - last_time[0])

        def after_step(step) -> None:
            last_time[0] = step.load
            on_step(step)

        lengths = {"first": first, "least": first / 64.0, "growth": growth}
        arguments |= {"start": start, "on_step": after_step}
        if self.motion is None:
            return follow_load(self.problem, set_time, targets, Steps(**lengths), **arguments)
        steps = TimeSteps(**lengths, longest=4 * first)
        return follow_time(self.problem, self.motion, set_time, targets, steps, **arguments)
