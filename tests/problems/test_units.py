# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The law of units: in other units of stress, length and time a problem takes the same steps.

Random bodies are solved in units of their own and in random ones. Units enter by Constants and by
the coordinates of the mesh, so that nothing is compiled anew for them.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

from mpi4py import MPI

import numpy as np
import pytest
from collective import COMM, agree, small
from problems import owned

import dolfinx
import ufl

from dolfinx_feti import ConvergenceError, NonlinearProblem
from dolfinx_feti.loading import Motion, Steps, TimeSteps, follow_load, follow_time
from dolfinx_feti.mechanics import loads

#: Bodies of each kind, on one process and on several.
ALONE, TOGETHER = 4, 2


@dataclass(frozen=True)
class Units:
    """Factors of stress, length and time."""

    stress: float = 1.0
    length: float = 1.0
    time: float = 1.0


@dataclass(frozen=True)
class Kind:
    """What decides which forms are compiled.

    A body has an energy or a residual, a follower pressure or weight, is supported by springs or
    clamped, and is followed in time if it has inertia.
    """

    dim: int
    condensed: bool = False
    energy: bool = False
    follower: bool = False
    springs: bool = False
    inertia: bool = False


KINDS = {
    "3d": Kind(3, follower=True),
    "3d energy": Kind(3, energy=True),
    "3d condensed": Kind(3, condensed=True, follower=True, springs=True),
    "3d condensed energy": Kind(3, condensed=True, energy=True),
    "2d": Kind(2, springs=True),
    "2d energy": Kind(2, energy=True),
    "2d condensed": Kind(2, condensed=True),
    "2d condensed energy": Kind(2, condensed=True, energy=True, springs=True),
    "inertia": Kind(2, inertia=True),
}


class Body:
    """A slab of random parameters, each a Constant, in any units."""

    def __init__(self, kind: Kind) -> None:
        d = kind.dim
        corners, cells = [np.zeros(d), np.array([2.0, 1.0, 1.0][:d])], [4, 2, 2][:d]
        create = dolfinx.mesh.create_rectangle if d == 2 else dolfinx.mesh.create_box
        self.mesh = mesh = create(COMM, corners, cells)
        self._x, self._kind = mesh.geometry.x.copy(), kind
        V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2 if kind.condensed else 1, (d,)))
        self.u, self.g = dolfinx.fem.Function(V), dolfinx.fem.Function(V)
        names = ("mu", "bulk", "weight", "pressure", "spring", "density")
        self.constants = {name: dolfinx.fem.Constant(mesh, 1.0) for name in names}
        c = self.constants
        ends = [
            dolfinx.mesh.locate_entities_boundary(
                mesh, d - 1, lambda x, at=at: np.isclose(x[0], at)
            )
            for at in (0.0, 2.0)
        ]
        below = dolfinx.mesh.locate_entities_boundary(mesh, d - 1, lambda x: np.isclose(x[1], 0.0))
        loaded = np.unique(np.concatenate([ends[0], below]))
        tags = dolfinx.mesh.meshtags(mesh, d - 1, loaded, np.isin(loaded, below) + np.int32(1))
        ds = ufl.Measure("ds", mesh, subdomain_data=tags)
        held = [np.zeros(0, dtype=np.int32) if kind.springs else ends[0], ends[1]]
        self.bcs = [
            dolfinx.fem.dirichletbc(self.g, dolfinx.fem.locate_dofs_topological(V, d - 1, end))
            for end in held
        ]
        u, v = self.u, ufl.TestFunction(V)
        F = ufl.Identity(d) + ufl.grad(u)
        J = ufl.det(F)
        psi = c["mu"] / 2 * (ufl.inner(F, F) - d - 2 * ufl.ln(J))
        self.fields: list[dolfinx.fem.Function] = []
        if kind.condensed:
            p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)))
            self.fields = [p]
            psi += p * (J - 1) - p**2 / (2 * c["bulk"])
        else:
            psi += c["bulk"] / 2 * ufl.ln(J) ** 2
        energy = psi * ufl.dx - c["weight"] * u[d - 1] * ufl.dx
        if kind.springs:
            energy += c["spring"] / 2 * ufl.inner(u, u) * ds(1)
        F_u = ufl.derivative(energy, u, v)
        if kind.follower:
            F_u += loads.follower_pressure(c["pressure"], u, v, ds(2))
        self.motion = None
        if kind.inertia:
            self.motion = Motion(u, density=c["density"])
            F_u += ufl.derivative(self.motion.inertia, u, v)
        tests = [ufl.TestFunction(p.function_space) for p in self.fields]
        F_p = [ufl.derivative(energy, p, q) for p, q in zip(self.fields, tests, strict=True)]
        self.problem = NonlinearProblem(
            energy if kind.energy else [F_u, *F_p] if F_p else F_u,
            u,
            bcs=self.bcs,
            condense=self.fields or None,
            subdomains=max(4, COMM.size),
            quadrature_degree=4,
        )

    def set(self, units: Units, values: dict[str, float]) -> None:
        """Take units and the values in the body's own."""
        s, h, t = units.stress, units.length, units.time
        scales = {"weight": s / h, "spring": s / h, "density": s * t**2 / h**2}
        self.mesh.geometry.x[:] = h * self._x
        self.units, self._values = units, values
        self._scaled = {name: scales.get(name, s) * value for name, value in values.items()}
        for name in ("mu", "bulk", "spring", "density"):
            self.constants[name].value = self._scaled[name]
        for f in (self.u, *self.fields):
            f.x.array[:] = 0.0
        self.load(0.0)

    def load(self, share: float) -> None:
        """Set a share of all loads."""
        for name in ("weight", "pressure"):
            self.constants[name].value = share * self._scaled[name]
        x = self.u.function_space.tabulate_dof_coordinates() / self.units.length
        stretch, shear = self._values["stretch"], self._values["shear"]
        g = np.zeros((len(x), self._kind.dim))
        g[:, 0], g[:, 1] = stretch * x[:, 0] / 2, shear * x[:, 0] / 2
        self.g.x.array[:] = share * self.units.length * g.ravel()


def values(rng: np.random.Generator, kind: Kind) -> dict[str, float]:
    """Draw the parameters of a body; as many for each kind."""
    drawn = rng.uniform(size=8)
    moves = drawn[6] < 0.6 or kind.inertia
    return {
        "mu": 0.5 + drawn[0],
        "bulk": 10.0 ** (1.0 + 3.0 * drawn[1]) if kind.condensed else 1.0 + 2.0 * drawn[1],
        "weight": 0.0 if kind.follower else 0.1 * (drawn[2] - 0.5),
        "pressure": 0.1 * (drawn[3] - 0.5) if kind.follower else 0.0,
        "spring": 0.5 + drawn[4],
        "density": 0.5 + drawn[5],
        "stretch": 0.4 * (drawn[7] - 0.4) if moves else 0.0,
        "shear": 0.2 * (drawn[2] - 0.5) if moves else 0.0,
    }


def solve(body: Body, *, path: bool) -> tuple[list[int], list[int], np.ndarray]:
    """Return the Newton steps and linear iterations of all solves, and u over the length."""
    problem, state = body.problem, [body.u, *body.fields]
    t = body.units.time
    if body.motion is not None:
        body.motion.velocity.x.array[:] = 0.0
        body.motion.acceleration.x.array[:] = 0.0
        lengths = TimeSteps(first=0.3 * t, least=0.01 * t)
        load = lambda time: body.load(min(1.0, time / t))  # noqa: E731
        steps = follow_time(problem, body.motion, load, [0.9 * t], lengths, state=state)
    elif path:
        steps = follow_load(problem, body.load, [1.0], Steps(first=0.3, least=0.01), state=state)
    else:
        body.load(1.0)
        problem.solve()
        steps = [SimpleNamespace(all_steps=problem.history)]
    iterations = [step.linear_iterations for each in steps for step in each.all_steps]
    u = owned(body.u) / body.units.length
    return [len(each.all_steps) for each in steps], iterations, u


@pytest.mark.parametrize("name", KINDS)
def test_law_of_units(name):
    """As many Newton steps and, up to rounding, iterations, and the same u over the length."""
    rng = np.random.default_rng(list(name.encode()))
    body = Body(KINDS[name])
    for number in range(ALONE if COMM.size == 1 else TOGETHER):
        own, path = values(rng, KINDS[name]), bool(number % 2)
        exponents = rng.uniform([-12, -6, -3], [12, 6, 3])
        other = Units(*(10.0**exponents))
        found = []
        for units in (Units(), other):
            body.set(units, own)
            try:
                found.append(solve(body, path=path))
            except ConvergenceError as error:
                found.append(str(error))
        failed = any(isinstance(each, str) for each in found)
        said = name, number, own, other, [each if failed else each[:2] for each in found]
        agree(not failed, said)
        (steps, iterations, u), (others, other_iterations, other_u) = found
        agree(steps == others, said)
        agree(len(iterations) == len(other_iterations), said)
        differ = np.abs(np.subtract(iterations, other_iterations))
        agree(np.all(differ <= 1 + np.array(iterations) // 10), said)
        greatest = COMM.allreduce(np.abs(u).max(initial=0.0), op=MPI.MAX)
        small((np.abs(other_u - u).max(initial=0.0)) / greatest, 1e-7)
