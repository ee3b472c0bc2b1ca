# # An artery under a pulse
#
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
#
# The wall of an artery at 80 mmHg meets a blow of 40 mmHg in 2 ms, so short that its mass counts,
# with tissue around it that damps. Forms are those of an equilibrium, plus the inertia of a
# `Motion`; time steps adapt to their error, and the energies balance.
#
#     python3 demos/demo_pulse.py
#
# Lengths are in mm, stresses in kPa, times in s, and so masses in kg.

# +
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

# ## A quarter of a slice, with two families of fibres at 29° to the circumference

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
    dolfinx.mesh.locate_entities_boundary(mesh, 2, lambda x, R=R: np.isclose(np.hypot(*x[:2]), R))
    for R in (INNER, OUTER)
]
order = np.argsort(np.concatenate(marked))
values = np.repeat(np.array([1, 2], dtype=np.int32), [len(part) for part in marked])
tags = dolfinx.mesh.meshtags(mesh, 2, np.concatenate(marked)[order], values[order])
ds = ufl.Measure("ds", mesh, subdomain_data=tags, metadata={"quadrature_degree": 4})
lumen, outside = ds(1), ds(2)

X = ufl.SpatialCoordinate(mesh)
R = ufl.sqrt(X[0] ** 2 + X[1] ** 2)
around, along = ufl.as_vector([-X[1] / R, X[0] / R, 0.0]), ufl.as_vector([0.0, 0.0, 1.0])
a1, a2 = (ufl.cos(α) * around + ufl.sin(α) * along for α in np.radians([29.0, -29.0]).tolist())
# -

# ## Forces
#
# `motion.inertia` is an energy, `motion.rate` the velocity; both are zero until the motion begins.

# +
u, v = dolfinx.fem.Function(V, name="u"), ufl.TestFunction(V)
p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)), name="p")
pressure = dolfinx.fem.Constant(mesh, 0.0)
motion = Motion(u, DENSITY)

F = kinematics.deformation_gradient(u)
C, J = kinematics.right_cauchy_green(F), kinematics.jacobian(F)
psi = materials.holzapfel_gasser_ogden(C, a1, a2, c=3.0, k1=2.3632, k2=0.8393, J=J)
psi += materials.perturbed_lagrangian(J, p, kappa=1000.0)
stored = psi * ufl.dx(metadata={"quadrature_degree": 4})
pushed = loads.follower_pressure(pressure, u, v, lumen)
inside = ufl.derivative(stored + motion.inertia, u, v)
inside += DASHPOT * ufl.inner(motion.rate, v) * outside
K = ufl.derivative(inside, u, du := ufl.TrialFunction(V))
K += loads.follower_pressure_tangent(pressure, u, v, du, lumen, bcs=bcs)
forms = [inside + pushed, ufl.derivative(stored, p, ufl.TestFunction(p.function_space))]
problem = NonlinearProblem(forms, u, bcs=bcs, J=K, condense=p, quadrature_degree=4, subdomains=4)
# -

# ## To 80 mmHg, a blow that is $\sin^2$ of time, and rest


# +
def set_pressure(mmhg: float) -> None:
    """Set the pressure in the lumen."""
    pressure.value = loads.mmhg(mmhg)


def integral(form: ufl.Form) -> float:
    """Integrate over all processes."""
    return comm.allreduce(dolfinx.fem.assemble_scalar(dolfinx.fem.form(form)))


def record(step) -> None:
    """Keep time, pressure, inner radius and energies."""
    a = INNER + integral(ufl.inner(u, X - X[2] * along) / R * lumen) / integral(1.0 * lumen)
    rows.append((step.load, pressure.value / loads.mmhg(1.0), a, step.kinetic, step.stored))


rows = []
follow_load(problem, set_pressure, [REST], Steps(first=5.0, least=0.1), state=[u, p])
begun = integral(stored)
steps = follow_time(
    problem,
    motion,
    lambda t: set_pressure(REST + PULSE * np.sin(np.pi * min(t / DURATION, 1.0)) ** 2),
    [2.0 * DURATION],
    TimeSteps(first=2e-5, least=1e-7, longest=1e-4, tolerance=2e-4),
    state=[u, p],
    energy=stored,
    forces=-pushed - DASHPOT * ufl.inner(motion.velocity, v) * outside,
    on_step=record,
)
# -

# ## What the pressure has put in, less what the dashpots have taken, is in the wall

# +
times, pressures, radii, kinetic, energies = np.array(rows).T
work = np.cumsum([step.work for step in steps])
lacking = np.abs(kinetic + energies - begun - work).max() / np.abs(energies - begun).max()
if comm.rank == 0:
    its = [step.linear_iterations for made in steps for step in made.history]
    print(f"{len(steps)} time steps, {len(its)} Newton steps; energies balance to {lacking:.1e}")
assert lacking < 1e-3
folder = writable_folder(Path("output/pulse"), comm)
if comm.rank == 0:
    fig, (left, right) = plt.subplots(1, 2, figsize=(9, 3.5), layout="constrained")
    left.plot(1e3 * times, pressures)
    left.set(xlabel="time [ms]", ylabel="pressure [mmHg]")
    right.plot(radii, pressures, ".-")
    right.set(xlabel="inner radius [mm]", ylabel="pressure [mmHg]")
    fig.savefig(folder / "pulse.png", dpi=150)
