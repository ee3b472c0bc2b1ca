# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""From zero, problems without a load to cut take at most twice the steps of SNES with ``bt``."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import pytest
from collective import COMM, agree, equal
from problems import Cell, cube, dirichlet, everywhere, left, owned, right

import dolfinx
import dolfinx.fem.petsc
import ufl

from dolfinx_feti import NonlinearProblem
from dolfinx_feti.runtime.petsc_options import inserted

#: Share by which the tangents' coefficients begin: size^(p/2 − 1) where u = 0.
SMALL = 1e-4


def disc(x):
    """Return 1 in a disc of radius 0.3 in the middle of the unit square, and 0 elsewhere."""
    is_inside = (x[0] - 0.5) ** 2 + (x[1] - 0.5) ** 2 < 0.09
    return np.where(is_inside, 1.0, 0.0)


def stretch_along_x(x):
    """Return the displacement (x₀, 0, 0)."""
    return x * [[1.0], [0.0], [0.0]]


class Scalar:
    """A scalar problem with an energy, and its solution by SNES with ``bt`` and LU."""

    def __init__(self, mesh: dolfinx.mesh.Mesh, degree: int = 1, *, held: bool = True) -> None:
        V = dolfinx.fem.functionspace(mesh, ("Lagrange", degree))
        self.u = dolfinx.fem.Function(V)
        self.v = ufl.TestFunction(V)
        self.bcs = [dirichlet(V, everywhere)] if held else []
        self.dx = ufl.Measure("dx", mesh, metadata={"quadrature_degree": 2 * degree})

    def p_laplace(self, p: float, load: float, *, waves: bool = False) -> None:
        mesh = self.u.function_space.mesh
        x = ufl.SpatialCoordinate(mesh)
        p, load = (dolfinx.fem.Constant(mesh, value) for value in (p, load))
        if waves:
            load = load * ufl.sin(3 * x[0]) * ufl.cos(2 * x[1])
        size = SMALL + ufl.inner(ufl.grad(self.u), ufl.grad(self.u))
        self.energy = (size ** (p / 2) / p - load * self.u) * self.dx

    def total_variation(self, weight: float, smoothing: float) -> None:
        V = self.u.function_space
        g = dolfinx.fem.Function(V)
        g.interpolate(disc)
        weight, smoothing = (dolfinx.fem.Constant(V.mesh, value) for value in (weight, smoothing))
        size = ufl.sqrt(ufl.inner(ufl.grad(self.u), ufl.grad(self.u)) + smoothing**2)
        self.energy = ((self.u - g) ** 2 / 2 + weight * size) * self.dx

    def snes(self, form: ufl.Form) -> tuple[int, np.ndarray]:
        """Return the Newton steps of SNES for a residual, and its solution, (owned,)."""
        F, J = map(dolfinx.fem.form, (form, ufl.derivative(form, self.u)))
        A = dolfinx.fem.petsc.create_matrix(J)
        x = A.createVecRight()
        r = A.createVecLeft()
        n = len(owned(self.u))

        def residual(snes: PETSc.SNES, x: PETSc.Vec, r: PETSc.Vec) -> None:
            self.u.x.array[:n] = x.array_r
            self.u.x.scatter_forward()
            b = dolfinx.fem.assemble_vector(F)
            b.scatter_reverse(dolfinx.la.InsertMode.add)
            r.array[:] = b.array[:n]
            for bc in self.bcs:
                bc.set(r.array, self.u.x.array[:n], -1.0)

        def tangent(snes: PETSc.SNES, x: PETSc.Vec, A: PETSc.Mat, P: PETSc.Mat) -> None:
            A.zeroEntries()
            dolfinx.fem.petsc.assemble_matrix(A, J, bcs=self.bcs)
            A.assemble()

        snes = PETSc.SNES().create(COMM)
        snes.setFunction(residual, r)
        snes.setJacobian(tangent, A)
        snes.setTolerances(rtol=1e-8, atol=1e-50, stol=0.0, max_it=200)
        snes.setOptionsPrefix("cold_")
        with inserted("cold_", {"snes_linesearch_minlambda": 1e-30, "snes_linesearch_max_it": 100}):
            snes.setFromOptions()  # else it gives up where the first tangent is 1e-16 of the later
        snes.getKSP().setType(PETSc.KSP.Type.PREONLY)
        pc = snes.getKSP().getPC()
        pc.setType(PETSc.PC.Type.LU)
        pc.setFactorSolverType("mumps")
        snes.solve(None, x)
        agree(snes.getConvergedReason() > 0)
        steps = snes.getIterationNumber()
        solution = x.array.copy()
        for made in (snes, A, x, r):
            made.destroy()
        return steps, solution

    def compare(self, subdomains: int, *, spare: int = 0) -> None:
        """Require SNES' solution in at most twice its steps, by the residual and by the energy.

        The energy takes no more steps than the residual, up to ``spare``.
        """
        residual = ufl.derivative(self.energy, self.u, self.v)
        most, expected = self.snes(residual)
        common = {"subdomains": subdomains, "petsc_options": {"snes_max_it": 2 * most}}
        steps = []
        for F in (residual, self.energy):
            self.u.x.array[:] = 0.0
            problem = NonlinearProblem(F, self.u, bcs=self.bcs, **common)
            problem.solve()
            equal(owned(self.u), expected, 1e-6)
            steps.append(len(problem.history))
        agree(steps[1] <= steps[0] + spare, steps)


@pytest.mark.parametrize("p", [1.1, 1.5, 4.0, 10.0])
@pytest.mark.parametrize(("load", "subdomains"), [(1.0, 2), (10.0, 7), (10.0, 16), (0.1, 2)])
def test_p_laplace(p, load, subdomains):
    """The p-Laplacian is solved although its coefficient varies from 1 to 1e-16.

    With p = 10 rounding decides whether a tangent takes a shift, which may cost a step.
    """
    problem = Scalar(cube(2, 16))
    problem.p_laplace(p, load)
    problem.compare(subdomains, spare=int(p == 10.0))


@pytest.mark.parametrize("p", [4.0, 6.0, 8.0, 10.0])
@pytest.mark.parametrize(("cells", "subdomains"), [(8, 1), (24, 1), (16, 4)])
def test_p_laplace_of_a_load_that_turns(p, cells, subdomains):
    """The p-Laplacian is solved although tangents are singular to rounding where the load turns."""
    problem = Scalar(cube(2, cells))
    problem.p_laplace(p, 1.0, waves=True)
    problem.compare(subdomains)


def test_p_laplace_on_quadratic_quadrilaterals():
    """The p-Laplacian with p = 10 is solved on quadratic quadrilaterals."""
    problem = Scalar(cube(2, 16, Cell.quadrilateral), degree=2)
    problem.p_laplace(10.0, 10.0)
    problem.compare(4)


@pytest.mark.parametrize("weight", [1e-2, 1e-1])
@pytest.mark.parametrize("smoothing", [1e-1, 1e-3, 1e-4])
@pytest.mark.parametrize(("cells", "held"), [(16, True), (20, False)])
def test_total_variation(weight, smoothing, cells, held):
    """Total variation is minimised although its gradient almost jumps where grad u = 0.

    With the least smoothing the path of some sixty steps depends on the errors that linear solves
    leave: 62 by the residual and 67 by the energy on two processes.
    """
    problem = Scalar(cube(2, cells), held=held)
    problem.total_variation(weight, smoothing)
    problem.compare(4, spare=6 if smoothing < 1e-3 else 0)


@pytest.mark.parametrize("energy", [False, True])
@pytest.mark.parametrize(("slides", "most"), [(False, 7), (True, 6)])
def test_cube_pulled_at_once(energy, slides, most):
    """A nearly incompressible cube is pulled to twice its length in one load step."""
    mesh = cube(3, 3, Cell.hexahedron)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (3,)))
    u, p = map(dolfinx.fem.Function, (V, dolfinx.fem.functionspace(mesh, ("DG", 0))))
    F = ufl.Identity(3) + ufl.grad(u)
    J = ufl.det(F)
    potential = (J ** (-2 / 3) * ufl.inner(F, F) / 2 + p * (J - 1) - p**2 / 2e4) * ufl.dx(degree=4)
    if slides:
        planes = [dirichlet(V, lambda x, i=i: np.isclose(x[i], 0.0), component=i) for i in range(3)]
        bcs = [*planes, dirichlet(V, right, lambda x: 1.0 + 0.0 * x[0], component=0)]
    else:
        bcs = [dirichlet(V, side, stretch_along_x) for side in (left, right)]
    residuals = [ufl.derivative(potential, f, ufl.TestFunction(f.function_space)) for f in (u, p)]
    F = potential if energy else residuals
    problem = NonlinearProblem(F, u, bcs=bcs, condense=p, subdomains=4)
    problem.solve()
    agree(len(problem.history) <= most, problem.history)
    reached = u.x.array.copy()
    for bc in bcs:
        bc.set(reached)
    equal(u.x.array, reached, 1e-10)
