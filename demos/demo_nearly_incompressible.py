# # Nearly incompressible: κ from 10 to 100 000
#
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
#
# A material that hardly changes its volume is what this package is made for. A block is bent while
# its bulk modulus κ grows by four orders of magnitude; FETI and algebraic multigrid (PETSc's GAMG)
# solve the same matrix.
#
#     python3 demos/demo_nearly_incompressible.py

# +
from pathlib import Path

from mpi4py import MPI
from petsc4py import PETSc

import matplotlib.pyplot as plt
import numpy as np

import dolfinx
import dolfinx.fem.petsc
import ufl

from dolfinx_feti import NonlinearProblem
from dolfinx_feti.comparison import assembled_system, relative_residual
from dolfinx_feti.output import writable_folder

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
MU = 1.0
V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (3,)))
u = dolfinx.fem.Function(V, name="u")
p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DPC", 1)), name="p")
kappa = dolfinx.fem.Constant(mesh, 1.0)

e = ufl.dev(ufl.sym(ufl.grad(u)))
weight = ufl.as_vector((0.0, 0.0, -1e-3))
energy = (
    MU * ufl.inner(e, e) + p * ufl.div(u) - p**2 / (2 * kappa) - ufl.inner(weight, u)
) * ufl.dx

clamped = dolfinx.mesh.locate_entities_boundary(mesh, 2, lambda x: np.isclose(x[0], 0.0))
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
# `assembled_system` makes an ordinary PETSc matrix of the torn one, with unit rows at the Dirichlet
# dofs. At rest the residual is the weight alone, which dolfinx assembles. Multigrid needs the rigid
# body modes; the torn matrix carries them along.

# +
load = dolfinx.fem.petsc.assemble_vector(
    dolfinx.fem.form(ufl.inner(weight, ufl.TestFunction(V)) * ufl.dx)
)
load.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
dolfinx.fem.petsc.set_bc(load, [bc])


def gamg(K: PETSc.Mat, f: PETSc.Vec) -> tuple[int, float]:
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
iterations: dict[str, list[int]] = {"FETI": [], "GAMG": []}
residuals, sunk = [], []
for value in kappas:
    kappa.value = value
    u.x.array[:] = 0.0
    p.x.array[:] = 0.0
    problem.solve()
    (step, *_) = problem.history
    K, f = assembled_system(problem.A, load)
    K.setNearNullSpace(problem.A.getNearNullSpace())
    steps, residual = gamg(K, f)
    iterations["FETI"].append(step.linear_iterations)
    iterations["GAMG"].append(steps)
    residuals.append(step.linear_residual)
    lowest = u.x.array.reshape(-1, 3)[:, 2].min(initial=0.0)
    sunk.append(-comm.allreduce(lowest, op=MPI.MIN))
    if comm.rank == 0:
        print(
            f"κ = {value:8.0f}   FETI {step.linear_iterations:4d} iterations, GAMG {steps:4d} "
            f"(residual {residual:.0e})   the end sinks by {sunk[-1]:.6f}"
        )
# -

# ## What κ does to the iterations
#
# The matrix of the subdomains contains κ, but the weights of the scaling are taken from the tangent
# *before* p is condensed into it, and the coarse space lets volume flow from subdomain to
# subdomain. So FETI hardly notices κ. GAMG's coarse spaces do not know about volumes: its
# iterations grow. In a *compressible* material (the left end) it is the cheaper method all the
# same, for an iteration of it and its set-up cost less.

# +
folder = writable_folder(Path("output/nearly_incompressible"), comm)
if comm.rank == 0:
    fig, ax = plt.subplots(figsize=(6, 4))
    for (name, count), line in zip(iterations.items(), ("o-", "s--"), strict=True):
        ax.loglog(kappas, count, line, label=name)
    ax.set_xlabel("bulk modulus over shear modulus, κ/μ")
    ax.set_ylabel("iterations to 1e-7")
    ax.grid(which="both", color="0.92")
    ax.legend(frameon=False)
    fig.savefig(folder / "iterations.png", dpi=150, bbox_inches="tight")

assert max(residuals) <= 1e-7
assert max(iterations["FETI"]) <= 1.5 * min(iterations["FETI"])
assert iterations["GAMG"][-1] >= 5 * iterations["GAMG"][0]
assert abs(sunk[-1] / sunk[-2] - 1.0) < 1e-3  # no locking: the limit of κ → ∞ is reached
