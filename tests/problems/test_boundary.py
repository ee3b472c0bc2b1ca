# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""``boundary=`` adds the conditions of a wall, as if their forms were written out."""

from __future__ import annotations

import numpy as np
import pytest
from collective import COMM, agree, equal, raises

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, kinematics, loads, materials
from dolfinx_feti.meshes.walls import create_tube_wall
from dolfinx_feti.wall import Clamp, Pressure, Spring, Wall, apply_conditions

#: With clamped ends the pressure has a potential; with an end on springs it has none.
CONDITIONS = {
    "potential": {"lumen": Pressure(), "opening_1": Clamp(), "opening_2": Clamp()},
    "none": {"lumen": Pressure(), "opening_1": Clamp(), "opening_2": Spring(1.0, "all")},
}


@pytest.fixture(scope="module")
def wall() -> Wall:
    """A tube of some hundred cells."""
    return create_tube_wall(COMM, size=1.0)


class Tube:
    """A tube under 1 mmHg."""

    def __init__(self, wall: Wall, kind: str) -> None:
        V = dolfinx.fem.functionspace(wall.mesh, ("Lagrange", 1, (3,)))
        self.u = dolfinx.fem.Function(V, name="u")
        self.p = dolfinx.fem.Function(dolfinx.fem.functionspace(wall.mesh, ("DG", 0)))
        self.v = ufl.TestFunction(V)
        self.q = ufl.TestFunction(self.p.function_space)
        self.du = ufl.TrialFunction(V)
        F = kinematics.deformation_gradient(self.u)
        C = kinematics.right_cauchy_green(F)
        J = kinematics.jacobian(F)
        psi = materials.neo_hookean(C, c=3.0, J=J)
        psi += materials.perturbed_lagrangian(J, self.p, kappa=100.0)
        self.energy = psi * ufl.dx
        self.boundary = apply_conditions(wall, self.u, CONDITIONS[kind])
        self.boundary.set_pressure(loads.mmhg(1.0))

    def written_out(self) -> NonlinearProblem:
        """Return the problem with the forms of the conditions added by hand."""
        energy = self.boundary.energy
        F_u = ufl.derivative(self.energy, self.u, self.v)
        return NonlinearProblem(
            [F_u + self.boundary.residual, ufl.derivative(self.energy, self.p, self.q)],
            self.u,
            bcs=self.boundary.bcs,
            J=ufl.derivative(F_u, self.u, self.du) + self.boundary.tangent,
            condense=self.p,
            energy=None if energy is None else self.energy + energy,
            subdomains=4,
        )


def residuals(problem: NonlinearProblem) -> np.ndarray:
    """Solve, and return the residual norm of each Newton step."""
    problem.solve()
    return np.array([step.residual for step in problem.history])


@pytest.mark.parametrize("kind", CONDITIONS)
def test_energy_and_boundary(wall, kind):
    """``boundary=`` takes the Newton steps of forms written out, to rounding accuracy."""
    tube = Tube(wall, kind)
    agree((tube.boundary.energy is None) == (kind == "none"))
    expected = residuals(tube.written_out())
    found = tube.u.x.array.copy()
    other = Tube(wall, kind)
    problem = NonlinearProblem(
        other.energy, other.u, boundary=other.boundary, condense=other.p, subdomains=4
    )
    equal(residuals(problem), expected, tolerance=1e-10)
    equal(other.u.x.array, found, tolerance=1e-12)


def test_residuals_tangent_and_potential(wall):
    """``boundary=`` adds to residuals, tangent and potential if the user passes them."""
    tube = Tube(wall, "potential")
    expected = residuals(tube.written_out())
    other = Tube(wall, "potential")
    F_u = ufl.derivative(other.energy, other.u, other.v)
    F_p = ufl.derivative(other.energy, other.p, other.q)
    dp = ufl.TrialFunction(other.p.function_space)
    J = [
        [ufl.derivative(F_u, other.u, other.du), ufl.derivative(F_u, other.p, dp)],
        [ufl.derivative(F_p, other.u, other.du), ufl.derivative(F_p, other.p, dp)],
    ]
    problem = NonlinearProblem(
        [F_u, F_p],
        other.u,
        boundary=other.boundary,
        J=J,
        energy=other.energy,
        condense=other.p,
        subdomains=4,
    )
    equal(residuals(problem), expected, tolerance=1e-8)


def test_further_conditions(wall):
    """``bcs=`` are added to the Dirichlet conditions of ``boundary=``."""
    tube = Tube(wall, "none")
    V = tube.u.function_space
    dofs = dolfinx.fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[2], 3.0))
    bc = dolfinx.fem.dirichletbc(np.zeros(3), dofs, V)
    problem = NonlinearProblem(
        tube.energy, tube.u, boundary=tube.boundary, bcs=[bc], condense=tube.p, subdomains=4
    )
    agree(len(problem.bcs) == 2)
    problem.solve()
    top = np.isclose(V.tabulate_dof_coordinates()[:, 2], 3.0)
    agree(not tube.u.x.array.reshape(-1, 3)[top].any())


def test_conditions_on_another_displacement(wall):
    """``boundary=`` refuses the conditions of another displacement, and other types."""
    tube = Tube(wall, "potential")
    other = Tube(wall, "potential")
    with raises(ValueError, "pass the same u"):
        NonlinearProblem(tube.energy, tube.u, boundary=other.boundary, condense=tube.p)
    with raises(TypeError, "boundary"):
        NonlinearProblem(tube.energy, tube.u, boundary=[], condense=tube.p)
