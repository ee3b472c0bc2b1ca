# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: light
# ---

# # A tube that drains into a Windkessel
#
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
#
# The heart ejects blood into an artery, and the vessels behind it resist. The pressure follows from
# the flow, the stiffness of the wall and a *Windkessel*. Here five beats fill an artery from rest.
#
#     python3 demos/demo_windkessel.py

# +
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, kinematics, materials, supports
from dolfinx_feti.loading import Steps, follow_load
from dolfinx_feti.output import writable_folder
from dolfinx_feti.scalars import Cavity, Windkessel

comm = MPI.COMM_WORLD
INNER, OUTER, LENGTH = 0.71, 1.1, 0.2  # mm
STROKE, EJECTION, BEAT, BEATS = 0.12, 0.3, 0.8, 5  # mm³, s, s
R, C, Z = 60.0, 0.003, 3.0  # kPa s/mm³, mm³/kPa, kPa s/mm³
VISCOSITY, DT = 2.0, 0.02  # kPa s/mm, s
# -

# ## The wall
#
# A quarter of a slice between planes of symmetry, with two families of fibres at 29° to the
# circumference. The tissue outside damps its motion.

# +
mesh = dolfinx.mesh.create_box(comm, [(INNER, 0.0, 0.0), (OUTER, np.pi / 2, LENGTH)], (2, 6, 1))
radius, angle, _ = mesh.geometry.x.T.copy()
mesh.geometry.x[:, :2] = np.column_stack((radius * np.cos(angle), radius * np.sin(angle)))
V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (3,)))
u, last = dolfinx.fem.Function(V, name="u"), dolfinx.fem.Function(V)
p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)), name="p")


def slide(k: int, at: float) -> dolfinx.fem.DirichletBC:
    """Let points slide in a plane normal to axis k."""
    facets = dolfinx.mesh.locate_entities_boundary(mesh, 2, lambda x: np.isclose(x[k], at))
    dofs = dolfinx.fem.locate_dofs_topological(V.sub(k), 2, facets)
    return dolfinx.fem.dirichletbc(dolfinx.fem.Constant(mesh, 0.0), dofs, V.sub(k))


def at_radius(radius: float) -> np.ndarray:
    """Return the facets at a radius."""
    return dolfinx.mesh.locate_entities_boundary(
        mesh, 2, lambda x: np.isclose(np.hypot(x[0], x[1]), radius)
    )


marked = [at_radius(INNER), at_radius(OUTER)]
facets, values = np.concatenate(marked), np.repeat([1, 2], [len(part) for part in marked])
order = np.argsort(facets)
tags = dolfinx.mesh.meshtags(mesh, 2, facets[order], values[order].astype(np.int32))
ds = ufl.Measure("ds", mesh, subdomain_data=tags, metadata={"quadrature_degree": 4})
bcs = [slide(0, 0.0), slide(1, 0.0), slide(2, 0.0), slide(2, LENGTH)]
X = ufl.SpatialCoordinate(mesh)
r = ufl.sqrt(X[0] ** 2 + X[1] ** 2)
around, along = ufl.as_vector([-X[1] / r, X[0] / r, 0.0]), ufl.as_vector([0.0, 0.0, 1.0])
a1, a2 = (0.8746 * around + sine * along for sine in (0.4848, -0.4848))
F = kinematics.deformation_gradient(u)
strain, J = kinematics.right_cauchy_green(F), kinematics.jacobian(F)
psi = materials.holzapfel_gasser_ogden(strain, a1, a2, c=3.0, k1=2.3632, k2=0.8393, J=J)
psi += materials.perturbed_lagrangian(J, p, kappa=1000.0)
energy = psi * ufl.dx(metadata={"quadrature_degree": 4})
energy += supports.dashpot_energy(VISCOSITY, u, last, DT, ds(2))
# -

# ## The Windkessel
#
# The ends of the cavity are open and normal to its axis. What flows in and is not stored flows on
# through an impedance Z into a compliance C, which drains through a resistance R:
#
# $$ Q = q - \dot V(u), \qquad p = p_c + Z Q, \qquad C\, \dot p_c + p_c / R = Q. $$

# +
cavity = Cavity(u, ds(1), axis=(0.0, 0.0, 1.0))
windkessel = Windkessel(cavity, resistance=R, compliance=C, impedance=Z)
problem = NonlinearProblem(
    energy, u, bcs=bcs, condense=p, quadrature_degree=4, subdomains=4, scalars=[windkessel]
)
# -

# ## Five beats
#
# `follow_load` steps in time. In each beat the heart ejects for 0.3 s, as $\sin^2$ of time.


# +
def set_time(t: float) -> None:
    """Set the flow into the artery."""
    ejected = min(t % BEAT, EJECTION) / EJECTION
    windkessel.inflow.value = 2.0 * STROKE / EJECTION * np.sin(np.pi * ejected) ** 2


def record(step) -> None:
    """Keep time, flow in, flow out, pressure and volume."""
    values = windkessel.inflow.value, windkessel.outflow(), cavity.pressure.value
    rows.append((step.load, *map(float, values), cavity.present_volume()))


rows = [(0.0, 0.0, 0.0, 0.0, cavity.present_volume())]
beats = [BEAT * (n + 1) for n in range(BEATS)]
follow_load(problem, set_time, beats, Steps(first=DT, least=DT, growth=1.0), on_step=record)
# -

# ## What goes in comes out
#
# In the fifth beat all of the stroke leaves, and the mean pressure is R + Z times the mean flow.
# The wall lags behind the pressure: the area of the loop is the energy that dashpots dissipate.

# +
t, inflow, outflow, pressure, volume = np.array(rows).T
beat = t >= beats[-2] - DT / 2
drained, mean = np.trapezoid(outflow[beat], t[beat]), np.trapezoid(pressure[beat], t[beat]) / BEAT
loop = np.trapezoid(pressure[beat], volume[beat])  # ∮ p dV
folder = writable_folder(Path("output/windkessel"), comm)
if comm.rank == 0:
    print(f"The mean pressure of the fifth beat is {mean:.1f} kPa.")
    print(f"{100 * drained / STROKE:.1f} % of the stroke leaves. The dashpots take {loop:.2g} µJ.")
    fig, axes = plt.subplots(1, 3, figsize=(11, 3.5), layout="constrained")
    axes[0].plot(t, inflow, t, outflow)
    axes[0].set(xlabel="time [s]", ylabel="flow [mm³/s]")
    axes[0].legend(["in", "out"])
    axes[1].plot(t, pressure)
    axes[1].set(xlabel="time [s]", ylabel="pressure [kPa]")
    axes[2].plot(volume, pressure, "k:", volume[beat], pressure[beat])
    axes[2].set(xlabel="volume [mm³]", ylabel="pressure [kPa]", title="pressure–volume loop")
    fig.savefig(folder / "loop.png", dpi=150)
assert abs(drained / STROKE - 1.0) < 0.03 and loop > 0.0
