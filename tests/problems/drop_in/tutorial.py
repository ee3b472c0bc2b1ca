# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A cantilever of hexahedra under a growing traction, as in Dokken's tutorial for dolfinx."""

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import default_scalar_type, fem, mesh
from dolfinx.fem.petsc import NonlinearProblem

length = 20.0
domain = mesh.create_box(
    MPI.COMM_WORLD, [[0.0, 0.0, 0.0], [length, 1, 1]], [10, 2, 2], mesh.CellType.hexahedron
)
V = fem.functionspace(domain, ("Lagrange", 2, (domain.geometry.dim,)))

fdim = domain.topology.dim - 1
left = mesh.locate_entities_boundary(domain, fdim, lambda x: np.isclose(x[0], 0))
right = mesh.locate_entities_boundary(domain, fdim, lambda x: np.isclose(x[0], length))
facets = np.hstack([left, right])
values = np.hstack([np.full_like(left, 1), np.full_like(right, 2)])
order = np.argsort(facets)
tags = mesh.meshtags(domain, fdim, facets[order], values[order])

clamped = fem.locate_dofs_topological(V, tags.dim, tags.find(1))
bcs = [fem.dirichletbc(np.zeros(3, dtype=default_scalar_type), clamped, V)]
B = fem.Constant(domain, default_scalar_type((0, 0, 0)))
T = fem.Constant(domain, default_scalar_type((0, 0, 0)))

v = ufl.TestFunction(V)
u = fem.Function(V)
F = ufl.variable(ufl.variable(ufl.Identity(len(u))) + ufl.grad(u))
J = ufl.variable(ufl.det(F))
Ic = ufl.variable(ufl.tr(ufl.variable(F.T * F)))
E = default_scalar_type(1.0e4)
nu = default_scalar_type(0.3)
mu = fem.Constant(domain, E / (2 * (1 + nu)))
lmbda = fem.Constant(domain, E * nu / ((1 + nu) * (1 - 2 * nu)))
psi = (mu / 2) * (Ic - 3) - mu * ufl.ln(J) + (lmbda / 2) * (ufl.ln(J)) ** 2
P = ufl.diff(psi, F)

metadata = {"quadrature_degree": 4}
ds = ufl.Measure("ds", domain=domain, subdomain_data=tags, metadata=metadata)
dx = ufl.Measure("dx", domain=domain, metadata=metadata)
residual = ufl.inner(ufl.grad(v), P) * dx - ufl.inner(v, B) * dx - ufl.inner(v, T) * ds(2)

problem = NonlinearProblem(
    residual,
    u,
    bcs=bcs,
    petsc_options_prefix="tutorial_",
    petsc_options={
        "snes_type": "newtonls",
        "snes_linesearch_type": "none",
        "snes_atol": 1e-8,
        "snes_rtol": 1e-8,
        "ksp_error_if_not_converged": True,
        "ksp_type": "preonly",
        "pc_type": "lu",
        "pc_factor_mat_solver_type": "mumps",
    },
)
for n in range(1, 4):
    T.value[2] = -1.5 * n
    problem.solve()
    assert problem.solver.getConvergedReason() > 0
    assert problem.solver.getIterationNumber() > 1
uh = u
