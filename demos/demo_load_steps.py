# # Load steps, checkpoints, and a run that was interrupted
#
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
#
# A clamped membrane is inflated in load steps. Then a second run stops half-way, as at a time limit
# on a cluster, and a third continues from its checkpoint. Both must reach the same state.
#
#     python3 demos/demo_load_steps.py
#
# Units: mm, kPa; pressures in mmHg.

# +
import shutil

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, kinematics, loads, materials
from dolfinx_feti.loading import Checkpoint, Steps, follow_load
from dolfinx_feti.output import pictures

comm = MPI.COMM_WORLD
mesh = dolfinx.mesh.create_box(comm, [(0.0, 0.0, 0.0), (4.0, 4.0, 0.5)], (8, 8, 1))
# -

# ## The problem
#
# The membrane of rubber, with c = 3 kPa and κ = 100 kPa, is clamped at its rim. A pressure from
# below follows the surface; with a clamped rim it has a potential, so that the problem is one
# energy.

# +
V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (3,)))
u = dolfinx.fem.Function(V, name="u")
p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)), name="p")
pressure = dolfinx.fem.Constant(mesh, 0.0)


def on_rim(x):
    return np.isclose(x[0] % 4, 0) | np.isclose(x[1] % 4, 0)


def below(x):
    return np.isclose(x[2], 0.0)


rim = dolfinx.mesh.locate_entities_boundary(mesh, 2, on_rim)
bc = dolfinx.fem.dirichletbc(np.zeros(3), dolfinx.fem.locate_dofs_topological(V, 2, rim), V)
loaded = dolfinx.mesh.locate_entities_boundary(mesh, 2, below)
tags = dolfinx.mesh.meshtags(mesh, 2, np.sort(loaded), 1)
ds = ufl.Measure("ds", mesh, subdomain_data=tags)

F = kinematics.deformation_gradient(u)
C = kinematics.right_cauchy_green(F)
J = kinematics.jacobian(F)
psi = materials.neo_hookean(C, c=3.0, J=J) + materials.perturbed_lagrangian(J, p, kappa=100.0)
energy = psi * ufl.dx + loads.pressure_potential(pressure, u, ds(1))
problem = NonlinearProblem(energy, u, bcs=[bc], condense=p, subdomains=8, quadrature_degree=4)
# -

# ## Without interruption
#
# `follow_load` goes from equilibrium to equilibrium. The first increment is 1 mmHg; after a quick
# step it grows by a half. `on_step` is called in each equilibrium. Here it records the height.

# +
steps = Steps(first=1.0, least=0.05, growth=1.5)
target = 5.0  # mmHg


def set_pressure(mmhg):
    pressure.value = loads.mmhg(mmhg)


def height():
    """Return how far the membrane has risen [mm]."""
    return comm.allreduce(u.x.array.reshape(-1, 3)[:, 2].max(initial=0.0), op=MPI.MAX)


heights = [(0.0, 0.0)]


def record(step):
    heights.append((step.load, height()))


path = follow_load(problem, set_pressure, [target], steps, on_step=record, unit="mmHg")
uninterrupted = u.x.array.copy()
in_one_go = heights
if comm.rank == 0:
    for step, (_, risen) in zip(path, heights[1:], strict=True):
        iterations = [newton.linear_iterations for newton in step.history]
        print(f"{step.load:5.2f} mmHg  {risen:.4f} mm  FETI iterations {iterations}")
# -

# The subdomains, and the inflated membrane:

pictures.draw(
    "membrane.png",
    pictures.subdomains(problem, title="8 subdomains"),
    pictures.field(u, "displacement |u| [mm]", displacement=u, title="at 5 mmHg"),
    viewer=(0.4, -0.85, 0.7),
)

# ## Interrupted
#
# The second run starts at rest, with a checkpoint in a folder, and ends at 2 mmHg. The checkpoint
# stores your parameters; a restart with other parameters is an error.

# +
parameters = {"c [kPa]": 3.0, "κ [kPa]": 100.0}
if comm.rank == 0:
    shutil.rmtree("checkpoint", ignore_errors=True)  # of an earlier run of this demo
comm.Barrier()

u.x.array[:] = 0.0
p.x.array[:] = 0.0
heights = [(0.0, 0.0)]
checkpoint = Checkpoint("checkpoint", comm, parameters=parameters)
follow_load(problem, set_pressure, [2.0], steps, on_step=record, checkpoint=checkpoint, unit="mmHg")
before = heights
# -

# ## Continued
#
# A new program would create the same problem and open the checkpoint with `restart=True`. Its state
# replaces the current one.

# +
u.x.array[:] = 0.0
p.x.array[:] = 0.0
heights = []
checkpoint = Checkpoint("checkpoint", comm, parameters=parameters, restart=True)
all_steps = follow_load(
    problem, set_pressure, [target], steps, on_step=record, checkpoint=checkpoint, unit="mmHg"
)
after = heights
# -

# `follow_load` returns all steps, including those before the restart. The intermediate loads differ
# from those of the first run, because the second run stopped at exactly 2 mmHg; the final states
# must agree.

# +
difference = np.abs(u.x.array - uninterrupted).max(initial=0.0)
difference = comm.allreduce(difference, op=MPI.MAX) / height()
if comm.rank == 0:
    print(f"{len(all_steps)} load steps, {len(after)} of them after the restart")
    print(f"relative difference to the run without interruption {difference:.1e}")

    fig, ax = plt.subplots(figsize=(6, 4))
    ax.plot(*np.transpose(in_one_go), "o-", color="0.6", label="in one go")
    ax.plot(*np.transpose(before), "s", label="until the interruption")
    ax.plot(*np.transpose(after), "D", label="after the restart")
    ax.set_xlabel("pressure [mmHg]")
    ax.set_ylabel("height [mm]")
    ax.legend()
    fig.savefig("load_steps.png", dpi=150)
assert difference < 1e-6
