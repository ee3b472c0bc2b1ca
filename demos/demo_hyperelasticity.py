# # Hyperelasticity: dolfinx's program with one import changed
#
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
#
# This is the hyperelastic cantilever of the [dolfinx
# tutorial](https://jsdokken.com/dolfinx-tutorial/chapter2/hyperelasticity.html). Mesh, spaces,
# forms and boundary conditions are those of the tutorial. `NonlinearProblem` comes from
# `dolfinx_feti` instead of `dolfinx.fem.petsc`, and solves each Newton step by FETI instead of an
# LU factorisation.
#
#     python3 demos/demo_hyperelasticity.py
#     mpirun -n 4 python3 demos/demo_hyperelasticity.py
#
# ## Equation
#
# The displacement $u$ of a body $Ω$, which is clamped at one end and loaded by a traction $T$ at
# the other, solves
#
# $$ \int_Ω P : \nabla v \,\mathrm dx - \int_{Γ_T} T · v \,\mathrm ds = 0 \quad \text{for all } v $$
#
# with the deformation gradient $F = I + \nabla u$, the first Piola–Kirchhoff stress
# $P = \partial ψ / \partial F$, and the compressible neo-Hookean energy
#
# $$ ψ = \frac μ2 (\operatorname{tr} F^⊤ F - 3) - μ \ln J + \frac λ2 (\ln J)^2 , \qquad
#    J = \det F . $$
#
# ## Implementation

# +
from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import default_scalar_type, fem, mesh

from dolfinx_feti import NonlinearProblem  # the tutorial: from dolfinx.fem.petsc
from dolfinx_feti.output import pictures

L = 20.0
domain = mesh.create_box(
    MPI.COMM_WORLD, [[0.0, 0.0, 0.0], [L, 1.0, 1.0]], [20, 3, 3], mesh.CellType.hexahedron
)
V = fem.functionspace(domain, ("Lagrange", 2, (domain.geometry.dim,)))
# -

# The facets at the two ends:


# +
def left(x):
    return np.isclose(x[0], 0.0)


def right(x):
    return np.isclose(x[0], L)


fdim = domain.topology.dim - 1
left_facets = mesh.locate_entities_boundary(domain, fdim, left)
right_facets = mesh.locate_entities_boundary(domain, fdim, right)
facet_tag = mesh.meshtags(domain, fdim, np.sort(right_facets), 2)
# -

# The displacement is zero at the left end. The traction acts at the right end.

# +
u_bc = np.zeros(3, dtype=default_scalar_type)
left_dofs = fem.locate_dofs_topological(V, fdim, left_facets)
bcs = [fem.dirichletbc(u_bc, left_dofs, V)]
T = fem.Constant(domain, default_scalar_type((0.0, 0.0, 0.0)))
# -

# Kinematics, energy and residual:

# +
v = ufl.TestFunction(V)
u = fem.Function(V, name="u")

I = ufl.Identity(3)  # noqa: E741
F = ufl.variable(I + ufl.grad(u))
C = F.T * F
J = ufl.det(F)

E = 1.0e4
nu = 0.3
mu = fem.Constant(domain, default_scalar_type(E / (2 * (1 + nu))))
lmbda = fem.Constant(domain, default_scalar_type(E * nu / ((1 + nu) * (1 - 2 * nu))))
psi = mu / 2 * (ufl.tr(C) - 3) - mu * ufl.ln(J) + lmbda / 2 * ufl.ln(J) ** 2
P = ufl.diff(psi, F)

metadata = {"quadrature_degree": 4}
ds = ufl.Measure("ds", domain=domain, subdomain_data=facet_tag, metadata=metadata)
dx = ufl.Measure("dx", domain=domain, metadata=metadata)
residual = ufl.inner(ufl.grad(v), P) * dx - ufl.inner(v, T) * ds(2)
# -

# The constructor is dolfinx's. `subdomains` is new and optional: the number of parts of the mesh,
# over all processes. The options of the LU factorisation are omitted.

# +
petsc_options = {"snes_rtol": 1e-8, "snes_atol": 1e-8}
problem = NonlinearProblem(
    residual,
    u,
    bcs=bcs,
    petsc_options=petsc_options,
    petsc_options_prefix="hyperelasticity",
    subdomains=8,
)
# -

# The load grows in steps. `problem.history` has a record of each Newton step.

for n in range(1, 6):
    T.value[2] = -1.5 * n
    problem.solve()
    converged = problem.solver.getConvergedReason()
    assert converged > 0, f"Solver did not converge with reason {converged}."
    iterations = [step.linear_iterations for step in problem.history]
    if domain.comm.rank == 0:
        print(f"Load {T.value[2]:6.1f}: FETI iterations of each Newton step {iterations}")

# ## Is it in equilibrium?
#
# The clamp carries the load. `problem.reaction` returns the force on the body at a surface; the
# traction acts on an area of one.

# +
force = problem.reaction(left_facets).force
if domain.comm.rank == 0:
    print(f"The clamp carries {force.round(6)}.")
assert np.allclose(force, -T.value, atol=1e-5)
# -

# ## Picture
#
# The subdomains, and the bent beam:

pictures.draw(
    "hyperelasticity.png",
    pictures.subdomains(problem, title="8 subdomains"),
    pictures.field(u, "displacement |u|", displacement=u, title="under load"),
)
