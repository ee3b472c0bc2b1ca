# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The two-layer tube under pressure, P2–P0, as the benchmarks use it."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import dolfinx
import ufl

import dolfinx_feti
from dolfinx_feti import kinematics, loads, materials
from dolfinx_feti.wall import read_wall
from meshes.tube import INNER_RADIUS, MEDIA, create_tube

__all__ = ["TubeProblem", "create_tube_problem"]

LENGTH = 3.0
ANGLES = (np.deg2rad(29.0), np.deg2rad(62.0))


@dataclass(frozen=True, slots=True)
class TubeProblem:
    """The nonlinear problem, its unknowns and its load.

    Attributes:
        problem: The FETI problem.
        u: Displacement [mm].
        p: Pressure of the element-wise volume constraint [kPa].
        pressure: Pressure on the lumen [kPa].
        bcs: Clamped ends.
    """

    problem: dolfinx_feti.NonlinearProblem
    u: dolfinx.fem.Function
    p: dolfinx.fem.Function
    pressure: dolfinx.fem.Constant
    bcs: list[dolfinx.fem.DirichletBC]


def create_tube_problem(
    comm: MPI.Comm, *, dofs: int, kappa: float, subdomains: int, options: dict[str, object]
) -> TubeProblem:
    """Build the tube with clamped ends.

    Args:
        comm: Communicator of the mesh.
        dofs: Wanted number of displacement dofs; three elements through the wall.
        kappa: κ [kPa].
        subdomains: Number of subdomains.
        options: PETSc options of the problem, prefix ``tube_``.
    """
    along = max(2, round(np.sqrt(dofs / 125.0)))
    with tempfile.TemporaryDirectory() as folder:
        path = comm.bcast(Path(folder) / "tube.msh")
        if comm.rank == 0:
            create_tube(path, length=LENGTH, through=(2, 1), around=3 * along // 2, along=along)
        comm.Barrier()
        wall = read_wall(path, comm)
        comm.Barrier()
    V = dolfinx.fem.functionspace(wall.mesh, ("Lagrange", 2, (3,)))
    Q = dolfinx.fem.functionspace(wall.mesh, ("DG", 0))
    u, p = dolfinx.fem.Function(V, name="u"), dolfinx.fem.Function(Q, name="p")
    v, q, du = ufl.TestFunction(V), ufl.TestFunction(Q), ufl.TrialFunction(V)
    a1, a2 = (_fibres(wall.mesh, sign) for sign in (1.0, -1.0))
    F = kinematics.deformation_gradient(u)
    C, J = kinematics.right_cauchy_green(F), kinematics.jacobian(F)
    artery = materials.ArteryParameters()
    psi = materials.holzapfel_gasser_ogden(
        C, a1, a2, c=artery.c, k1=artery.k1, k2=artery.k2, J=J
    ) + materials.perturbed_lagrangian(J, p, dolfinx.fem.Constant(wall.mesh, kappa))
    energy = psi * ufl.dx(metadata={"quadrature_degree": 4})
    pressure = dolfinx.fem.Constant(wall.mesh, 0.0)
    ds = ufl.Measure("ds", wall.mesh, subdomain_data=wall.facet_tags)(
        wall.names["lumen"], metadata={"quadrature_degree": 4}
    )
    F_u = ufl.derivative(energy, u, v)
    K = ufl.derivative(F_u, u, du) + loads.follower_pressure_tangent(pressure, u, v, du, ds)
    F_u += loads.follower_pressure(pressure, u, v, ds)
    bcs = [_clamped(wall, V)]
    problem = dolfinx_feti.NonlinearProblem(
        [F_u, ufl.derivative(energy, p, q)],
        u,
        bcs=bcs,
        J=K,
        condense=p,
        subdomains=subdomains,
        petsc_options_prefix="tube_",
        petsc_options=options,
    )
    return TubeProblem(problem, u, p, pressure, bcs)


def _fibres(mesh: dolfinx.mesh.Mesh, sign: float) -> dolfinx.fem.Function:
    def direction(x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        r = np.hypot(x[0], x[1])
        alpha = np.where(r < INNER_RADIUS + MEDIA, *ANGLES)
        return np.array([-x[1] / r * np.cos(alpha), x[0] / r * np.cos(alpha), sign * np.sin(alpha)])

    fibre = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0, (3,))))
    fibre.interpolate(direction)
    return fibre


def _clamped(wall: object, V: dolfinx.fem.FunctionSpace) -> dolfinx.fem.DirichletBC:
    ends = np.concatenate(
        [wall.facet_tags.find(wall.names[name]) for name in ("opening_1", "opening_2")]
    )
    dofs = dolfinx.fem.locate_dofs_topological(V, 2, ends)
    return dolfinx.fem.dirichletbc(np.zeros(3), dofs, V)
