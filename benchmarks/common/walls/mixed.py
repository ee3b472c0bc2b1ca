# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Displacement and pressure in one matrix, by dolfinx alone: Newton's method with MUMPS.

:class:`TaylorHood` has a continuous pressure, which couples cells and cannot be condensed; its load
is halved where Newton's method fails.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence

from petsc4py import PETSc

import numpy as np

import basix.ufl
import dolfinx
import dolfinx.fem.petsc
import ufl
from ufl.core.expr import Expr
from ufl.variable import Variable

from benchmarks.common.walls.problem import wall_energy
from benchmarks.common.walls.supports import slide
from dolfinx_feti import ConvergenceError, kinematics, loads
from dolfinx_feti.fem.quadrature import limit_quadrature_degree
from dolfinx_feti.loading import LoadStep, Steps
from dolfinx_feti.problems.history import NewtonStep
from dolfinx_feti.wall import Wall, surface_measure

__all__ = ["TaylorHood", "create_newton"]

STEP, MOST = 1e-9, 20  # the least relative Newton step, and its most


def create_newton(
    F: ufl.Form, w: dolfinx.fem.Function, bcs: Sequence[dolfinx.fem.DirichletBC]
) -> Callable[[], list[NewtonStep]]:
    """Return what solves F(w) = 0 from the state in w, with zeros prescribed. Collective.

    It raises a RuntimeError where Newton's method does not converge.
    """
    residual, tangent = (dolfinx.fem.form(form) for form in (F, ufl.derivative(F, w)))
    A = dolfinx.fem.petsc.create_matrix(tangent)
    ksp = PETSc.KSP().create(w.function_space.mesh.comm)
    ksp.setOperators(A)
    ksp.setType("preonly")
    ksp.getPC().setType("lu")
    ksp.getPC().setFactorSolverType("mumps")
    b, x = A.createVecLeft(), A.createVecRight()
    dw = dolfinx.fem.Function(w.function_space)
    fixed = np.concatenate([bc.dof_indices()[0] for bc in bcs])

    def solve() -> list[NewtonStep]:
        history: list[NewtonStep] = []
        step = math.inf
        while step >= STEP:
            if len(history) == MOST or (not math.isfinite(step) and history):
                raise RuntimeError(f"MUMPS: no convergence, the last step was {step:.0e}.")
            begin = time.perf_counter()
            A.zeroEntries()
            dolfinx.fem.petsc.assemble_matrix(A, tangent, bcs=bcs)
            A.assemble()
            r = dolfinx.fem.assemble_vector(residual)
            r.scatter_reverse(dolfinx.la.InsertMode.add)
            r.array[fixed] = 0.0
            b.array[:] = -r.array[: b.getLocalSize()]
            assembled = time.perf_counter()
            ksp.solve(b, x)
            dw.x.array[: x.getLocalSize()] = x.array
            dw.x.scatter_forward()
            w.x.array[:] += dw.x.array
            length, size = (dolfinx.la.norm(each.sub(0).collapse().x) for each in (dw, w))
            step = length / size if size > 0.0 else length  # of the displacement
            seconds = assembled - begin, time.perf_counter() - assembled
            known = math.nan, None, None, 0.0, 1  # no condition number, no eigenvalues, no shift
            history.append(NewtonStep(b.norm(), 1.0, "mumps", 1, 0.0, *known, *seconds))
        return history

    return solve


class TaylorHood:
    """The tube with P2 or Q2 and a continuous linear pressure.

    Attributes:
        u: Displacement [mm].
        p: Pressure of the volume constraint [kPa].
        stress: Cauchy's σ [kPa].
        dofs: Those of u and p.
    """

    def __init__(self, wall: Wall, *, c: float, kappa: float, fibres: tuple[Expr, Expr]) -> None:
        """Compile the forms. Collective."""
        cell = wall.mesh.basix_cell()
        elements = [
            basix.ufl.element("Lagrange", cell, degree, shape=shape)
            for degree, shape in ((2, (3,)), (1, None))
        ]
        W = dolfinx.fem.functionspace(wall.mesh, basix.ufl.mixed_element(elements))
        w, t = dolfinx.fem.Function(W), ufl.TestFunction(W)
        self.u, self.p = (
            dolfinx.fem.Function(dolfinx.fem.functionspace(wall.mesh, e)) for e in elements
        )
        self.dofs = W.dofmap.index_map.size_global

        def energy(u: Expr, p: Expr) -> tuple[Expr, Variable]:
            F = kinematics.deformation_gradient(u)
            return wall_energy(wall, F, p, c=c, kappa=kappa, fibres=fibres), F

        self.stress = kinematics.cauchy_stress(*energy(self.u, self.p))
        (u, p), (v, _) = ufl.split(w), ufl.split(t)
        lumen = surface_measure(wall)(wall.surfaces["lumen"])
        self._pressure = dolfinx.fem.Constant(wall.mesh, 0.0)
        r = ufl.derivative(energy(u, p)[0] * ufl.dx, w, t)
        r = limit_quadrature_degree(r + loads.follower_pressure(self._pressure, u, v, lumen), 4)
        self._w, self._solve = w, create_newton(r, w, slide(wall, W.sub(0)))

    def inflate(
        self,
        pressures: Sequence[float],
        steps: Steps,
        *,
        on_step: Callable[[LoadStep], object],
    ) -> None:
        """Go up to some pressures [mmHg], in increments that a failure halves. Collective.

        Raises:
            ConvergenceError: The least increment fails, too.
        """
        load, longest = 0.0, steps.first
        failures, begin = 0, time.perf_counter()
        for target in pressures:
            while load < target:
                n = math.ceil((target - load) / longest - 1e-9)
                reached = target if n == 1 else load + (target - load) / n
                self._pressure.value = loads.mmhg(reached)
                before = self._w.x.array.copy()
                try:
                    history = self._solve()
                except RuntimeError as error:
                    self._w.x.array[:] = before
                    failures, longest = failures + 1, longest / 2
                    if longest < steps.least:
                        raise ConvergenceError(f"No equilibrium beyond {load:g} mmHg.") from error
                    continue
                for i, part in enumerate((self.u, self.p)):
                    part.interpolate(self._w.sub(i))
                seconds = time.perf_counter() - begin
                on_step(LoadStep(reached, reached - load, (*history,), failures, (), seconds))
                load, failures, begin = reached, 0, time.perf_counter()
