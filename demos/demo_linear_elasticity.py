# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: light
# ---

# # Linear elasticity: two lines change
#
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
#
# A beam, clamped at one end, bends under its weight. The script is an ordinary DOLFINx one; the
# import and the constructor of the linear problem are all that changes.
#
#     python3 demos/demo_linear_elasticity.py

# +
from mpi4py import MPI

import numpy as np

import dolfinx
import ufl

from dolfinx_feti import LinearProblem, compare

# -

# The displacement u solves $-\operatorname{div} σ(u) = f$ with
# $σ = 2 μ\, ε + λ \operatorname{tr}(ε)\, I$ and $ε = \operatorname{sym} \operatorname{grad} u$.
# Lengths are in mm, stresses in MPa.

# +
comm = MPI.COMM_WORLD
mesh = dolfinx.mesh.create_box(comm, [[0.0, 0.0, 0.0], [8.0, 1.0, 1.0]], [32, 4, 4])
V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (3,)))
u, v = ufl.TrialFunction(V), ufl.TestFunction(V)

E, nu = 210.0, 0.3
mu, lmbda = E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))


def sigma(w: ufl.core.expr.Expr) -> ufl.core.expr.Expr:
    """Return the stress of a displacement [MPa]."""
    return 2 * mu * ufl.sym(ufl.grad(w)) + lmbda * ufl.div(w) * ufl.Identity(3)


weight = dolfinx.fem.Constant(mesh, (0.0, 0.0, -1e-2))
a = ufl.inner(sigma(u), ufl.sym(ufl.grad(v))) * ufl.dx
L = ufl.inner(weight, v) * ufl.dx

clamped = dolfinx.mesh.locate_entities_boundary(mesh, 2, lambda x: np.isclose(x[0], 0.0))
bc = dolfinx.fem.dirichletbc(np.zeros(3), dolfinx.fem.locate_dofs_topological(V, 2, clamped), V)
# -

# The torn mesh has 16 subdomains over all processes. `feti_…` options choose the method.

problem = LinearProblem(a, L, bcs=[bc], subdomains=16, petsc_options_prefix="beam_")
uh = problem.solve()

# ## Beside a direct solver
#
# `compare` assembles the torn matrix for MUMPS, and measures both.

# +
comparison = compare(problem, ["feti", "mumps"])
difference = comparison.records[0]["difference_to_direct"]

feti = problem.solver.getPythonContext()
if comm.rank == 0:
    print(comparison)
    print(
        f"{feti.iterations} iterations, condition number {feti.condition_number:.1f}, "
        f"difference to MUMPS {difference:.1e}"
    )
assert difference < 1e-7
