# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Nearly incompressible neo-Hookean bodies with cavities: a tube, a block with holes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, kinematics, materials
from dolfinx_feti.mechanics.loads import pressure_potential
from dolfinx_feti.scalars import Cavity
from dolfinx_feti.scalars.equations import Coupling

__all__ = ["Body", "create_block", "create_tube"]

Array = npt.NDArray[np.float64]
Marker = Callable[[Array], npt.NDArray[np.bool_]]

KAPPA, OPTIONS = 1000.0, {"snes_rtol": 1e-8, "snes_max_it": 20}


@dataclass(frozen=True, slots=True)
class Body:
    """A body at rest, its cavities, and the energy of its wall; the shear modulus is 1 kPa."""

    u: dolfinx.fem.Function
    p: dolfinx.fem.Function
    bcs: list[dolfinx.fem.DirichletBC]
    cavities: list[Cavity]
    surfaces: list[ufl.Measure]
    axis: tuple[float, float, float] | None
    energy: ufl.Form

    def problem(
        self,
        scalars: Sequence[Coupling],
        pressures: dict[int, dolfinx.fem.Constant] | None = None,
    ) -> NonlinearProblem:
        """Return the problem with scalars, and given pressures in cavities by their number."""
        energy = self.energy
        for k, pressure in (pressures or {}).items():
            energy += pressure_potential(pressure, self.u, self.surfaces[k], self.axis)
        return NonlinearProblem(
            energy, self.u, bcs=self.bcs, condense=self.p, scalars=scalars, subdomains=16,
            quadrature_degree=4, petsc_options=OPTIONS,
        )  # fmt: skip


def create_tube(comm: MPI.Comm) -> Body:
    """Return a quarter of a tube of 23 085 dofs, radii 1 and 1.5 mm, between planes."""
    size = [(1.0, 0.0, 0.0), (1.5, np.pi / 2, 2.0)]
    mesh = dolfinx.mesh.create_box(comm, size, (4, 9, 22), dolfinx.mesh.CellType.hexahedron)
    r, angle, _ = mesh.geometry.x.T.copy()
    mesh.geometry.x[:, :2] = np.column_stack((r * np.cos(angle), r * np.sin(angle)))
    planes = [(0, 0.0), (1, 0.0), (2, 0.0), (2, 2.0)]
    lumen = [lambda x: np.hypot(x[0], x[1]) < 1.0 + 1e-6]
    return _body(mesh, planes, lumen, ("DPC", 1), axis=(0.0, 0.0, 1.0))


def create_block(comm: MPI.Comm) -> Body:
    """Return a block of 9 × 3 × 4 mm in three planes, with four cubic holes of 1 mm³."""
    size = [(0.0, 0.0, 0.0), (9.0, 3.0, 4.0)]
    box = dolfinx.mesh.create_box(comm, size, (18, 6, 8), dolfinx.mesh.CellType.hexahedron)
    cells = np.arange(box.topology.index_map(3).size_local, dtype=np.int32)
    middles = dolfinx.mesh.compute_midpoints(box, 3, cells).T
    holes = [_around((1.5 + 2.0 * k, 1.5, 1.5)) for k in range(4)]
    wall = np.flatnonzero(~np.any([hole(middles) for hole in holes], axis=0)).astype(np.int32)
    mesh = dolfinx.mesh.create_submesh(box, 3, wall)[0]
    return _body(mesh, [(0, 0.0), (1, 0.0), (2, 0.0)], holes, ("DPC", 1))


def _around(centre: Sequence[float]) -> Marker:
    return lambda x: np.abs(x - np.array(centre)[:, None]).max(axis=0) < 0.5 + 1e-6


def _body(
    mesh: dolfinx.mesh.Mesh,
    planes: Sequence[tuple[int, float]],
    surfaces: Sequence[Marker],
    pressure: tuple[str, int],
    axis: tuple[float, float, float] | None = None,
) -> Body:
    """Return a body that slides in planes (axis, place)."""
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (3,)))
    u = dolfinx.fem.Function(V, name="u")
    p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, pressure), name="p")
    zero, bcs = dolfinx.fem.Constant(mesh, 0.0), []
    mesh.topology.create_connectivity(2, 3)
    for k, place in planes:
        facets = dolfinx.mesh.locate_entities_boundary(
            mesh, 2, lambda x, k=k, place=place: np.isclose(x[k], place)
        )
        dofs = dolfinx.fem.locate_dofs_topological(V.sub(k), 2, facets)
        bcs.append(dolfinx.fem.dirichletbc(zero, dofs, V.sub(k)))
    marked = [dolfinx.mesh.locate_entities_boundary(mesh, 2, where) for where in surfaces]
    facets = np.concatenate(marked)
    values = np.repeat(np.arange(1, len(marked) + 1), [len(m) for m in marked]).astype(np.int32)
    order = np.argsort(facets, kind="stable")
    tags = dolfinx.mesh.meshtags(mesh, 2, facets[order], values[order])
    ds = ufl.Measure("ds", mesh, subdomain_data=tags)
    measures = [ds(k + 1) for k in range(len(marked))]
    F = kinematics.deformation_gradient(u)
    C, J = kinematics.right_cauchy_green(F), kinematics.jacobian(F)
    psi = materials.neo_hookean(C, c=1.0, J=J) + materials.perturbed_lagrangian(J, p, KAPPA)
    cavities = [Cavity(u, measure, 1.0, axis=axis) for measure in measures]
    for cavity in cavities:
        cavity.volume.value = cavity.present_volume()
    return Body(u, p, bcs, cavities, measures, axis, psi * ufl.dx)
