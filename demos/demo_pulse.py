# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: light
# ---

# # An artery under a pulse
#
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
#
# The wall of an artery, inflated to 80 mmHg, meets a pulse of 40 mmHg, so short that
# its mass counts, with tissue around it that damps. Forms are those of an
# equilibrium, plus the inertia of a `Motion`; time steps adapt to their error, and the energies
# balance.
#
#     python3 demos/demo_pulse.py
#
# Lengths are in mm, stresses in kPa, times in s, and so masses in kg.

# +
import math
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, kinematics, loads, materials
from dolfinx_feti.loading import Motion, Steps, TimeSteps, follow_load, follow_time
from dolfinx_feti.output import writable_folder

comm = MPI.COMM_WORLD
INNER, OUTER, LENGTH = 0.71, 1.1, 0.2  # mm
DENSITY, DASHPOT = 1.1e-6, 5e-3  # kg/mm³, kPa s/mm
REST, PULSE, DURATION = 80.0, 40.0, 0.002  # mmHg, mmHg, s
# -

# ## The wall
#
# A quarter of a slice between planes of symmetry, with two families of fibres at 29° to the
# circumference.

# +
mesh = dolfinx.mesh.create_box(comm, [(INNER, 0.0, 0.0), (OUTER, np.pi / 2, LENGTH)], (3, 8, 1))
radius, angle, _ = mesh.geometry.x.T.copy()
mesh.geometry.x[:, 0] = radius * np.cos(angle)
mesh.geometry.x[:, 1] = radius * np.sin(angle)
V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (3,)))
zero = dolfinx.fem.Constant(mesh, 0.0)


def slide(k: int, at: float) -> dolfinx.fem.DirichletBC:
    """Let points slide in a plane normal to axis k."""
    facets = dolfinx.mesh.locate_entities_boundary(mesh, 2, lambda x: np.isclose(x[k], at))
    dofs = dolfinx.fem.locate_dofs_topological(V.sub(k), 2, facets)
    return dolfinx.fem.dirichletbc(zero, dofs, V.sub(k))


bcs = [slide(0, 0.0), slide(1, 0.0), slide(2, 0.0), slide(2, LENGTH)]
marked = [
    dolfinx.mesh.locate_entities_boundary(
        mesh, 2, lambda x, R=R: np.isclose(np.hypot(x[0], x[1]), R)
    )
    for R in (INNER, OUTER)
]
facets = np.concatenate(marked)
values = np.repeat(np.array([1, 2], dtype=np.int32), [len(part) for part in marked])
order = np.argsort(facets)
tags = dolfinx.mesh.meshtags(mesh, 2, facets[order], values[order])
ds = ufl.Measure("ds", mesh, subdomain_data=tags, metadata={"quadrature_degree": 4})
lumen, outside = ds(1), ds(2)

X = ufl.SpatialCoordinate(mesh)
R = ufl.sqrt(X[0] ** 2 + X[1] ** 2)
around, along = ufl.as_vector([-X[1] / R, X[0] / R, 0.0]), ufl.as_vector([0.0, 0.0, 1.0])
cosine, sine = math.cos(math.radians(29.0)), math.sin(math.radians(29.0))
a1, a2 = cosine * around + sine * along, cosine * around - sine * along
# -

# ## Forces
#
# `motion.inertia` is an energy like that of the material, and `motion.rate` the velocity, for the
# dashpots of the tissue outside. Both are zero until the motion begins, so that the same problem
# finds the equilibrium before it.

# +
u, v = dolfinx.fem.Function(V, name="u"), ufl.TestFunction(V)
p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)), name="p")
q = ufl.TestFunction(p.function_space)
pressure = dolfinx.fem.Constant(mesh, 0.0)
motion = Motion(u, DENSITY)

F = kinematics.deformation_gradient(u)
C, J = kinematics.right_cauchy_green(F), kinematics.jacobian(F)
psi = materials.holzapfel_gasser_ogden(C, a1, a2, c=3.0, k1=2.3632, k2=0.8393, J=J)
psi += materials.perturbed_lagrangian(J, p, kappa=1000.0)
stored = psi * ufl.dx(metadata={"quadrature_degree": 4})
pushed = loads.follower_pressure(pressure, u, v, lumen)
F_u = ufl.derivative(stored + motion.inertia, u, v) + pushed
F_u += DASHPOT * ufl.inner(motion.rate, v) * outside
F_p = ufl.derivative(stored, p, q)
du = ufl.TrialFunction(V)
K = ufl.derivative(ufl.derivative(stored + motion.inertia, u, v), u, du)
K += ufl.derivative(DASHPOT * ufl.inner(motion.rate, v) * outside, u, du)
K += loads.follower_pressure_tangent(pressure, u, v, du, lumen, bcs=bcs)
problem = NonlinearProblem(
    [F_u, F_p], u, bcs=bcs, J=K, condense=p, quadrature_degree=4, subdomains=4
)
# -

# ## To 80 mmHg, and on
#
# Inflation is a matter of load steps. Then a pulse, $\sin^2$ of time, runs over the wall, and the
# wall comes to rest after it.


# +
def set_pressure(mmhg: float) -> None:
    """Set the pressure in the lumen."""
    pressure.value = loads.mmhg(mmhg)


def set_time(t: float) -> None:
    """Set the pressure of the pulse."""
    set_pressure(REST + PULSE * np.sin(np.pi * min(t, DURATION) / DURATION) ** 2)


follow_load(problem, set_pressure, [REST], Steps(first=5.0, least=0.1), state=[u, p])

outward = ufl.as_vector((X[0], X[1], 0.0)) / R
area = comm.allreduce(dolfinx.fem.assemble_scalar(dolfinx.fem.form(1.0 * lumen)))
moved = dolfinx.fem.form(ufl.inner(u, outward) * lumen)
rows = []


def record(step) -> None:
    """Keep time, pressure, inner radius and energies."""
    a = INNER + comm.allreduce(dolfinx.fem.assemble_scalar(moved)) / area
    rows.append((step.load, pressure.value / loads.mmhg(1.0), a, step.kinetic, step.stored))


begun = comm.allreduce(dolfinx.fem.assemble_scalar(dolfinx.fem.form(stored)))
steps = follow_time(
    problem,
    motion,
    set_time,
    [2.0 * DURATION],
    TimeSteps(first=2e-5, least=1e-7, longest=1e-4, tolerance=2e-4),
    state=[u, p],
    energy=stored,
    forces=-pushed,
    on_step=record,
)
# -

# ## Energies balance
#
# What the pressure has put in, less what the dashpots have taken, is in the wall: kinetic and
# stored. What lacks is the error of the time steps.

# +
times, pressures, radii, kinetic, energies = np.array(rows).T
work = np.cumsum([step.work - step.dissipated for step in steps])
lacking = np.abs(kinetic + energies - begun - work).max() / np.abs(energies - begun).max()
if comm.rank == 0:
    iterations = [step.linear_iterations for made in steps for step in made.history]
    print(f"{len(steps)} time steps, {len(iterations)} Newton steps of", end=" ")
    print(f"{min(iterations)} to {max(iterations)} iterations; energies balance to {lacking:.1e}")
assert lacking < 1e-3
# -

# ## The wall lags behind

# +
folder = writable_folder(Path("output/pulse"), comm)
if comm.rank == 0:
    fig, (left, right) = plt.subplots(1, 2, figsize=(9, 3.5), layout="constrained")
    left.plot(1e3 * times, pressures)
    left.set(xlabel="time [ms]", ylabel="pressure [mmHg]")
    right.plot(radii, pressures, ".-")
    right.set(xlabel="inner radius [mm]", title="radius under the pulse")
    fig.savefig(folder / "pulse.png", dpi=150)
