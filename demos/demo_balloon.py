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
# A rubber balloon is hard to blow up at first. Then the pressure falls while it grows. Load steps
# cannot pass the maximum of the pressure. This program prescribes the *volume* instead, and the
# pressure becomes a scalar unknown.
#
#     python3 demos/demo_balloon.py

# +
from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, kinematics, materials
from dolfinx_feti.meshes.octant import create_octant
from dolfinx_feti.output import pictures
from dolfinx_feti.scalars import Cavity

comm = MPI.COMM_WORLD
inner = 1.0  # radius
outer = 1.1
mu = 1.0  # shear modulus
# -

# ## Closed form
#
# Rubber keeps its volume, so the stretch b/B of the outer radius follows from that of the inner
# one, a/A. For a neo-Hookean material the balance of the radial stress gives the pressure
#
# $$ P = μ \left[ \frac 2λ + \frac 1{2 λ^4} \right]_{λ = a/A}^{b/B} . $$


# +
def exact_pressure(stretch):
    """Return the pressure at a stretch of the inner radius."""
    outer_stretch = np.cbrt(1 + (stretch**3 - 1) * (inner / outer) ** 3)
    at_outside = 2 / outer_stretch + 0.5 / outer_stretch**4
    at_inside = 2 / stretch + 0.5 / stretch**4
    return mu * (at_outside - at_inside)


# -

# ## An octant
#
# Three planes of symmetry cut out an octant of the balloon. Its points slide in these planes.

# +
mesh = create_octant(comm, divisions=5, through=1, inner=inner, outer=outer)
V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (3,)))
u = dolfinx.fem.Function(V, name="u")
p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)), name="p")

bcs = []
for axis in range(3):

    def on_plane(x, axis=axis):
        return np.isclose(x[axis], 0.0)

    facets = dolfinx.mesh.locate_entities_boundary(mesh, 2, on_plane)
    dofs = dolfinx.fem.locate_dofs_topological(V.sub(axis), 2, facets)
    bcs.append(dolfinx.fem.dirichletbc(0.0, dofs, V.sub(axis)))


def at_lumen(x):
    return np.isclose(np.linalg.norm(x, axis=0), inner)


lumen = dolfinx.mesh.locate_entities_boundary(mesh, 2, at_lumen)
tags = dolfinx.mesh.meshtags(mesh, 2, np.sort(lumen), 1)
ds = ufl.Measure("ds", mesh, subdomain_data=tags)
# -

# ## The cavity
#
# `Cavity` adds the unknown P and its equation, V(u) = V̄. The energy is that of the wall alone.

# +
F = kinematics.deformation_gradient(u)
C = kinematics.right_cauchy_green(F)
J = kinematics.jacobian(F)
psi = materials.neo_hookean(C, c=mu, J=J) + materials.perturbed_lagrangian(J, p, kappa=1e4)
cavity = Cavity(u, ds(1), volume=4 / 3 * np.pi * inner**3 / 8)
problem = NonlinearProblem(
    psi * ufl.dx, u, bcs=bcs, condense=p, scalars=[cavity], subdomains=8, quadrature_degree=4
)
# -

# ## Filling it
#
# At the maximum of the pressure the tangent of u alone is singular, and behind it has a negative
# eigenvalue. The system of u and P together is regular everywhere.

# +
volume_at_rest = cavity.present_volume()
stretches = [1.1, 1.2, 1.3, 1.4, 1.5, 1.65, 1.85, 2.15, 2.5]
pressures = []
for stretch in stretches:
    cavity.volume.value = volume_at_rest * stretch**3
    problem.solve()
    pressures.append(float(cavity.pressure.value))
    if comm.rank == 0:
        exact = exact_pressure(stretch)
        print(f"a/A = {stretch:.2f}   P/μ = {pressures[-1]:.5f}   exact {exact:.5f}", flush=True)
# -

# ## Compared with the closed form

# +
error = np.abs(pressures / exact_pressure(np.array(stretches)) - 1).max()
if comm.rank == 0:
    print(f"The pressure is off by {100 * error:.2f} % at most.")
    fig, ax = plt.subplots(figsize=(6, 4))
    fine = np.linspace(1.0, 2.5, 200)
    ax.plot(fine, exact_pressure(fine), color="0.6", label="exact")
    ax.plot([1.0, *stretches], [0.0, *pressures], "o", label="FETI, P2–P0")
    ax.set_xlabel("stretch of the inner radius")
    ax.set_ylabel("pressure / μ")
    ax.legend()
    fig.savefig("balloon_curve.png", dpi=150)
assert error < 5e-3
# -

# ## The octant, at rest and filled

pictures.draw(
    "balloon.png",
    pictures.subdomains(problem, title="8 subdomains"),
    pictures.field(
        kinematics.stress_magnitude(kinematics.cauchy_stress(psi, F)),
        "stress magnitude / μ",
        displacement=u,
        title="a/A = 2.5",
    ),
    viewer=(1.0, -0.4, 0.5),
)
