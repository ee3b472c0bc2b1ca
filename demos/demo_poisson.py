# # Poisson's equation: FETI compared with dolfinx
#
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
#
# The first problem of every course, solved twice: by a direct solver, as in dolfinx, and by FETI.
# Only the import and the number of subdomains change. The mesh is refined twice to check the order
# of convergence.
#
#     python3 demos/demo_poisson.py
#     mpirun -n 4 python3 demos/demo_poisson.py
#
# FETI is not the fastest way to solve Poisson's equation in the plane; it is the shortest way to
# see what the method does.
#
# ## Equation
#
# On the unit square
#
# $$ -Δu = f, \qquad u = u_D \text{ on the boundary}, $$
#
# with $f$ and $u_D$ from the solution $u = \sin(πx)\cos(2πy)$.
#
# ## Implementation

# +
from mpi4py import MPI

import numpy as np

import dolfinx
import dolfinx.fem.petsc
import ufl

import dolfinx_feti
from dolfinx_feti.output import pictures

comm = MPI.COMM_WORLD


def exact(x):
    """Return the solution at points, (3, n)."""
    return np.sin(np.pi * x[0]) * np.cos(2 * np.pi * x[1])


def poisson(n):
    """Return the two forms and the boundary condition on n × n squares."""
    mesh = dolfinx.mesh.create_unit_square(comm, n, n)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1))
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    x = ufl.SpatialCoordinate(mesh)
    f = 5 * ufl.pi**2 * ufl.sin(ufl.pi * x[0]) * ufl.cos(2 * ufl.pi * x[1])
    a = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx
    L = ufl.inner(f, v) * ufl.dx

    mesh.topology.create_connectivity(1, 2)
    boundary = dolfinx.mesh.exterior_facet_indices(mesh.topology)
    u_D = dolfinx.fem.Function(V)
    u_D.interpolate(exact)
    bc = dolfinx.fem.dirichletbc(u_D, dolfinx.fem.locate_dofs_topological(V, 1, boundary))
    return a, L, bc


def l2_error(uh):
    """Return the norm of u − u_h in L₂."""
    x = ufl.SpatialCoordinate(uh.function_space.mesh)
    error = ufl.sin(ufl.pi * x[0]) * ufl.cos(2 * ufl.pi * x[1]) - uh
    square = dolfinx.fem.form(error**2 * ufl.dx(metadata={"quadrature_degree": 4}))
    return float(np.sqrt(comm.allreduce(dolfinx.fem.assemble_scalar(square))))


# -

# ## Two solvers
#
# dolfinx 0.9 needs no prefix for the options of its `LinearProblem`, later versions do. The class
# of this package takes one in every version, and does without. Sixteen subdomains are shared out
# among the processes.

# +
direct_options = {"ksp_type": "preonly", "pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}
prefix = {}
if not dolfinx.__version__.startswith("0.9"):
    prefix = {"petsc_options_prefix": "direct_"}

errors = []
difference = 0.0
for n in (16, 32, 64):
    a, L, bc = poisson(n)
    direct = dolfinx.fem.petsc.LinearProblem(a, L, bcs=[bc], petsc_options=direct_options, **prefix)
    u_direct = direct.solve()

    problem = dolfinx_feti.LinearProblem(a, L, bcs=[bc], subdomains=16)
    uh = problem.solve()

    feti = problem.solver.getPythonContext()
    errors.append(l2_error(uh))
    largest = np.abs(uh.x.array - u_direct.x.array).max(initial=0.0)
    difference = max(difference, comm.allreduce(largest, op=MPI.MAX))
    if comm.rank == 0:
        print(f"{n} × {n}: {feti.iterations} iterations, error in L2 {errors[-1]:.2e}")
# -

# The number of iterations hardly depends on the mesh size. Halving the mesh size divides the error
# by four, as it should for linear elements, and both solutions are the same to the tolerance of
# 1e-8.

order = np.log2(errors[-2] / errors[-1])
if comm.rank == 0:
    print(f"order of convergence {order:.3f}, largest difference {difference:.0e}")
assert abs(order - 2.0) < 0.05
assert difference < 1e-6

# ## The solution and its subdomains

pictures.draw(
    "poisson.png",
    pictures.subdomains(problem, title="16 subdomains"),
    pictures.field(uh, "u", title="solution"),
)
