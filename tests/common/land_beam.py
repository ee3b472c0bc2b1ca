# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Land's beam, soft and slender, bent by a pressure whose rim is free but for one edge.

S. Land et al., *Verification of cardiac mechanics software*, Proc. R. Soc. A 471 (2015) 20150641,
problem 1: Guccione's law with C = 2 kPa, b_f, b_t, b_fs = 8, 2, 4, and fibres along x.
"""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
from collective import COMM
from walls import Wall

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, loads
from dolfinx_feti.mechanics import kinematics, materials


@dataclass(frozen=True)
class Beam:
    """The beam: state, load, forms."""

    u: dolfinx.fem.Function
    p: dolfinx.fem.Function
    load: dolfinx.fem.Constant
    bcs: list[dolfinx.fem.DirichletBC]
    ds: ufl.Measure
    energy: ufl.Form
    F_u: ufl.Form
    F_p: ufl.Form
    K: ufl.Form

    def tangent(self, kind: str) -> ufl.Form:
        """Return the tangent of F_u in u with a kind of the pressure's, or with ``none``."""
        if kind == "none":
            return self.K
        V = self.u.function_space
        v, du = ufl.TestFunction(V), ufl.TrialFunction(V)
        return self.K + loads.follower_pressure_tangent(
            self.load, self.u, v, du, self.ds, kind, bcs=self.bcs
        )

    def wall(self, kind: str) -> Wall:
        """Return the beam as the tests of walls have theirs."""
        forms = (self.energy, self.F_u, self.F_p, self.tangent(kind))
        return Wall(self.u, self.p, self.load, self.bcs, *forms)

    def problem(self, tangent: str, subdomains: int = 4, **options: object) -> NonlinearProblem:
        """Create the problem with a kind of the pressure's tangent, or with ``exact``, by UFL."""
        J = None if tangent == "exact" else self.tangent(tangent)
        return NonlinearProblem(
            [self.F_u, self.F_p],
            self.u,
            bcs=self.bcs,
            J=J,
            condense=self.p,
            subdomains=subdomains,
            petsc_options=options,
        )


def beam(
    comm: MPI.Comm = COMM, *, kappa: float = 1000.0, cells: tuple[int, int, int] = (8, 1, 1)
) -> Beam:
    """Set up the beam of 10 × 1 × 1 mm, P2–P0, clamped at x = 0, under a pressure on z = 0.

    Args:
        comm: Communicator.
        kappa: κ [kPa].
        cells: Bricks along x, y and z, of six tetrahedra each.
    """
    corners = [np.zeros(3), np.array([10.0, 1.0, 1.0])]
    mesh = dolfinx.mesh.create_box(comm, corners, cells)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (3,)))
    Q = dolfinx.fem.functionspace(mesh, ("DG", 0))
    u, p = dolfinx.fem.Function(V), dolfinx.fem.Function(Q)
    v, q, du = ufl.TestFunction(V), ufl.TestFunction(Q), ufl.TrialFunction(V)
    clamped, below = (
        np.sort(dolfinx.mesh.locate_entities_boundary(mesh, 2, lambda x, k=k: np.isclose(x[k], 0)))
        for k in (0, 2)
    )
    bc = dolfinx.fem.dirichletbc(np.zeros(3), dolfinx.fem.locate_dofs_topological(V, 2, clamped), V)
    tags = dolfinx.mesh.meshtags(mesh, 2, below, np.ones(len(below), dtype=np.int32))
    metadata = {"quadrature_degree": 4}
    ds = ufl.Measure("ds", mesh, subdomain_data=tags, metadata=metadata)(1)
    F = kinematics.deformation_gradient(u)
    J = kinematics.jacobian(F)
    E = (J ** (-2 / 3) * kinematics.right_cauchy_green(F) - ufl.Identity(3)) / 2
    across = E[1, 1] ** 2 + E[2, 2] ** 2 + 2 * E[1, 2] ** 2
    exponent = 8 * E[0, 0] ** 2 + 2 * across + 8 * (E[0, 1] ** 2 + E[0, 2] ** 2)
    kappa_ = dolfinx.fem.Constant(mesh, float(kappa))
    psi = 1.0 * (ufl.exp(exponent) - 1) + materials.perturbed_lagrangian(J, p, kappa_)
    energy, load = psi * ufl.dx(metadata=metadata), dolfinx.fem.Constant(mesh, 0.0)
    F_u = ufl.derivative(energy, u, v)
    return Beam(
        u=u,
        p=p,
        load=load,
        bcs=[bc],
        ds=ds,
        energy=energy,
        F_u=F_u + loads.follower_pressure(load, u, v, ds),
        F_p=ufl.derivative(energy, p, q),
        K=ufl.derivative(F_u, u, du),
    )
