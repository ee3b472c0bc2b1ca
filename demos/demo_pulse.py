# # An artery under a pulse
#
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
#
# The pressure in an artery at 80 mmHg rises by 40 mmHg and falls again within 2 ms, so fast that
# the mass of the wall counts. The tissue around it damps the motion. The forms are those of an
# equilibrium, plus the inertia of a `Motion`. The time steps adapt to their estimated error.
#
#     python3 demos/demo_pulse.py
#
# Units: mm, kPa, s, and hence kg; pressures in mmHg.

# +
from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, kinematics, loads, materials
from dolfinx_feti.loading import Motion, Steps, TimeSteps, follow_load, follow_time
from dolfinx_feti.meshes.walls import create_tube_wall
from dolfinx_feti.wall import (
    Pressure,
    Slide,
    apply_conditions,
    fibre_families,
    fibre_frame,
    surface_measure,
)

comm = MPI.COMM_WORLD
density = 1.1e-6  # kg/mm³
viscosity = 5e-3  # of the tissue around the artery [kPa s/mm]
duration = 0.002  # of the pulse [s]
# -

# ## A quarter of a slice
#
# The tube has two layers with two families of fibres each. A quarter of a short piece is enough: it
# slides in its planes of symmetry and at its ends.

# +
wall = create_tube_wall(comm, length=0.2, quarter=True, through=(2, 1), around=8, along=1)
a1, a2 = fibre_families(wall, fibre_frame(wall))
mesh = wall.mesh

V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (3,)))
u = dolfinx.fem.Function(V, name="u")
v = ufl.TestFunction(V)
p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)), name="p")
conditions = {
    "lumen": Pressure(),
    "opening_1": Slide(),
    "opening_2": Slide(),
    "symmetry_x": Slide(),
    "symmetry_y": Slide(),
}
boundary = apply_conditions(wall, u, conditions)
# -

# ## Forces
#
# The residual is the sum of stress, inertia and damping,
#
# $$ \int_Ω P(u) : \nabla v + ρ\, \ddot u · v \,\mathrm dx + \int_{Γ} η\, \dot u · v \,\mathrm ds ,
#    \qquad P = \partial Ψ / \partial F . $$
#
# `motion.inertia` is an energy, whose derivative is the second term. `motion.rate` is the
# velocity. Both are zero until the motion begins. The boundary adds the pressure.

# +
motion = Motion(u, density)
F = kinematics.deformation_gradient(u)
C = kinematics.right_cauchy_green(F)
J = kinematics.jacobian(F)
psi = materials.holzapfel_gasser_ogden(C, a1, a2, c=3.0, k1=2.3632, k2=0.8393, J=J)
psi += materials.perturbed_lagrangian(J, p, kappa=1e5)
stored = psi * ufl.dx(metadata={"quadrature_degree": 4})

ds = surface_measure(wall)
outside = ds(wall.surfaces["outer"])
F_u = ufl.derivative(stored + motion.inertia, u, v)
F_u += viscosity * ufl.inner(motion.rate, v) * outside
F_p = ufl.derivative(stored, p, ufl.TestFunction(p.function_space))
problem = NonlinearProblem(
    [F_u, F_p], u, boundary=boundary, condense=p, subdomains=4, quadrature_degree=4
)
# -

# ## To 80 mmHg, and the pulse
#
# `follow_load` computes the equilibrium at 80 mmHg. Then `follow_time` integrates the motion for 4
# ms. Given the stored energy and the external forces, it also records energy and work.


# +
def set_pressure(mmhg):
    boundary.set_pressure(loads.mmhg(mmhg))


def set_time(t):
    """Set the pressure at a time: sin² in the pulse."""
    share = min(t / duration, 1.0)
    set_pressure(80.0 + 40.0 * np.sin(np.pi * share) ** 2)


def integral(form):
    return comm.allreduce(dolfinx.fem.assemble_scalar(dolfinx.fem.form(form)))


lumen = ds(wall.surfaces["lumen"])
X = ufl.SpatialCoordinate(mesh)
outward = ufl.as_vector([X[0], X[1], 0.0]) / ufl.sqrt(X[0] ** 2 + X[1] ** 2)
area = integral(1.0 * lumen)
records = []


def record(step):
    """Record time, pressure, displacement of the lumen, and energies."""
    displacement = integral(ufl.inner(u, outward) * lumen) / area
    mmhg = float(boundary.pressure.value) / loads.mmhg(1.0)
    records.append((step.load, mmhg, displacement, step.kinetic, step.stored))


follow_load(problem, set_pressure, [80.0], Steps(first=5.0, least=0.1), unit="mmHg")
stored_at_start = integral(stored)
steps = follow_time(
    problem,
    motion,
    set_time,
    [2.0 * duration],
    TimeSteps(first=2e-5, least=1e-7, longest=1e-4, tolerance=2e-4),
    energy=stored,
    forces=-boundary.residual - viscosity * ufl.inner(motion.velocity, v) * outside,
    on_step=record,
)
# -

# ## The balance of energy
#
# The work of the pressure, minus the energy dissipated by the tissue, is stored in the wall.

# +
times, pressures, displacements, kinetic, stored_energies = np.array(records).T
work = np.cumsum([step.work for step in steps])
gained = stored_energies - stored_at_start
imbalance = np.abs(kinetic + gained - work).max() / np.abs(gained).max()
if comm.rank == 0:
    print(f"{len(steps)} time steps; the energies balance to {imbalance:.1e}")

    fig, (left, right) = plt.subplots(1, 2, figsize=(9, 3.5), layout="constrained")
    left.plot(1e3 * times, pressures)
    left.set_xlabel("time [ms]")
    left.set_ylabel("pressure [mmHg]")
    right.plot(displacements, pressures, ".-")
    right.set_xlabel("displacement of the lumen [mm]")
    right.set_ylabel("pressure [mmHg]")
    fig.savefig("pulse.png", dpi=150)
assert imbalance < 1e-3
