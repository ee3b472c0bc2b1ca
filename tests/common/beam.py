# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A soft and slender beam under pressure, as in the benchmark of Land et al. (2015), Problem 1."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
from problems import dirichlet, left
from walls import Wall

import dolfinx
import ufl

from dolfinx_feti import kinematics, loads, materials

#: The beam [mm], its pressure [kPa], and Guccione's parameters C [kPa], b_f, b_t, b_fs.
LENGTH, WIDTH = 10.0, 1.0
PRESSURE = 0.004
STIFFNESS, ALONG, ACROSS, SHEAR = 2.0, 8.0, 2.0, 4.0
BELOW = 1


def beam(
    comm: MPI.Comm, *, kappa: float, tangent: str, cells: tuple[int, int, int] = (10, 1, 1)
) -> Wall:
    """Set up the beam with P2–P0: clamped at x = 0, fibres along x, a follower pressure on z = 0.

    Args:
        comm: Communicator.
        kappa: κ [kPa].
        tangent: Kind of the pressure's tangent.
        cells: Bricks along each edge, of six tetrahedra.
    """
    mesh = dolfinx.mesh.create_box(comm, [np.zeros(3), np.array([LENGTH, WIDTH, WIDTH])], cells)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (3,)))
    Q = dolfinx.fem.functionspace(mesh, ("DG", 0))
    u, p = dolfinx.fem.Function(V, name="u"), dolfinx.fem.Function(Q, name="p")
    v, q, du = ufl.TestFunction(V), ufl.TestFunction(Q), ufl.TrialFunction(V)
    metadata = {"quadrature_degree": 4}
    F = kinematics.deformation_gradient(u)
    J = kinematics.jacobian(F)
    E = (J ** (-2 / 3) * F.T * F - ufl.Identity(3)) / 2
    exponent = ALONG * E[0, 0] ** 2 + 2 * SHEAR * (E[0, 1] ** 2 + E[0, 2] ** 2)
    exponent += ACROSS * (E[1, 1] ** 2 + E[2, 2] ** 2 + 2 * E[1, 2] ** 2)
    psi = STIFFNESS / 2 * (ufl.exp(exponent) - 1)
    kappa_ = dolfinx.fem.Constant(mesh, float(kappa))
    energy = (psi + materials.perturbed_lagrangian(J, p, kappa_)) * ufl.dx(metadata=metadata)
    facets = np.sort(
        dolfinx.mesh.locate_entities_boundary(mesh, 2, lambda x: np.isclose(x[2], 0.0))
    )
    tags = dolfinx.mesh.meshtags(mesh, 2, facets, np.full(len(facets), BELOW, dtype=np.int32))
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=tags)(BELOW, metadata=metadata)
    load = dolfinx.fem.Constant(mesh, 0.0)
    F_u = ufl.derivative(energy, u, v) + loads.follower_pressure(load, u, v, ds)
    K = ufl.derivative(ufl.derivative(energy, u, v), u, du)
    K += loads.follower_pressure_tangent(load, u, v, du, ds, tangent)
    return Wall(u, p, load, [dirichlet(V, left)], energy, F_u, ufl.derivative(energy, p, q), K)
