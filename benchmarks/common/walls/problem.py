# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A two-layer wall with fibres and a condensed pressure, as the paper's load stepping has it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

import basix.ufl
import dolfinx
import ufl
from ufl.core.expr import Expr

import dolfinx_feti
from benchmarks.common.walls.supports import Hold, clamp_openings
from dolfinx_feti import kinematics, loads, materials
from dolfinx_feti.fem.quadrature import limit_quadrature_degree
from dolfinx_feti.loading import Checkpoint, LoadStep, Steps, follow_load
from dolfinx_feti.mechanics.residual_stress import elastic_part
from dolfinx_feti.wall import Wall, surface_measure
from dolfinx_feti.wall.fibres import fibre_families, fibre_frame

__all__ = ["WallProblem", "create_wall_problem", "right_hand_side", "wall_energy"]


@dataclass(frozen=True, slots=True)
class WallProblem:
    """The nonlinear problem, its unknowns, its load and its stress."""

    problem: dolfinx_feti.NonlinearProblem
    u: dolfinx.fem.Function  # displacement [mm]
    p: dolfinx.fem.Function  # pressure of the volume constraint in each cell [kPa]
    residual: ufl.Form  # of the displacements, before p is condensed [mN]
    constraint: ufl.Form  # the residual of p
    pressure: dolfinx.fem.Constant  # in the lumen [kPa]
    bcs: list[dolfinx.fem.DirichletBC]
    stress: Expr  # Cauchy's σ [kPa]

    @property
    def dofs(self) -> int:
        """Displacement dofs."""
        dofmap = self.u.function_space.dofmap
        return dofmap.index_map.size_global * dofmap.index_map_bs

    def inflate(
        self,
        pressures: Sequence[float],
        steps: Steps,
        *,
        on_step: Callable[[LoadStep], object],
        checkpoint: Checkpoint | None = None,
    ) -> None:
        """Go from equilibrium to equilibrium up to some pressures [mmHg], see ``follow_load``."""

        def set_load(mmhg: float) -> None:
            self.pressure.value = loads.mmhg(mmhg)

        follow_load(
            self.problem,
            set_load,
            pressures,
            steps,
            state=[self.u, self.p],
            on_step=on_step,
            checkpoint=checkpoint,
            unit="mmHg",
        )


def right_hand_side(body: WallProblem) -> PETSc.Vec:
    """Return −r of a wall at rest under its pressure. Collective.

    At rest the volume constraint is met, and the condensed pressure adds nothing to r.
    """
    r = dolfinx.fem.assemble_vector(dolfinx.fem.form(body.residual))
    r.scatter_reverse(dolfinx.la.InsertMode.add)
    for bc in body.bcs:
        bc.set(r.array, body.u.x.array)
    b = body.problem.A.createVecLeft()
    b.array[:] = -r.array[: b.getLocalSize()]
    return b


def wall_energy(
    wall: Wall,
    F: Expr,
    p: Expr,
    *,
    c: float,
    kappa: float,
    fibres: tuple[Expr, Expr] | None,
    G: Expr | None = None,
) -> Expr:
    """Return the energy Ψ(F, p) of the wall's tissue [kPa], with the residual stress of a G."""
    a1, a2 = fibres or fibre_families(wall, fibre_frame(wall))
    F = F if G is None else elastic_part(F, G)
    C, J = kinematics.right_cauchy_green(F), kinematics.jacobian(F)
    artery = materials.ArteryParameters(c=c)
    psi = materials.holzapfel_gasser_ogden(C, a1, a2, c=artery.c, k1=artery.k1, k2=artery.k2, J=J)
    return psi + materials.perturbed_lagrangian(J, p, dolfinx.fem.Constant(wall.mesh, kappa))


def create_wall_problem(
    wall: Wall,
    *,
    degree: int,
    c: float,
    kappa: float,
    subdomains: int | npt.NDArray[np.integer] | None,
    options: dict[str, object],
    prefix: str = "wall_",
    fibres: tuple[Expr, Expr] | None = None,
    G: Expr | None = None,
    pressures: tuple[str, int] = ("DG", 0),
    volume_tolerance: float | None = None,
    element: basix.ufl._ElementBase | None = None,
    hold: Hold = clamp_openings,
    tangent: str = "symmetric",
    axis: tuple[float, float, float] | None = None,
    potential: bool = True,
) -> WallProblem:
    """Tear a wall at rest, in a number of subdomains or a part for each owned cell.

    Args:
        wall: Mesh, layers and surfaces.
        degree: k.
        c: Stiffness of the matrix material [kPa].
        kappa: κ [kPa].
        subdomains: None for the package's rule.
        options: PETSc options of the problem.
        prefix: Their prefix.
        fibres: The two families of directions; from Laplace problems if not given.
        G: Part of the deformation without energy, det G = 1.
        pressures: Element of p.
        element: Of each component of u, in place of Lagrange's; then k is half of the quadrature's
            degree.
        volume_tolerance: On |mean J − 1| of each cell, for multipliers in place of a large κ.
        hold: Makes the Dirichlet conditions.
        tangent: Of the follower pressure, ``symmetric``, ``full`` or ``none``.
        axis: Direction along which the ends slide, see ``loads.pressure_potential``.
        potential: Let Newton's method know the potential, which keeps it on the way down.
    """
    lagrange = basix.ufl.element("Lagrange", wall.mesh.basix_cell(), degree)
    V = dolfinx.fem.functionspace(
        wall.mesh, basix.ufl.blocked_element(element or lagrange, shape=(3,))
    )
    Q = dolfinx.fem.functionspace(wall.mesh, pressures)
    u, p = dolfinx.fem.Function(V, name="u"), dolfinx.fem.Function(Q, name="p")
    v, q, du = ufl.TestFunction(V), ufl.TestFunction(Q), ufl.TrialFunction(V)
    F = kinematics.deformation_gradient(u)
    psi = wall_energy(wall, F, p, c=c, kappa=kappa, fibres=fibres, G=G)
    energy = psi * ufl.dx
    lumen = surface_measure(wall)(wall.surfaces["lumen"])
    pressure = dolfinx.fem.Constant(wall.mesh, 0.0)
    F_u = ufl.derivative(energy, u, v) + loads.follower_pressure(pressure, u, v, lumen)
    F_p = ufl.derivative(energy, p, q)
    F_u, F_p = (limit_quadrature_degree(form, 2 * degree) for form in (F_u, F_p))  # the problem's
    K = ufl.derivative(ufl.derivative(energy, u, v), u, du)
    K += loads.follower_pressure_tangent(pressure, u, v, du, lumen, tangent)
    work = loads.pressure_potential(pressure, u, lumen, axis=axis)
    bcs = hold(wall, V)
    problem = dolfinx_feti.NonlinearProblem(
        [F_u, F_p],
        u,
        bcs=bcs,
        J=K,
        condense=p,
        volume_tolerance=volume_tolerance,
        energy=energy + work if potential else None,
        subdomains=subdomains,
        petsc_options_prefix=prefix,
        petsc_options=options,
        quadrature_degree=2 * degree,
    )
    stress = kinematics.cauchy_stress(psi, F)
    return WallProblem(problem, u, p, F_u, F_p, pressure, bcs, stress)
