# # Load steps, checkpoints, and a run that was killed
#
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
#
# A clamped membrane is inflated in load steps. Every equilibrium is kept on the disk. Then the run
# is ended half-way, as a cluster's time limit would do, and goes on in a new problem from what is
# there. Both ways have to end in the same state.
#
#     python3 demos/demo_load_steps.py

# +
import shutil
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, kinematics, loads, materials
from dolfinx_feti.loading import Checkpoint, LoadStep, Steps, follow_load
from dolfinx_feti.output import writable_folder
from dolfinx_feti.runtime.collective import on_first

comm = MPI.COMM_WORLD
mesh = dolfinx.mesh.create_box(comm, [(0.0, 0.0, 0.0), (4.0, 4.0, 0.5)], (8, 8, 1))  # mm
# -

# ## The problem
#
# Rubber with c = 3 kPa and κ = 100 kPa, clamped at its rim, and a pressure from below that follows
# the surface. A function makes the problem, because it is needed three times: uninterrupted, up to
# the interruption, and after it.


# +
def membrane() -> tuple:
    """Return problem, displacement, condensed pressure, and the load."""
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (3,)))
    u = dolfinx.fem.Function(V, name="u")
    p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)), name="p")
    pressure = dolfinx.fem.Constant(mesh, 0.0)
    rim = dolfinx.mesh.locate_entities_boundary(
        mesh, 2, lambda x: np.isclose(x[0] % 4, 0) | np.isclose(x[1] % 4, 0)
    )
    bc = dolfinx.fem.dirichletbc(np.zeros(3), dolfinx.fem.locate_dofs_topological(V, 2, rim), V)
    below = dolfinx.mesh.locate_entities_boundary(mesh, 2, lambda x: np.isclose(x[2], 0.0))
    tags = dolfinx.mesh.meshtags(mesh, 2, np.sort(below), np.ones(len(below), dtype=np.int32))
    ds = ufl.Measure("ds", mesh, subdomain_data=tags)(1)
    F = kinematics.deformation_gradient(u)
    C, J = kinematics.right_cauchy_green(F), kinematics.jacobian(F)
    psi = materials.neo_hookean(C, c=3.0, J=J) + materials.perturbed_lagrangian(J, p, 100.0)
    energy = psi * ufl.dx + loads.pressure_potential(pressure, u, ds)
    problem = NonlinearProblem(energy, u, bcs=[bc], condense=p, subdomains=8, quadrature_degree=4)
    return problem, u, p, pressure


def height(u: dolfinx.fem.Function) -> float:
    """Return how far the membrane has risen [mm]."""
    return comm.allreduce(u.x.array.reshape(-1, 3)[:, 2].max(initial=0.0), op=MPI.MAX)


# -

# ## Without interruption
#
# `follow_load` goes from equilibrium to equilibrium. The first increment is 1 mmHg; after a quick
# step it grows. `on_step` is called in each equilibrium: here it keeps load and height, in
# `demo_artery.py` it writes the fields.

# +
STEPS = Steps(first=1.0, least=0.05, growth=1.5)
TARGET = 8.0  # mmHg


def inflate(target: float, checkpoint: Checkpoint | None = None) -> tuple:
    """Inflate the membrane, or go on from the checkpoint; return u, the steps and the heights."""
    problem, u, p, pressure = membrane()
    heights: list[tuple[float, float]] = []

    def keep(step: LoadStep) -> None:
        heights.append((step.load, height(u)))

    steps = follow_load(
        problem,
        lambda mm: setattr(pressure, "value", loads.mmhg(mm)),
        [target],
        STEPS,
        state=[u, p],
        on_step=keep,
        checkpoint=checkpoint,
        unit="mmHg",
    )
    return u, steps, heights


whole, steps, heights = inflate(TARGET)
if comm.rank == 0:
    for step, (_, risen) in zip(steps, heights, strict=True):
        linear = sum(s.linear_iterations for s in step.history)
        print(
            f"{step.load:6.2f} mmHg  {risen:.4f} mm  {len(step.history)} Newton steps, "
            f"{linear} FETI iterations"
        )
# -

# ## Interrupted
#
# The same with a checkpoint, ended at 3 mmHg. A checkpoint is a folder; parameters that belong to
# the problem are kept in it, and a state of other ones is refused. A new state is written under
# another name, brought to the disk and renamed: a run may be killed at any moment.

# +
folder = writable_folder(Path("output/load_steps"), comm)
kept, parameters = folder / "run", {"c [kPa]": 3.0, "κ [kPa]": 100.0}
on_first(lambda: shutil.rmtree(kept, ignore_errors=True), comm)

_, _, before = inflate(3.0, Checkpoint(kept, comm, parameters=parameters))

checkpoint = Checkpoint(kept, comm, parameters=parameters, restart=True)
if comm.rank == 0:
    print(f"\ngoes on from {checkpoint.record['loads'][-1]:g} mmHg")
again, all_steps, after = inflate(TARGET, checkpoint)
# -

# `follow_load` returns all steps, those before the restart included; `on_step` was called for the
# new ones only. The loads on the way differ, for 3 mmHg was met exactly; the end must not.

# +
difference = np.abs(again.x.array - whole.x.array).max(initial=0.0)
difference = comm.allreduce(difference, op=MPI.MAX) / height(whole)
if comm.rank == 0:
    print(f"{len(all_steps)} load steps, {len(after)} of them after the restart")
    print(f"relative difference to the run without interruption {difference:.1e}")
    fig, ax = plt.subplots(figsize=(6, 4))
    ax.plot(*np.transpose([(0.0, 0.0), *heights]), "o-", color="0.6", label="in one go")
    ax.plot(*np.transpose(before), "s", label="until it was ended")
    ax.plot(*np.transpose(after), "D", label="after the restart")
    ax.set_xlabel("pressure [mmHg]")
    ax.set_ylabel("height [mm]")
    ax.grid(color="0.92")
    ax.legend(frameon=False)
    fig.savefig(folder / "heights.png", dpi=150, bbox_inches="tight")
assert len(all_steps) == len(before) + len(after)
assert difference < 1e-6
