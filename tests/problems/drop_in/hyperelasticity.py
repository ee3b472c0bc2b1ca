# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A twisted block of rubber, as in the hyperelastic demo of dolfinx, as a script for dolfinx."""

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem, mesh
from dolfinx.fem.petsc import NonlinearProblem

msh = mesh.create_box(
    MPI.COMM_WORLD, [(0.0, 0.0, 0.0), (1.0, 1.0, 1.0)], [6, 5, 5], mesh.CellType.tetrahedron
)
V = fem.functionspace(msh, ("Lagrange", 1, (3,)))
u, v, du = fem.Function(V), ufl.TestFunction(V), ufl.TrialFunction(V)

body_force = fem.Constant(msh, (0.0, -0.5, 0.0))
traction = fem.Constant(msh, (0.1, 0.0, 0.0))
E, nu = 10.0, 0.3
mu = fem.Constant(msh, E / (2 * (1 + nu)))
lmbda = fem.Constant(msh, E * nu / ((1 + nu) * (1 - 2 * nu)))

F = ufl.Identity(3) + ufl.grad(u)
J = ufl.det(F)
psi = mu / 2 * (ufl.tr(F.T * F) - 3) - mu * ufl.ln(J) + lmbda / 2 * ufl.ln(J) ** 2
Pi = psi * ufl.dx - ufl.inner(body_force, u) * ufl.dx - ufl.inner(traction, u) * ufl.ds
residual = ufl.derivative(Pi, u, v)
tangent = ufl.derivative(residual, u, du)


def turned(x):
    """Turn the right face by 60 degrees about its centre, half of the way out of rest."""
    angle, y, z = np.pi / 3, x[1] - 0.5, x[2] - 0.5
    return 0.5 * np.stack(
        [
            0 * x[0],
            y * np.cos(angle) - z * np.sin(angle) - y,
            y * np.sin(angle) + z * np.cos(angle) - z,
        ]
    )


def dofs(at):
    facets = mesh.locate_entities_boundary(msh, 2, lambda x: np.isclose(x[0], at))
    return fem.locate_dofs_topological(V, 2, facets)


rotation = fem.Function(V)
rotation.interpolate(turned)
bcs = [fem.dirichletbc(np.zeros(3), dofs(0.0), V), fem.dirichletbc(rotation, dofs(1.0))]

problem = NonlinearProblem(
    residual,
    u,
    bcs=bcs,
    J=tangent,
    petsc_options_prefix="twist_",
    petsc_options={
        "snes_type": "newtonls",
        "snes_linesearch_type": "basic",
        "snes_rtol": 1e-10,
        "snes_atol": 1e-12,
        "ksp_type": "preonly",
        "pc_type": "lu",
        "pc_factor_mat_solver_type": "mumps",
    },
)
uh = problem.solve()
assert problem.solver.getConvergedReason() > 0
