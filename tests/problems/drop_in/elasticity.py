# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A rotating elastic box, the problem of dolfinx's demo for GAMG, as a script for dolfinx."""

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

import ufl
from dolfinx import fem, mesh
from dolfinx.fem.petsc import LinearProblem

msh = mesh.create_box(
    MPI.COMM_WORLD, [(0.0, 0.0, 0.0), (2.0, 1.0, 1.0)], [8, 5, 5], mesh.CellType.tetrahedron
)
E = 1.0e9
nu = 0.3
mu = E / (2 * (1 + nu))
lmbda = E * nu / ((1 + nu) * (1 - 2 * nu))
x = ufl.SpatialCoordinate(msh)
force = 10.0 * 300.0**2 * ufl.as_vector((x[0], x[1], 0.0))


def stress(w):
    strain = ufl.sym(ufl.grad(w))
    return 2 * mu * strain + lmbda * ufl.tr(strain) * ufl.Identity(len(w))


V = fem.functionspace(msh, ("Lagrange", 1, (msh.geometry.dim,)))
u = ufl.TrialFunction(V)
v = ufl.TestFunction(V)
faces = mesh.locate_entities_boundary(
    msh, 2, lambda x: np.isclose(x[0], 0.0) | np.isclose(x[1], 1.0)
)
bc = fem.dirichletbc(np.zeros(3), fem.locate_dofs_topological(V, 2, faces), V)

problem = LinearProblem(
    ufl.inner(stress(u), ufl.grad(v)) * ufl.dx,
    ufl.inner(force, v) * ufl.dx,
    bcs=[bc],
    petsc_options_prefix="elasticity_",
    petsc_options={
        "ksp_type": "cg",
        "ksp_rtol": 1e-10,
        "pc_type": "gamg",
        "mg_levels_ksp_type": "chebyshev",
        "mg_levels_pc_type": "jacobi",
        "mg_levels_ksp_chebyshev_esteig_steps": 10,
    },
)

# The rigid body modes that smoothed aggregation asks for.
places = V.tabulate_dof_coordinates()[: V.dofmap.index_map.size_local]
points = PETSc.Vec().createWithArray(places.ravel(), bsize=3, comm=msh.comm)
problem.A.setNearNullSpace(PETSc.NullSpace().createRigidBody(points))
problem.A.setOption(PETSc.Mat.Option.SPD, True)

residuals = []
problem.solver.setMonitor(lambda ksp, its, norm: residuals.append(norm))
uh = problem.solve()
assert problem.solver.getConvergedReason() > 0
assert len(residuals) > 3
