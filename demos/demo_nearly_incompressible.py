# # Nearly incompressible: κ from 10 to 100 000
#
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
#
# This package is made for materials that hardly change their volume. A block bends under its
# weight, for bulk moduli κ over four orders of magnitude; FETI and algebraic multigrid (PETSc's
# GAMG) solve the same matrix.
#
#     python3 demos/demo_nearly_incompressible.py

# +
from mpi4py import MPI
from petsc4py import PETSc

import matplotlib.pyplot as plt
import numpy as np

import dolfinx
import dolfinx.fem.petsc
import ufl

from dolfinx_feti import NonlinearProblem
from dolfinx_feti.comparison import assembled_system, relative_residual
from dolfinx_feti.output import pictures

comm = MPI.COMM_WORLD
mesh = dolfinx.mesh.create_box(
    comm, [(0.0, 0.0, 0.0), (3.0, 1.0, 1.0)], (12, 4, 4), cell_type=dolfinx.mesh.CellType.hexahedron
)
# -

# ## A pressure in each cell
#
# Linear elements for the displacement alone would *lock*. Here u is quadratic and a pressure p is
# linear in each cell, with the energy
#
# $$ Π(u, p) = \int_Ω μ\, e : e + p \operatorname{div} u - \frac{p^2}{2κ} - f · u \,\mathrm dX,
#    \qquad e = ε - \tfrac13 \operatorname{tr}(ε)\, I . $$
#
# `condense=p` eliminates p cell by cell, so that the solver sees displacements only. The energy is
# quadratic: Newton's method needs a single step. The tolerance is 1e-7 instead of 1e-8: at the
# largest κ, rounding leaves a residual of 1e-8.

# +
mu = 1.0
V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (3,)))
u = dolfinx.fem.Function(V, name="u")
p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DPC", 1)), name="p")
kappa = dolfinx.fem.Constant(mesh, 1.0)

e = ufl.dev(ufl.sym(ufl.grad(u)))
weight = ufl.as_vector((0.0, 0.0, -1e-3))
psi = mu * ufl.inner(e, e) + p * ufl.div(u) - p**2 / (2 * kappa)
energy = (psi - ufl.inner(weight, u)) * ufl.dx


def clamp(x):
    return np.isclose(x[0], 0.0)


clamped = dolfinx.mesh.locate_entities_boundary(mesh, 2, clamp)
bc = dolfinx.fem.dirichletbc(np.zeros(3), dolfinx.fem.locate_dofs_topological(V, 2, clamped), V)
problem = NonlinearProblem(
    energy,
    u,
    bcs=[bc],
    condense=p,
    subdomains=8,
    petsc_options={"snes_rtol": 1e-5, "ksp_rtol": 1e-7},
)
# -

# ## GAMG on the same matrix
#
# `assembled_system` assembles an ordinary PETSc matrix from the torn one, with unit rows at the
# Dirichlet dofs. At rest the residual is the weight alone, which dolfinx assembles. Multigrid needs
# the rigid body modes, which are attached to the torn matrix.

# +
load = dolfinx.fem.petsc.assemble_vector(
    dolfinx.fem.form(ufl.inner(weight, ufl.TestFunction(V)) * ufl.dx)
)
load.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
dolfinx.fem.petsc.set_bc(load, [bc])


def gamg(K, f):
    """Solve by CG with GAMG; return the iterations and the relative residual."""
    ksp = PETSc.KSP().create(comm)
    ksp.setOperators(K)
    ksp.setType("cg")
    ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
    ksp.getPC().setType("gamg")
    ksp.setTolerances(rtol=1e-7, max_it=4000)
    x = f.duplicate()
    ksp.solve(f, x)
    return ksp.getIterationNumber(), relative_residual(K, f, x)


kappas = [1e1, 1e2, 1e3, 1e4, 1e5]
feti_iterations = []
gamg_iterations = []
deflections = []
for value in kappas:
    kappa.value = value
    u.x.array[:] = 0.0
    p.x.array[:] = 0.0
    problem.solve()
    step = problem.history[0]
    K, f = assembled_system(problem.A, load)
    K.setNearNullSpace(problem.A.getNearNullSpace())
    count, residual = gamg(K, f)
    feti_iterations.append(step.linear_iterations)
    gamg_iterations.append(count)
    lowest = u.x.array.reshape(-1, 3)[:, 2].min(initial=0.0)
    deflections.append(-comm.allreduce(lowest, op=MPI.MIN))
    assert step.linear_residual <= 1e-7
    if comm.rank == 0:
        print(f"κ = {value:8.0f}: {step.linear_iterations} iterations of FETI, {count} of GAMG")
# -

# ## What κ does to the iterations
#
# The matrix of the subdomains contains κ, but the weights of the scaling come from the tangent
# *before* p is condensed, and the coarse space represents the flow of volume from subdomain to
# subdomain. FETI's iterations therefore hardly depend on κ. GAMG's coarse spaces do not represent
# volumes, and its iterations grow. For a *compressible* material (the left end) GAMG is still
# cheaper, because its set-up and iterations cost less.

# +
if comm.rank == 0:
    fig, ax = plt.subplots(figsize=(6, 4))
    ax.loglog(kappas, feti_iterations, "o-", label="FETI")
    ax.loglog(kappas, gamg_iterations, "s--", label="GAMG")
    ax.set_xlabel("bulk modulus over shear modulus, κ/μ")
    ax.set_ylabel("iterations to 1e-7")
    ax.legend()
    fig.savefig("iterations.png", dpi=150)

assert max(feti_iterations) <= 1.5 * min(feti_iterations)
assert gamg_iterations[-1] >= 5 * gamg_iterations[0]
assert abs(deflections[-1] / deflections[-2] - 1.0) < 1e-3  # no locking
# -

# ## The block

pictures.draw(
    "nearly_incompressible.png",
    pictures.subdomains(problem, title="8 subdomains"),
    pictures.field(p, "pressure / μ", displacement=20 * u, title="displacement × 20"),
)
