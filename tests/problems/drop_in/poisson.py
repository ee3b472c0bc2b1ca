# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Poisson's equation on a rectangle, as in the first demo of dolfinx, as a script for dolfinx."""

from mpi4py import MPI
from petsc4py.PETSc import ScalarType

import numpy as np

import ufl
from dolfinx import fem, mesh
from dolfinx.fem.petsc import LinearProblem

msh = mesh.create_rectangle(
    MPI.COMM_WORLD, ((0.0, 0.0), (2.0, 1.0)), (32, 16), cell_type=mesh.CellType.triangle
)
V = fem.functionspace(msh, ("Lagrange", 1))
ends = mesh.locate_entities_boundary(
    msh, msh.topology.dim - 1, lambda x: np.isclose(x[0], 0.0) | np.isclose(x[0], 2.0)
)
bc = fem.dirichletbc(ScalarType(0), fem.locate_dofs_topological(V, 1, ends), V)

u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
x = ufl.SpatialCoordinate(msh)
source = 10 * ufl.exp(-((x[0] - 0.5) ** 2 + (x[1] - 0.5) ** 2) / 0.02)
flux = ufl.sin(5 * x[0])
a = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx
L = ufl.inner(source, v) * ufl.dx + ufl.inner(flux, v) * ufl.ds

problem = LinearProblem(
    a,
    L,
    bcs=[bc],
    petsc_options_prefix="poisson_",
    petsc_options={
        "ksp_type": "preonly",
        "pc_type": "lu",
        "pc_factor_mat_solver_type": "mumps",
        "ksp_error_if_not_converged": True,
    },
)
uh = problem.solve()
assert isinstance(uh, fem.Function)
assert problem.solver.getConvergedReason() > 0
