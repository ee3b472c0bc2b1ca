# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Taylor and Hood's elements for the tube: u and a continuous p in one system, for MUMPS.

Such a pressure couples cells and cannot be condensed, so that dolfinx assembles the mixed problem,
and Newton's method takes whole steps, with increments of the load that are halved where it fails.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence

from petsc4py import PETSc

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
from dolfinx_feti.loading import Checkpoint, LoadStep, Steps
from dolfinx_feti.problems.history import NewtonStep
from dolfinx_feti.wall import Wall, surface_measure

__all__ = ["TaylorHood"]

#: Share of the first residual that is an equilibrium, and Newton steps that a load may take.
RTOL, MOST = 1e-8, 12


class TaylorHood:
    """The mixed problem.

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
        self._r, self._J = (dolfinx.fem.form(form) for form in (r, ufl.derivative(r, w)))
        self._w, self._bcs = w, slide(wall, W.sub(0))
        self._K = dolfinx.fem.petsc.create_matrix(self._J)
        self._lu = PETSc.KSP().create(wall.mesh.comm)
        self._lu.setType(PETSc.KSP.Type.PREONLY)
        self._lu.getPC().setType(PETSc.PC.Type.LU)
        self._lu.getPC().setFactorSolverType(PETSc.Mat.SolverType.MUMPS)

    def inflate(
        self,
        pressures: Sequence[float],
        steps: Steps,
        *,
        on_step: Callable[[LoadStep], object],
        checkpoint: Checkpoint | None = None,
    ) -> None:
        """Go up to some pressures [mmHg], in increments that a failure halves. Collective.

        Raises:
            ConvergenceError: The least increment fails, too.
        """
        if checkpoint is not None:
            raise ValueError("checkpoint: this path is short, and is not kept; give None.")
        load, longest = 0.0, steps.first
        lost: list[NewtonStep] = []
        failures, begin = 0, time.perf_counter()
        for target in pressures:
            while load < target:
                n = math.ceil((target - load) / longest - 1e-9)
                self._pressure.value = loads.mmhg(load + (target - load) / n)
                before = self._w.x.array.copy()
                arrived, history = self._solve()
                if not arrived:
                    self._w.x.array[:] = before
                    lost, failures, longest = [*lost, *history], failures + 1, longest / 2
                    if longest < steps.least:
                        raise ConvergenceError(f"No equilibrium was found beyond {load:g} mmHg.")
                    continue
                increment = (target - load) / n
                load = target if n == 1 else load + increment
                for i, part in enumerate((self.u, self.p)):
                    part.interpolate(self._w.sub(i))
                seconds = time.perf_counter() - begin
                on_step(LoadStep(load, increment, (*history,), failures, (*lost,), seconds))
                lost, failures, begin = [], 0, time.perf_counter()

    def _solve(self) -> tuple[bool, list[NewtonStep]]:
        """Take Newton steps; return whether they led to equilibrium, and what they cost."""
        history: list[NewtonStep] = []
        while True:
            begin = time.perf_counter()
            r = dolfinx.fem.petsc.assemble_vector(self._r)
            r.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
            dolfinx.fem.petsc.set_bc(r, self._bcs)
            norm = r.norm()
            small = norm <= RTOL * (history[0].residual if history else math.inf)
            if (small and history) or not math.isfinite(norm) or len(history) == MOST:
                return small, history
            self._K.zeroEntries()
            dolfinx.fem.petsc.assemble_matrix(self._K, self._J, bcs=self._bcs)
            self._K.assemble()
            self._lu.setOperators(self._K)
            assembled = time.perf_counter()
            dw = r.duplicate()
            self._lu.solve(r, dw)
            self._w.x.array[: dw.getLocalSize()] -= dw.array_r  # w ← w − K⁻¹ r
            self._w.x.scatter_forward()
            seconds = assembled - begin, time.perf_counter() - assembled
            known = math.nan, None, None, 0.0, 1  # no condition number, no eigenvalues, no shift
            history.append(NewtonStep(norm, 1.0, "mumps", 1, 0.0, *known, *seconds))
            r.destroy()
            dw.destroy()
