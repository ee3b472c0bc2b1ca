# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Land's beam, soft and slender, bent by a pressure whose rim is free but for one edge.

S. Land et al., *Verification of cardiac mechanics software*, Proc. R. Soc. A 471 (2015) 20150641,
problem 1: Guccione's law with C = 2 kPa, b_f, b_t, b_fs = 8, 2, 4, and fibres along x.
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
from collective import COMM
from problems import dirichlet, tagged
from walls import Wall, under_pressure

import dolfinx
import ufl

from dolfinx_feti.mechanics import kinematics, materials


def beam(
    comm: MPI.Comm = COMM,
    tangent: str = "auto",
    *,
    kappa: float = 1000.0,
    cells: tuple[int, int, int] = (8, 1, 1),
) -> Wall:
    """Set up the beam of 10 × 1 × 1 mm, P2–P0, clamped at x = 0, under a pressure on z = 0.

    Args:
        comm: Communicator.
        tangent: Kind of the pressure's tangent, or ``exact``, by UFL.
        kappa: κ [kPa].
        cells: Bricks along x, y and z, of six tetrahedra each.
    """
    corners = [np.zeros(3), np.array([10.0, 1.0, 1.0])]
    mesh = dolfinx.mesh.create_box(comm, corners, cells)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (3,)))
    u = dolfinx.fem.Function(V)
    p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)))
    metadata = {"quadrature_degree": 4}
    F = kinematics.deformation_gradient(u)
    J = kinematics.jacobian(F)
    E = (J ** (-2 / 3) * kinematics.right_cauchy_green(F) - ufl.Identity(3)) / 2
    across = E[1, 1] ** 2 + E[2, 2] ** 2 + 2 * E[1, 2] ** 2
    exponent = 8 * E[0, 0] ** 2 + 2 * across + 8 * (E[0, 1] ** 2 + E[0, 2] ** 2)
    kappa_ = dolfinx.fem.Constant(mesh, float(kappa))
    psi = 1.0 * (ufl.exp(exponent) - 1) + materials.perturbed_lagrangian(J, p, kappa_)
    below = tagged(mesh, lambda x: np.isclose(x[2], 0.0))(1, metadata=metadata)
    clamped = [dirichlet(V, lambda x: np.isclose(x[0], 0.0))]
    return under_pressure(u, p, clamped, psi * ufl.dx(metadata=metadata), below, tangent)
