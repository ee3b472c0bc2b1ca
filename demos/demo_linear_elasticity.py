# # Linear elasticity: two lines change
#
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
#
# A beam, clamped at one end, bends under its weight. The program is an ordinary dolfinx one. Only
# the import and the constructor of the linear problem change.
#
#     python3 demos/demo_linear_elasticity.py
#     mpirun -n 4 python3 demos/demo_linear_elasticity.py
#
# ## Equation
#
# The displacement u solves $-\operatorname{div} σ(u) = f$ with $σ = 2 μ\, ε + λ
# \operatorname{tr}(ε)\, I$ and $ε = \operatorname{sym} \operatorname{grad} u$. Units: mm, MPa.
#
# ## Implementation

# +
from mpi4py import MPI

import numpy as np

import dolfinx
import ufl

from dolfinx_feti import LinearProblem, compare
from dolfinx_feti.output import pictures

comm = MPI.COMM_WORLD
mesh = dolfinx.mesh.create_box(comm, [[0.0, 0.0, 0.0], [8.0, 1.0, 1.0]], [32, 4, 4])
V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (3,)))
u = ufl.TrialFunction(V)
v = ufl.TestFunction(V)

E = 210.0
nu = 0.3
mu = E / (2 * (1 + nu))
lmbda = E * nu / ((1 + nu) * (1 - 2 * nu))


def sigma(w):
    """Return the stress of a displacement [MPa]."""
    strain = ufl.sym(ufl.grad(w))
    return 2 * mu * strain + lmbda * ufl.tr(strain) * ufl.Identity(3)


weight = dolfinx.fem.Constant(mesh, (0.0, 0.0, -1e-2))
a = ufl.inner(sigma(u), ufl.sym(ufl.grad(v))) * ufl.dx
L = ufl.inner(weight, v) * ufl.dx
# -

# The clamp:


# +
def clamp(x):
    return np.isclose(x[0], 0.0)


clamped = dolfinx.mesh.locate_entities_boundary(mesh, 2, clamp)
bc = dolfinx.fem.dirichletbc(np.zeros(3), dolfinx.fem.locate_dofs_topological(V, 2, clamped), V)
# -

# The mesh is torn into 16 subdomains over all processes. Options of PETSc choose the method:
# `petsc_options={"feti_formulation": "dual"}`.

problem = LinearProblem(a, L, bcs=[bc], subdomains=16, petsc_options_prefix="beam_")
uh = problem.solve()

# ## Compared with a direct solver
#
# `compare` assembles the torn matrix for MUMPS, and measures both.

# +
comparison = compare(problem, ["feti", "mumps"])
difference = comparison.records[0]["difference_to_direct"]
feti = problem.solver.getPythonContext()
if comm.rank == 0:
    print(comparison)
    print(f"{feti.iterations} iterations, condition number {feti.condition_number:.1f}")
    print(f"difference to MUMPS {difference:.1e}")
assert difference < 1e-7
# -

# ## The beam, torn and bent

pictures.draw(
    "linear_elasticity.png",
    pictures.subdomains(problem, title="16 subdomains"),
    pictures.field(uh, "displacement |u| [mm]", displacement=10 * uh, title="displacement × 10"),
)
