# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The law of units: in other units of stress, length and time a problem takes the same steps.

Random bodies are solved in units of their own and in random ones, which enter by Constants and by
the coordinates of the mesh: nothing is compiled anew for them. A thin tube with a sac, near its
limit point, takes few, and Land's beam bends as published.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

from mpi4py import MPI

import numpy as np
import pytest
from collective import COMM, agree, small
from problems import owned
from walls import INNER, beam, tube

import dolfinx
import ufl

from dolfinx_feti import ConvergenceError, NonlinearProblem
from dolfinx_feti.loading import LoadStep, Motion, Steps, TimeSteps, follow_load, follow_time
from dolfinx_feti.mechanics import loads

#: Bodies of each kind, on one process and on several.
ALONE = 4
TOGETHER = 2


class Units(NamedTuple):
    """Factors of stress, length and time."""

    stress: float = 1.0
    length: float = 1.0
    time: float = 1.0


class Kind(NamedTuple):
    """The choices that decide which forms are compiled; a body without springs is clamped."""

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
        corners = [np.zeros(d), np.array([2.0, 1.0, 1.0][:d])]
        cells = [4, 2, 2][:d]
        create = dolfinx.mesh.create_rectangle if d == 2 else dolfinx.mesh.create_box
        self.mesh = mesh = create(COMM, corners, cells)
        self._x = mesh.geometry.x.copy()
        self._kind = kind
        V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2 if kind.condensed else 1, (d,)))
        self.u = dolfinx.fem.Function(V)
        self.g = dolfinx.fem.Function(V)
        names = ("mu", "bulk", "weight", "pressure", "spring", "density")
        self.constants = c = {name: dolfinx.fem.Constant(mesh, 1.0) for name in names}
        sides = [
            dolfinx.mesh.locate_entities_boundary(
                mesh, d - 1, lambda x, axis=axis, at=at: np.isclose(x[axis], at)
            )
            for axis, at in ((0, 0.0), (0, 2.0), (1, 0.0))
        ]
        loaded = np.unique(np.concatenate(sides[::2]))
        tags = dolfinx.mesh.meshtags(mesh, d - 1, loaded, np.isin(loaded, sides[2]) + np.int32(1))
        ds = ufl.Measure("ds", mesh, subdomain_data=tags)
        bcs = [
            dolfinx.fem.dirichletbc(self.g, dolfinx.fem.locate_dofs_topological(V, d - 1, end))
            for end in sides[kind.springs : 2]
        ]
        u = self.u
        v = ufl.TestFunction(V)
        F = ufl.Identity(d) + ufl.grad(u)
        J = ufl.det(F)
        psi = c["mu"] / 2 * (ufl.inner(F, F) - d - 2 * ufl.ln(J))
        p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)))
        self.fields = [p] if kind.condensed else []
        if kind.condensed:
            psi += p * (J - 1) - p**2 / (2 * c["bulk"])
        else:
            psi += c["bulk"] / 2 * ufl.ln(J) ** 2
        energy = psi * ufl.dx - c["weight"] * u[d - 1] * ufl.dx
        if kind.springs:
            energy += c["spring"] / 2 * ufl.inner(u, u) * ds(1)
        F_u = ufl.derivative(energy, u, v)
        if kind.follower:
            F_u += loads.follower_pressure(c["pressure"], u, v, ds(2))
        self.motion = Motion(u, density=c["density"]) if kind.inertia else None
        if kind.inertia:
            F_u += ufl.derivative(self.motion.inertia, u, v)
        F = energy if kind.energy else F_u
        if kind.condensed and not kind.energy:
            F = [F_u, ufl.derivative(energy, p, ufl.TestFunction(p.function_space))]
        common = {"condense": self.fields or None, "quadrature_degree": 4}
        self.problem = NonlinearProblem(F, u, bcs, subdomains=max(4, COMM.size), **common)

    def set(self, units: Units, values: dict[str, float]) -> None:
        """Set the units, and the values in them."""
        s = units.stress
        h = units.length
        t = units.time
        scales = {"weight": s / h, "spring": s / h, "density": s * t**2 / h**2}
        self.mesh.geometry.x[:] = h * self._x
        self.units = units
        self._values = values
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
        stretch = self._values["stretch"]
        shear = self._values["shear"]
        g = np.zeros((len(x), self._kind.dim))
        g[:, 0] = stretch * x[:, 0] / 2
        g[:, 1] = shear * x[:, 0] / 2
        self.g.x.array[:] = share * self.units.length * g.ravel()


def values(rng: np.random.Generator, kind: Kind) -> dict[str, float]:
    """Draw random parameters of a body; each kind draws as many numbers."""
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
    """Return Newton steps and linear iterations of all solves, and u over the unit of length."""
    problem = body.problem
    state = [body.u, *body.fields]
    t = body.units.time
    if body.motion is not None:
        body.motion.velocity.x.array[:] = 0.0
        body.motion.acceleration.x.array[:] = 0.0
        lengths = TimeSteps(first=0.3 * t, least=0.01 * t)

        def load(time):
            body.load(min(1.0, time / t))

        steps = follow_time(problem, body.motion, load, [0.9 * t], lengths, state=state)
    elif path:
        steps = follow_load(problem, body.load, [1.0], Steps(first=0.3, least=0.01), state=state)
    else:
        body.load(1.0)
        problem.solve()
        steps = []
    taken = [each.all_steps for each in steps] or [problem.history]
    iterations = [step.linear_iterations for solve in taken for step in solve]
    return [len(solve) for solve in taken], iterations, owned(body.u) / body.units.length


@pytest.mark.parametrize("name", KINDS)
def test_steps_and_solution_do_not_depend_on_units(name):
    """In other units, Newton steps and u are equal, and iterations up to rounding."""
    rng = np.random.default_rng(list(name.encode()))
    body = Body(KINDS[name])
    for number in range(ALONE if COMM.size == 1 else TOGETHER):
        own = values(rng, KINDS[name])
        path = bool(number % 2)
        other = Units(*(10.0 ** rng.uniform([-12, -6, -3], [12, 6, 3])))
        found = []
        for units in (Units(), other):
            body.set(units, own)
            try:
                found.append(solve(body, path=path))
            except ConvergenceError as error:
                found.append(([str(error)], [], np.zeros(0)))
        (steps, iterations, u), (others, other_iterations, other_u) = found
        said = name, number, own, other, steps, others, iterations, other_iterations
        agree(len(u) and steps == others and len(iterations) == len(other_iterations), said)
        differ = np.abs(np.subtract(iterations, other_iterations))
        agree(np.all(differ <= 1 + np.array(iterations) // 10), said)
        greatest = COMM.allreduce(np.abs(u).max(initial=0.0), op=MPI.MAX)
        small((np.abs(other_u - u).max(initial=0.0)) / greatest, 1e-7)


#: Length over that of the unit, and E over the pressure: 3 % above that of the limit point.
LONG = 4.0
SOFT = 24.0


def inflate(stiffness: float, unit: float, first: float) -> tuple[list[LoadStep], float]:
    """Follow a pressure from rest to 1; return load steps and max |u| over the unit of length."""
    mesh = tube(COMM, around=16, along=16, length=LONG)
    x = mesh.geometry.x
    r = np.hypot(x[:, 0], x[:, 1])
    height = np.exp(-((x[:, 2] - LONG / 2) ** 2) / 0.3)
    thin = INNER + 0.3 * (r - INNER)
    x[:, :2] *= ((thin + 0.4 * INNER * height * (1 + x[:, 0] / r) / 2) / r)[:, None]
    mesh.topology.create_connectivity(2, 3)
    facets = dolfinx.mesh.exterior_facet_indices(mesh.topology)
    nodes = dolfinx.mesh.entities_to_geometry(mesh, 2, facets)
    lumen = np.isclose(r[nodes], INNER).all(axis=1)
    x *= unit
    tags = dolfinx.mesh.meshtags(
        mesh, 2, np.sort(facets[lumen]), np.ones(lumen.sum(), dtype=np.int32)
    )
    ds = ufl.Measure("ds", mesh, subdomain_data=tags)(1)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    u = dolfinx.fem.Function(V)
    v = ufl.TestFunction(V)
    du = ufl.TrialFunction(V)
    ends = dolfinx.mesh.locate_entities_boundary(
        mesh, 2, lambda x: np.isclose(x[2], 0.0) | np.isclose(x[2] / unit, LONG)
    )
    bcs = [dolfinx.fem.dirichletbc(np.zeros(3), dolfinx.fem.locate_dofs_topological(V, 2, ends), V)]
    p = dolfinx.fem.Constant(mesh, 0.0)
    E = dolfinx.fem.Constant(mesh, 1.0)
    F = ufl.Identity(3) + ufl.grad(u)
    J = ufl.det(F)
    psi = E * ((ufl.inner(F, F) - 3 - 2 * ufl.ln(J)) / 6 + ufl.ln(J) ** 2 / 2)
    elastic = ufl.derivative(psi * ufl.dx, u, v)
    tangent = ufl.derivative(elastic, u, du)
    tangent += loads.follower_pressure_tangent(p, u, v, du, ds, bcs=bcs)
    F = elastic + loads.follower_pressure(p, u, v, ds)
    problem = NonlinearProblem(F, u, bcs, tangent, subdomains=8, quadrature_degree=2)
    E.value = stiffness

    def set_load(load: float) -> None:
        p.value = load * stiffness / SOFT

    steps = follow_load(problem, set_load, [1.0], Steps(first=first, least=0.01), state=[u])
    return steps, COMM.allreduce(np.abs(u.x.array).max(initial=0.0), op=max) / unit


@pytest.mark.parametrize("first", [0.25, 0.1])
def test_path_near_the_limit_point_takes_few_newton_steps(first):
    """A path takes at most 22 Newton steps and 600 iterations, in MPa and mm as in Pa and m."""
    found = []
    for stiffness, unit in ((1.0, 1.0), (1e6, 1e-3)):
        steps, largest = inflate(stiffness, unit, first)
        taken = [step for each in steps for step in each.all_steps]
        iterations = sum(step.linear_iterations for step in taken)
        agree(len(taken) <= 22 and iterations <= 600, (len(taken), iterations))
        agree(min(step.step_length for step in taken) > 0.1, taken)
        found.append((len(taken), largest))
    (one, u), (other, w) = found
    agree(one == other and u > 0.5, found)
    small(w / u - 1.0, 1e-6)


@pytest.mark.serial
def test_tip_of_lands_beam_is_the_documented_one():
    """The tip of Land's beam (2015) on P2–P0 has the z [mm] of docs/beam.md."""
    page = (Path(__file__).parents[2] / "docs/beam.md").read_text(encoding="utf-8")
    body = beam(kappa=1000.0, cells=(20, 2, 2))
    u = body.u
    V = body.u.function_space

    def set_load(value: float) -> None:
        body.load.value = value

    steps = Steps(first=0.001, least=0.004 / 64)
    follow_load(body.problem(8), set_load, [0.004], steps, state=[u, body.p])
    here = np.linalg.norm(V.tabulate_dof_coordinates() - [10.0, 0.5, 1.0], axis=1) < 1e-9
    z = 1.0 + u.x.array.reshape(-1, 3)[here, 2].item()
    rows = re.findall(r"^\| \d \| ([\d ]+) \| (4\.\d+) \|", page, re.M)
    documented = {int(number.replace(" ", "")): float(z) for number, z in rows}
    small(z - documented[3 * V.dofmap.index_map.size_global], 1e-3)
