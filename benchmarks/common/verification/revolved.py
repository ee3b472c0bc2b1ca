# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The ellipsoid as a body of revolution with twist: its meridian plane alone, by MUMPS.

Points move by (R, Θ, Z) ↦ (R + u_r, Θ + φ, Z + u_z), none of which depends on Θ, and in the frames
of cylinders, with r = R + u_r,

    F = [[1 + ∂u_r/∂R,   0,   ∂u_r/∂Z],
         [r ∂φ/∂R,      r/R,  r ∂φ/∂Z],
         [∂u_z/∂R,       0,   1 + ∂u_z/∂Z]] .

The pressure's potential is −p ∫ r²/2 dz along the lumen: the base, that closes it, is held. So few
unknowns tell what meshes of bricks tend to, unless the body buckles out of its symmetry.
"""

from __future__ import annotations

from collections.abc import Callable

from mpi4py import MPI

import numpy as np

import basix.ufl
import dolfinx
import ufl
from ufl.core.expr import Expr

from benchmarks.common.direct import create_newton
from benchmarks.common.verification.ellipsoid import fraction, helix, meridian
from dolfinx_feti import materials
from meshes.bricks import lattice_cells

__all__ = ["solve_revolved"]

STEPS = 40  # of the load


def solve_revolved(
    energy: Callable[[Expr, Expr, Expr, Expr], Expr],
    *,
    pressure: float,
    kappa: float,
    through: int,
    along: int,
) -> list[float]:
    """Load the ellipsoid; return z of the apex inside, in the middle of the wall, outside [mm].

    Raises:
        RuntimeError: Newton's method does not converge.
    """
    t, s = np.linspace(0, 1, 2 * through + 1), np.linspace(0, 1, 2 * along + 1)
    points = np.stack(meridian(*np.meshgrid(t, s, indexing="ij")), axis=-1)
    number = np.arange(points[..., 0].size).reshape(points.shape[:2])
    curved = basix.ufl.element("Lagrange", "quadrilateral", 2, shape=(2,))
    mesh = dolfinx.mesh.create_mesh(
        MPI.COMM_SELF,
        lattice_cells(number, 2, simplex=False),
        x=points.reshape(-1, 2),
        e=ufl.Mesh(curved),
    )
    quadratic = basix.ufl.element("Lagrange", "quadrilateral", 2)
    linear = basix.ufl.element("DPC", "quadrilateral", 1)
    parts = [basix.ufl.blocked_element(quadratic, shape=(2,)), quadratic, linear]
    W = dolfinx.fem.functionspace(mesh, basix.ufl.mixed_element(parts))
    w, x = dolfinx.fem.Function(W), ufl.SpatialCoordinate(mesh)
    u, φ, p = ufl.split(w)
    r, H, g = x[0] + u[0], ufl.grad(u), ufl.grad(φ)
    F = ufl.as_matrix(
        [
            [1 + H[0, 0], 0, H[0, 1]],
            [r * g[0], r / x[0], r * g[1]],
            [H[1, 0], 0, 1 + H[1, 1]],
        ]
    )
    depth = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("Lagrange", 2)))
    depth.interpolate(lambda y: fraction(y[0], y[1]))
    share = dolfinx.fem.Constant(mesh, 0.0)
    C, J = F.T * F, ufl.det(F)
    psi = energy(C, J, share, ufl.as_vector(helix(depth, *x)))
    psi += materials.perturbed_lagrangian(J, p, kappa)
    base, axis, lumen = (
        dolfinx.mesh.locate_entities_boundary(mesh, 1, where)
        for where in (
            lambda y: np.isclose(y[1], points[0, -1, 1]),
            lambda y: np.isclose(y[0], 0.0),
            lambda y: np.isclose(fraction(y[0], y[1]), 0.0, atol=1e-6),
        )
    )
    tags = dolfinx.mesh.meshtags(mesh, 1, np.sort(lumen), np.ones(len(lumen), dtype=np.int32))
    N = ufl.FacetNormal(mesh)
    dz = ufl.dot(ufl.grad(x[1] + u[1]), ufl.as_vector([N[1], -N[0]]))
    metadata = {"quadrature_degree": 4}
    ds = ufl.Measure("ds", mesh, subdomain_data=tags, metadata=metadata)(1)
    work = psi * x[0] * ufl.dx(metadata=metadata) - pressure * share * r**2 / 2 * dz * ds
    held = [(W.sub(0), base), (W.sub(1), base), (W.sub(0).sub(0), axis)]
    bcs = []
    for part, edges in held:
        space, _ = part.collapse()
        dofs = dolfinx.fem.locate_dofs_topological((part, space), 1, edges)
        bcs.append(dolfinx.fem.dirichletbc(dolfinx.fem.Function(space), dofs, part))
    solve = create_newton(ufl.derivative(work, w), w, bcs)
    for share.value in np.linspace(0, 1, STEPS + 1)[1:]:
        solve()
    moved = w.sub(0).collapse()
    x0 = moved.function_space.tabulate_dof_coordinates()
    found = []
    for z in meridian(np.array([0.0, 0.5, 1.0]), np.zeros(3))[1]:
        node = int(np.argmin(np.hypot(x0[:, 0], x0[:, 1] - z)))
        found.append(float(z + moved.x.array[2 * node + 1]))
    return found
