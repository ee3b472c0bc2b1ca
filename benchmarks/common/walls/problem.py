# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A two-layer wall with fibres and a condensed pressure, as the paper's load stepping has it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

import basix.ufl
import dolfinx
import ufl
from ufl.core.expr import Expr

import dolfinx_feti
from benchmarks.common.bodies import Held, hold
from benchmarks.common.records import Record
from dolfinx_feti import kinematics, loads, materials
from dolfinx_feti.fem.quadrature import limit_quadrature_degree
from dolfinx_feti.loading import Checkpoint, LoadStep, Steps, follow_load
from dolfinx_feti.mechanics.residual_stress import elastic_part
from dolfinx_feti.wall import Wall, facets, openings, surface_measure
from dolfinx_feti.wall.fibres import ANGLES, fibre_families, fibre_frame
from meshes.tube import INNER_RADIUS, MEDIA
from meshes.walls import create_tube_wall, open_wall

__all__ = [
    "INTERFACE",
    "WallProblem",
    "create_clamped",
    "create_wall_problem",
    "right_hand_side",
    "summarise",
    "tube_fibres",
    "volume_ratios",
]

INTERFACE = INNER_RADIUS + MEDIA  # mm, between the layers of the tube

#: Length of a clamped tube [mm], and its displacement dofs over the square of its elements along
#: the axis, by degree.
LENGTH, DOFS_ALONG = 3.0, {1: 18.0, 2: 125.0}

#: Length of the elements' edges [mm] that gives the vessel so many displacement dofs, by degree.
SIZE, DOFS = 2.0, {1: 11_000, 2: 71_430}


#: |J_τ − 1| above which an element counts as one that does not keep its volume.
NOTICEABLE = 0.01


@dataclass(frozen=True, slots=True)
class WallProblem:
    """The nonlinear problem, its unknowns, its load and its stress."""

    problem: dolfinx_feti.NonlinearProblem
    u: dolfinx.fem.Function  # displacement [mm]
    p: dolfinx.fem.Function  # pressure of the volume constraint in each cell [kPa]
    residual: ufl.Form  # of the displacements, before p is condensed [mN]
    constraint: ufl.Form  # the residual of p
    held: Sequence[Held]
    load: dolfinx.fem.Constant  # pressure in the lumen [kPa]
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
            self.problem, set_load, pressures, steps, state=[self.u, self.p],
            on_step=on_step, checkpoint=checkpoint, unit="mmHg",
        )  # fmt: skip


def right_hand_side(body: WallProblem) -> PETSc.Vec:
    """Return −r of a wall at rest under its pressure. Collective.

    At rest the volume constraint is met, and the condensed pressure adds nothing to r.
    """
    r = dolfinx.fem.assemble_vector(dolfinx.fem.form(body.residual))
    r.scatter_reverse(dolfinx.la.InsertMode.add)
    for bc in body.problem.bcs:
        bc.set(r.array, body.u.x.array)
    b = body.problem.A.createVecLeft()
    b.array[:] = -r.array[: b.getLocalSize()]
    return b


def create_wall_problem(
    wall: Wall,
    *,
    degree: int,
    kappa: float,
    subdomains: int | npt.NDArray[np.integer] | None,
    options: dict[str, object],
    c: float | None = None,
    prefix: str = "wall_",
    fibres: tuple[Expr, Expr] | None = None,
    G: Expr | None = None,
    pressures: tuple[str, int] = ("DG", 0),
    volume_tolerance: float | None = None,
    element: basix.ufl._ElementBase | None = None,
    held: Sequence[Held] | None = None,
    tangent: str = "symmetric",
    axis: tuple[float, float, float] | None = None,
    potential: bool = True,
) -> WallProblem:
    """Tear a wall at rest, in a number of subdomains or a part for each owned cell. Collective.

    Args:
        wall: Mesh, layers and surfaces.
        degree: k.
        kappa: κ [kPa].
        subdomains: None for the package's rule.
        options: PETSc options of the problem.
        c: Stiffness of the matrix material [kPa]; the paper's if not given.
        prefix: That of the options.
        fibres: The two families of directions; from Laplace problems if not given.
        G: Part of the deformation without energy, det G = 1.
        pressures: Element of p.
        element: Of each component of u, in place of Lagrange's; then k is half of the quadrature's
            degree.
        volume_tolerance: On |mean J − 1| of each cell, for multipliers in place of a large κ.
        held: What is held; the rims of all openings if not given.
        tangent: Of the follower pressure, ``symmetric``, ``full`` or ``none``.
        axis: Direction along which the ends slide, see ``loads.pressure_potential``.
        potential: Let Newton's method know the potential, which keeps it on the way down.
    """
    lagrange = basix.ufl.element("Lagrange", wall.mesh.basix_cell(), degree)
    element = basix.ufl.blocked_element(element or lagrange, shape=(3,))
    V = dolfinx.fem.functionspace(wall.mesh, element)
    Q = dolfinx.fem.functionspace(wall.mesh, pressures)
    u, p = dolfinx.fem.Function(V, name="u"), dolfinx.fem.Function(Q, name="p")
    v, q, du = ufl.TestFunction(V), ufl.TestFunction(Q), ufl.TrialFunction(V)
    F = kinematics.deformation_gradient(u)
    artery = materials.ArteryParameters()
    a1, a2 = fibres or fibre_families(wall, fibre_frame(wall))
    E = F if G is None else elastic_part(F, G)
    C, J = kinematics.right_cauchy_green(E), kinematics.jacobian(E)
    psi = materials.holzapfel_gasser_ogden(
        C, a1, a2, c=c or artery.c, k1=artery.k1, k2=artery.k2, J=J
    )
    psi += materials.perturbed_lagrangian(J, p, dolfinx.fem.Constant(wall.mesh, kappa))
    energy = psi * ufl.dx
    lumen = surface_measure(wall)(wall.surfaces["lumen"])
    pressure = dolfinx.fem.Constant(wall.mesh, 0.0)
    F_u = ufl.derivative(energy, u, v) + loads.follower_pressure(pressure, u, v, lumen)
    F_p = ufl.derivative(energy, p, q)
    F_u, F_p = (limit_quadrature_degree(form, 2 * degree) for form in (F_u, F_p))  # the problem's
    K = ufl.derivative(ufl.derivative(energy, u, v), u, du)
    K += loads.follower_pressure_tangent(pressure, u, v, du, lumen, tangent)
    if held is None:
        held = [(None, np.concatenate([facets(wall, name) for name in openings(wall)]))]
    problem = dolfinx_feti.NonlinearProblem(
        [F_u, F_p],
        u,
        bcs=[hold(V, component, where) for component, where in held],
        J=K,
        condense=p,
        volume_tolerance=volume_tolerance,
        energy=(
            energy + loads.pressure_potential(pressure, u, lumen, axis=axis) if potential else None
        ),
        subdomains=subdomains,
        petsc_options_prefix=prefix,
        petsc_options=options,
        quadrature_degree=2 * degree,
    )
    stress = kinematics.cauchy_stress(psi, F)
    return WallProblem(problem, u, p, F_u, F_p, held, pressure, stress)


def create_clamped(
    comm: MPI.Comm, geometry: str, *, dofs: int, folder: Path, degree: int, **settings: object
) -> WallProblem:
    """Build a tube, three elements thick, or vessel, two, with about so many dofs. Collective.

    Clamped at its openings; PETSc options have the prefix ``tube_`` or ``vessel_``. The mesh of the
    vessel is kept in a folder; further settings are those of :func:`create_wall_problem`.

    Raises:
        ValueError: For less than 50 000 dofs the vessel's elements would be longer than its wall
            is thick.
    """
    if geometry == "tube":
        along = max(2, round(np.sqrt(dofs / DOFS_ALONG[degree])))
        wall = create_tube_wall(
            comm, length=LENGTH, through=(2, 1), around=3 * along // 2, along=along
        )
        settings["fibres"] = tube_fibres(wall.mesh)
    else:
        size = SIZE * (DOFS[degree] / dofs) ** 0.5  # it is a surface
        wall, _ = open_wall("vessel", comm, size=size, folder=folder)
    return create_wall_problem(wall, degree=degree, prefix=f"{geometry}_", **settings)


def tube_fibres(mesh: dolfinx.mesh.Mesh) -> tuple[dolfinx.fem.Function, dolfinx.fem.Function]:
    """Return the two families of helices of a tube, cos α e_θ ± sin α e_z, in each cell."""
    space = dolfinx.fem.functionspace(mesh, ("DG", 0, (3,)))
    families = dolfinx.fem.Function(space), dolfinx.fem.Function(space)

    def helix(x: npt.NDArray[np.float64], sign: float) -> npt.NDArray[np.float64]:
        r = np.hypot(x[0], x[1])
        α = np.deg2rad(np.where(r < INTERFACE, ANGLES["media"], ANGLES["adventitia"]))
        return np.array([-x[1] / r * np.cos(α), x[0] / r * np.cos(α), sign * np.sin(α)])

    for family, sign in zip(families, (1.0, -1.0), strict=True):
        family.interpolate(lambda x, sign=sign: helix(x, sign))
    return families


def volume_ratios(u: dolfinx.fem.Function) -> npt.NDArray[np.float64]:
    """Return J_τ, the mean of det F over τ, of the owned cells τ, (n_cells,). Collective.

    The pressure, constant in each cell, holds it near one; det F at a point is free in P2.
    """
    mesh = u.function_space.mesh
    q = ufl.TestFunction(dolfinx.fem.functionspace(mesh, ("DG", 0)))
    cubic = 3 * (u.function_space.ufl_element().embedded_superdegree - 1)
    dx = ufl.dx(metadata={"quadrature_degree": cubic})
    J = kinematics.jacobian(kinematics.deformation_gradient(u))
    one = dolfinx.fem.Constant(mesh, 1.0)
    deformed, rest = (dolfinx.fem.assemble_vector(dolfinx.fem.form(f * q * dx)) for f in (J, one))
    n = mesh.topology.index_map(mesh.topology.dim).size_local
    return deformed.array[:n] / rest.array[:n]


def summarise(J: npt.NDArray[np.float64], comm: MPI.Comm) -> Record:
    """Return least, mean and greatest J_τ, the mean of |J_τ − 1|, and the share of large ones."""
    off = np.abs(J - 1.0)
    sums = [len(J), J.sum(), off.sum(), np.count_nonzero(off > NOTICEABLE)]
    count, total, deviation, noticeable = comm.allreduce(np.array(sums, dtype=float)).tolist()
    return {
        "min_J": comm.allreduce(float(J.min(initial=np.inf)), op=MPI.MIN),
        "mean_J": total / count,
        "max_J": comm.allreduce(float(J.max(initial=-np.inf)), op=MPI.MAX),
        "mean_deviation_J": deviation / count,
        "share_J": noticeable / count,
    }
