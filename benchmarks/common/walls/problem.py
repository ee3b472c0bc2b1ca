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
from dolfinx_feti import kinematics, loads, materials
from dolfinx_feti.fem.quadrature import limit_quadrature_degree
from dolfinx_feti.loading import Checkpoint, LoadStep, Steps, follow_load
from dolfinx_feti.mechanics.residual_stress import elastic_part
from dolfinx_feti.wall import Wall, facets, openings, surface_measure
from dolfinx_feti.wall.fibres import fibre_families, fibre_frame

__all__ = ["WallProblem", "clamp_openings", "create_wall_problem", "right_hand_side", "slide"]

Hold = Callable[[Wall, dolfinx.fem.FunctionSpace], list[dolfinx.fem.DirichletBC]]

#: Surfaces of a quarter of a tube, and the component that is held there.
PLANES = {"opening_1": 2, "opening_2": 2, "symmetry_x": 0, "symmetry_y": 1}


@dataclass(frozen=True, slots=True)
class WallProblem:
    """The nonlinear problem, its unknowns, its load and its stress."""

    problem: dolfinx_feti.NonlinearProblem
    u: dolfinx.fem.Function  # displacement [mm]
    p: dolfinx.fem.Function  # pressure of the volume constraint in each cell [kPa]
    residual: ufl.Form  # of the displacements, before p is condensed [mN]
    constraint: ufl.Form  # the residual of p
    load: dolfinx.fem.Constant  # pressure in the lumen [kPa]
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
            self.load.value = loads.mmhg(mmhg)

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


def clamp_openings(wall: Wall, V: dolfinx.fem.FunctionSpace) -> list[dolfinx.fem.DirichletBC]:
    """Hold the rims of all openings."""
    rims = np.concatenate([facets(wall, name) for name in openings(wall)])
    dofs = dolfinx.fem.locate_dofs_topological(V, 2, rims)
    return [dolfinx.fem.dirichletbc(np.zeros(3), dofs, V)]


def slide(wall: Wall, V: dolfinx.fem.FunctionSpace) -> list[dolfinx.fem.DirichletBC]:
    """Let the ends of a quarter of a tube slide, and its planes of symmetry."""
    bcs = []
    for name, component in PLANES.items():
        part = V.sub(component)
        dofs = dolfinx.fem.locate_dofs_topological(part, 2, facets(wall, name))
        bcs.append(dolfinx.fem.dirichletbc(0.0, dofs, part))
    return bcs


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
    artery = materials.ArteryParameters(c=c)
    a1, a2 = fibres or fibre_families(wall, fibre_frame(wall))
    E = F if G is None else elastic_part(F, G)
    C, J = kinematics.right_cauchy_green(E), kinematics.jacobian(E)
    psi = materials.holzapfel_gasser_ogden(C, a1, a2, c=artery.c, k1=artery.k1, k2=artery.k2, J=J)
    psi += materials.perturbed_lagrangian(J, p, dolfinx.fem.Constant(wall.mesh, kappa))
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
