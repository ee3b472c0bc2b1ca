# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A one-layer wall grown from an STL surface is in equilibrium on springs and when pulled."""

from __future__ import annotations

import numpy as np
import pytest
from collective import COMM, agree, equal, small
from mesh_files import pipe, write_stl
from problems import free_residual
from wall_files import on_first

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, kinematics, materials
from dolfinx_feti.meshes.vessel import write_vessel
from dolfinx_feti.wall import (
    Clamp,
    Dashpot,
    Pressure,
    Slide,
    Spring,
    apply_conditions,
    area,
    read_wall,
)

KAPPA = 30.0
PRESSURE = 0.4  # kPa
SPRINGS = {
    "lumen": Pressure(),
    "outer": [Spring(0.2, "all"), Dashpot(0.5)],
    "opening_1": Spring(2.0),
    "opening_2": Spring(2.0),
}


@pytest.fixture(scope="module")
def wall(tmp_path_factory):
    """A bent one-layer pipe whose ends are in the planes z = 0 and z = 10."""
    path = tmp_path_factory.mktemp("surface") / "wall.msh"

    def make():
        x, t = pipe(n=12, m=6)
        x[:, 0] += 0.03 * x[:, 2] ** 2
        stl = write_stl(path.with_suffix(".stl"), x, t, binary=True)
        return write_vessel(path, surface=stl, size=2.0, thickness=1.5, layers={"wall": 1.0})

    quality = on_first(make)
    agree(quality.minimum >= 0.1 and quality.cells < 1500, quality)
    return read_wall(on_first(lambda: path), COMM)


class Body:
    """The wall with P2–P0 elements and conditions."""

    def __init__(self, wall, conditions, axis=None):
        self.u, self.p = u, p = [
            dolfinx.fem.Function(dolfinx.fem.functionspace(wall.mesh, element))
            for element in (("Lagrange", 2, (3,)), ("DG", 0))
        ]
        self.boundary = apply_conditions(wall, u, conditions, axis=axis)
        F = kinematics.deformation_gradient(u)
        C = kinematics.right_cauchy_green(F)
        J = kinematics.jacobian(F)
        psi = materials.neo_hookean(C, c=3.0, J=J)
        psi += materials.perturbed_lagrangian(J, p, kappa=KAPPA)
        energy = psi * ufl.dx(metadata={"quadrature_degree": 4})
        inside = ufl.derivative(energy, u, ufl.TestFunction(u.function_space))
        self.residual = inside + self.boundary.residual
        self.rest = ufl.derivative(energy, p)
        self.tangent = ufl.derivative(inside, u) + self.boundary.tangent

    def solve(self):
        """Solve, and return the Newton steps."""
        problem = NonlinearProblem(
            [self.residual, self.rest],
            self.u,
            condense=self.p,
            bcs=self.boundary.bcs,
            J=self.tangent,
            subdomains=6,
            quadrature_degree=4,
            petsc_options={"snes_rtol": 1e-10, "snes_atol": 1e-12},
        )
        problem.solve()
        return problem.history

    def balanced(self):
        """Require equilibrium of the free dofs by dolfinx alone, and prescribed dofs in place."""
        free, whole = free_residual(self.residual, self.boundary.bcs)
        small(free / (whole if self.boundary.bcs else PRESSURE), 1e-7)
        held = self.u.x.array.copy()
        for bc in self.boundary.bcs:
            bc.set(held)
        equal(self.u.x.array, held, 1e-12)


def test_inflated_on_springs(wall):
    """A wall supported by springs alone is inflated to equilibrium, delayed by its dashpots."""
    agree(wall.layers == {"wall": 101} and area(wall, "opening_2") > 0.0)
    body = Body(wall, SPRINGS)
    u = body.u
    boundary = body.boundary
    agree(not boundary.bcs and boundary.energy is None)
    boundary.pressure.value = PRESSURE
    moved = []
    for dt in (0.1, np.inf):
        boundary.time_step.value = dt
        steps = body.solve()
        boundary.advance(u)
        moved.append(COMM.allreduce(np.abs(u.x.array).max(), op=max))
    agree(0.0 < moved[0] < moved[1] and 0.05 < moved[1] < 5.0, moved)
    agree(len(steps) <= 12 and steps[-1].linear_method == "gmres", steps)
    body.balanced()


def test_pulled_and_inflated(wall):
    """A wall clamped at one end, pulled to 1.1 times its length and inflated, is in equilibrium."""
    conditions = {"lumen": Pressure(), "opening_1": Clamp(), "opening_2": Slide()}
    body = Body(wall, conditions, axis="z")
    u = body.u
    boundary = body.boundary
    for stretch, pressure in ((1.05, 0.0), (1.1, 0.0), (1.1, PRESSURE)):
        boundary.set_stretch(stretch)
        boundary.pressure.value = pressure
        body.solve()
        body.balanced()
    x = u.function_space.tabulate_dof_coordinates()
    top = u.x.array.reshape(-1, 3)[np.isclose(x[:, 2], 10.0)]
    small(float(np.abs(top[:, 2] - 1.0).max(initial=0.0)), 1e-9)
