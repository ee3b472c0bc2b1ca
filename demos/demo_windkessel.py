# # An artery that drains into a Windkessel
#
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
#
# The heart ejects blood into an artery, and the vessels behind it resist. The pressure follows
# from the flow, the stiffness of the wall and a *Windkessel*. Here five beats fill an artery from
# rest.
#
#     python3 demos/demo_windkessel.py
#
# Units: mm, kPa, s.

# +
from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, kinematics, materials
from dolfinx_feti.loading import Steps, follow_load
from dolfinx_feti.meshes.walls import create_tube_wall
from dolfinx_feti.scalars import Cavity, Windkessel
from dolfinx_feti.wall import (
    Dashpot,
    Slide,
    apply_conditions,
    fibre_families,
    fibre_frame,
    surface_measure,
)

comm = MPI.COMM_WORLD
stroke = 0.12  # volume that a beat ejects [mm³]
ejection = 0.3  # how long it does so [s]
beat = 0.8  # s
time_step = 0.04  # s
# -

# ## The wall
#
# A quarter of a slice of a tube with two layers slides in its planes of symmetry and at its ends.
# Dashpots model the tissue around it. With κ = 1000 kPa the wall swells a little, which the page on
# compressibility measures; for results take 10⁵ kPa.

# +
wall = create_tube_wall(comm, length=0.2, quarter=True, through=(1, 1), around=6, along=1)
a1, a2 = fibre_families(wall, fibre_frame(wall))

V = dolfinx.fem.functionspace(wall.mesh, ("Lagrange", 2, (3,)))
u = dolfinx.fem.Function(V, name="u")
p = dolfinx.fem.Function(dolfinx.fem.functionspace(wall.mesh, ("DG", 0)), name="p")
conditions = {
    "outer": Dashpot(2.0),  # kPa s/mm
    "opening_1": Slide(),
    "opening_2": Slide(),
    "symmetry_x": Slide(),
    "symmetry_y": Slide(),
}
boundary = apply_conditions(wall, u, conditions)
boundary.time_step.value = time_step

F = kinematics.deformation_gradient(u)
C = kinematics.right_cauchy_green(F)
J = kinematics.jacobian(F)
psi = materials.holzapfel_gasser_ogden(C, a1, a2, c=3.0, k1=2.3632, k2=0.8393, J=J)
psi += materials.perturbed_lagrangian(J, p, kappa=1000.0)
# -

# ## The Windkessel
#
# The inflow q that the artery does not store flows on through an impedance Z into a compliance C,
# which drains through a resistance R:
#
# $$ Q = q - \dot V(u), \qquad p = p_c + Z Q, \qquad C\, \dot p_c + p_c / R = Q. $$
#
# V(u) is the volume of the lumen between the ends, which are normal to the axis. Its pressure p is
# an unknown of the problem.

# +
lumen = surface_measure(wall)(wall.surfaces["lumen"])
cavity = Cavity(u, lumen, axis=(0.0, 0.0, 1.0))
windkessel = Windkessel(
    cavity,
    resistance=60.0,  # kPa s/mm³
    compliance=0.003,  # mm³/kPa
    impedance=3.0,  # kPa s/mm³
)
problem = NonlinearProblem(
    psi * ufl.dx,
    u,
    boundary=boundary,
    condense=p,
    scalars=[windkessel],
    subdomains=4,
    quadrature_degree=4,
)
# -

# ## Five beats
#
# `follow_load` steps in time here. In each beat the heart ejects for 0.3 s, as $\sin^2$ of time.


# +
def set_time(t):
    """Set the flow into the artery."""
    share = min(t % beat, ejection) / ejection
    windkessel.inflow.value = 2.0 * stroke / ejection * np.sin(np.pi * share) ** 2


records = [(0.0, 0.0, 0.0, 0.0, cavity.present_volume())]


def record(step):
    """Record time, inflow, outflow, pressure and volume."""
    inflow = float(windkessel.inflow.value)
    pressure = float(cavity.pressure.value)
    volume = cavity.present_volume()
    records.append((step.load, inflow, windkessel.outflow(), pressure, volume))


ends_of_beats = [beat, 2 * beat, 3 * beat, 4 * beat, 5 * beat]
steps = Steps(first=time_step, least=time_step, growth=1.0)
follow_load(problem, set_time, ends_of_beats, steps, on_step=record, unit="s")
# -

# ## What flows in flows out
#
# In the fifth beat the whole stroke leaves, and the mean pressure is R + Z times the mean flow.
# The wall lags behind the pressure: the area of the loop is the energy that the dashpots
# dissipate.

# +
t, inflow, outflow, pressure, volume = np.array(records).T
is_fifth = t >= ends_of_beats[3] - time_step / 2
drained = np.trapezoid(outflow[is_fifth], t[is_fifth])
mean_pressure = np.trapezoid(pressure[is_fifth], t[is_fifth]) / beat
dissipated = np.trapezoid(pressure[is_fifth], volume[is_fifth])
if comm.rank == 0:
    print(f"mean pressure of the fifth beat: {mean_pressure:.1f} kPa")
    print(f"{100 * drained / stroke:.1f} % of the stroke leaves")
    print(f"the dashpots dissipate {dissipated:.2g} µJ")

    fig, axes = plt.subplots(1, 3, figsize=(11, 3.5), layout="constrained")
    axes[0].plot(t, inflow, label="in")
    axes[0].plot(t, outflow, label="out")
    axes[0].set_xlabel("time [s]")
    axes[0].set_ylabel("flow [mm³/s]")
    axes[0].legend()
    axes[1].plot(t, pressure)
    axes[1].set_xlabel("time [s]")
    axes[1].set_ylabel("pressure [kPa]")
    axes[2].plot(volume, pressure, ":", color="grey", label="all beats")
    axes[2].plot(volume[is_fifth], pressure[is_fifth], label="fifth beat")
    axes[2].set_xlabel("volume [mm³]")
    axes[2].set_ylabel("pressure [kPa]")
    axes[2].legend()
    fig.savefig("windkessel.png", dpi=150)
assert abs(drained / stroke - 1.0) < 0.03
assert dissipated > 0.0
