# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: light
# ---

# # A balloon, filled through its limit point
#
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
#
# A rubber balloon is hard to blow up at first. Then the pressure falls while it grows. No load step
# leads over the top of that curve. So the *volume* is prescribed, and the pressure becomes an
# unknown: a scalar beside the displacement.
#
#     python3 demos/demo_balloon.py

# +
import json
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, kinematics, materials
from dolfinx_feti.output import writable_folder
from dolfinx_feti.scalars import Cavity
from meshes.octant import create_octant

comm = MPI.COMM_WORLD
INNER, THICKNESS, MU, KAPPA, STRETCH = 1.0, 0.1, 1.0, 1e4, 2.5
# -

# ## What is known
#
# Rubber keeps its volume, which determines the stretch b/B of the outer radius from that of the
# inner one, a/A. For a neo-Hookean material the balance of the radial stress gives
#
# $$ P = μ \left[ \frac 2λ + \frac 1{2 λ^4} \right]_{λ = a/A}^{b/B} . $$


# +
def exact(stretch: float | np.ndarray) -> float | np.ndarray:
    """Return the pressure at a stretch of the inner radius."""
    outer = np.cbrt(1 + (stretch**3 - 1) * (INNER / (INNER + THICKNESS)) ** 3)
    return MU * (2 / outer + 0.5 / outer**4 - 2 / stretch - 0.5 / stretch**4)


# -

# ## An octant
#
# Three planes of symmetry cut out an octant. Points slide in them.

# +
mesh = create_octant(comm, divisions=5, layers=1, inner=INNER, outer=INNER + THICKNESS)
V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (3,)))
u = dolfinx.fem.Function(V, name="u")
p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)), name="p")


def slide(axis: int) -> dolfinx.fem.DirichletBC:
    """Let points slide in a plane of symmetry."""
    facets = dolfinx.mesh.locate_entities_boundary(mesh, 2, lambda x: np.isclose(x[axis], 0.0))
    dofs = dolfinx.fem.locate_dofs_topological(V.sub(axis), 2, facets)
    return dolfinx.fem.dirichletbc(dolfinx.fem.Constant(mesh, 0.0), dofs, V.sub(axis))


lumen = dolfinx.mesh.locate_entities_boundary(
    mesh, 2, lambda x: np.isclose(np.linalg.norm(x, axis=0), INNER)
)
tags = dolfinx.mesh.meshtags(mesh, 2, np.sort(lumen), np.ones(len(lumen), dtype=np.int32))
ds = ufl.Measure("ds", mesh, subdomain_data=tags)(1)
# -

# ## The cavity
#
# `Cavity` adds the unknown and its equation, V(u) = V̄. The energy is that of the wall alone.

# +
F = kinematics.deformation_gradient(u)
C, J = kinematics.right_cauchy_green(F), kinematics.jacobian(F)
psi = materials.neo_hookean(C, c=MU, J=J) + materials.perturbed_lagrangian(J, p, KAPPA)
cavity = Cavity(u, ds, volume=4 / 3 * np.pi * INNER**3 / 8)
rest = cavity.present_volume()
problem = NonlinearProblem(
    psi * ufl.dx,
    u,
    bcs=[slide(axis) for axis in range(3)],
    condense=p,
    subdomains=8,
    quadrature_degree=4,
    scalars=[cavity],
)
# -

# ## Filling it
#
# The tangent is singular at the top and has a negative eigenvalue behind it. The system with its
# border is regular everywhere, and the steps go on as before.

# +
curve, newton, linear = [[1.0, 0.0]], 0, 0
for stretch in (1.1, 1.2, 1.3, 1.4, 1.5, 1.65, 1.85, 2.15, STRETCH):
    cavity.volume.value = rest * stretch**3
    problem.solve()
    curve.append([stretch, float(cavity.pressure.value)])
    newton += len(problem.history)
    linear += sum(step.linear_iterations for step in problem.history)
    if comm.rank == 0:
        print(f"a/A = {stretch:.2f}   P/μ = {curve[-1][1]:.5f}   exact {exact(stretch):.5f}")
# -

# ## Beside the exact curve

# +
folder = writable_folder(Path("output/balloon"), comm)
computed = np.array(curve[1:])
error = np.abs(computed[:, 1] / exact(computed[:, 0]) - 1).max()
if comm.rank == 0:
    summary = {"stretch_pressure": curve, "newton_iterations": newton, "linear_iterations": linear}
    (folder / "summary.json").write_text(json.dumps(summary))
    print(f"{newton} Newton steps; the pressure is off by at most {100 * error:.2f} %")
    stretches = np.linspace(1.0, STRETCH, 200)
    fig, ax = plt.subplots(figsize=(6, 4))
    ax.plot(stretches, exact(stretches), color="0.6", label="exact")
    ax.plot(*np.transpose(curve), "o", label="FETI, P2–P0")
    ax.set_xlabel("stretch of the inner radius")
    ax.set_ylabel("pressure / μ")
    ax.grid(color="0.92")
    ax.legend(frameon=False)
    fig.savefig(folder / "curve.png", dpi=150, bbox_inches="tight")
assert error < 5e-3 and newton <= 60
