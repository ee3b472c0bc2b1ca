# # Materials with memory
#
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
#
# What a material remembers is a Function, an *internal variable*, with an update in UFL. It changes
# when a state is accepted, by `problem.update_internal_variables()`, or by itself in `follow_load`
# and `follow_time`. A block relaxes and softens here; a ring grows in `demo_growth.py`.
#
#     python3 demos/demo_memory.py

# +
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np

import basix.ufl
import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, kinematics, materials
from dolfinx_feti.loading import Steps, follow_load
from dolfinx_feti.mechanics import memory
from dolfinx_feti.output import writable_folder

comm = MPI.COMM_WORLD
dx = ufl.dx(metadata={"quadrature_degree": 2})
c, kappa = 3.0, 1e5  # kPa
# -

# ## A block between planes of symmetry, stretched along x

# +
mesh = dolfinx.mesh.create_unit_cube(comm, 2, 2, 2)
V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (3,)))
u = dolfinx.fem.Function(V, name="u")
p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)), name="p")
F = kinematics.deformation_gradient(u)
C, J = kinematics.right_cauchy_green(F), kinematics.jacobian(F)
psi = materials.neo_hookean(C, c=c, J=J)
psi_vol = materials.perturbed_lagrangian(J, p, kappa=kappa)
pull = dolfinx.fem.Constant(mesh, 0.0)  # mm


def plane(k: int, at: float, value: float | dolfinx.fem.Constant) -> dolfinx.fem.DirichletBC:
    """Prescribe the displacement along axis k on the plane where its coordinate has this value."""
    on = dolfinx.mesh.locate_entities_boundary(mesh, 2, lambda x: np.isclose(x[k], at))
    dofs = dolfinx.fem.locate_dofs_topological(V.sub(k), 2, on)
    return dolfinx.fem.dirichletbc(value, dofs, V.sub(k))


def remembered(*shape: int) -> dolfinx.fem.Function:
    """Return a Function of the quadrature points, zero at first."""
    element = basix.ufl.quadrature_element("tetrahedron", value_shape=shape, degree=2)
    return dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, element))


stretched = [*(plane(k, 0.0, 0.0) for k in range(3)), plane(0, 1.0, pull)]


def mean(expression) -> float:
    """Return the mean of an expression over the block of 1 mm³."""
    return comm.allreduce(dolfinx.fem.assemble_scalar(dolfinx.fem.form(expression * dx)))


# -

# ## Relaxation
#
# A branch of Maxwell's with half of the stiffness and a relaxation time of 2 s, beside the elastic
# material (Holzapfel 2000). Stretched at once by 20 % and held, the stress falls as
# $1 + ½\, e^{-t/2\,\mathrm{s}}$.

# +
dt = dolfinx.fem.Constant(mesh, 1e-7)  # s
S, Q = remembered(3, 3), remembered(3, 3)
branch = memory.MaxwellBranch(Q, share=0.5, time=2.0)
psi_viscous, updates = memory.viscoelastic(psi, F, S, [branch], dt=dt)
energy = psi_viscous + psi_vol
problem = NonlinearProblem(
    energy * dx, u, bcs=stretched, condense=p, subdomains=4, internal_variables=updates
)
stress = ufl.diff(energy, F)[0, 0]

pull.value = 0.2
times, forces = np.linspace(0.0, 8.0, 9), []
for _ in times:
    problem.solve()
    forces.append(mean(stress))
    problem.update_internal_variables()
    dt.value = times[1]
relaxed = c * (1.2 - 1.2**-2) * (1.0 + 0.5 * np.exp(-times / 2.0))
error = np.abs(forces / relaxed - 1.0).max()
if comm.rank == 0:
    print(f"relaxation: largest error {error:.1e}", flush=True)
assert error < 1e-3
# -

# ## Softening
#
# Damage by the largest energy so far (Simo 1987), up and down and up again: the way back is softer,
# and the second way up follows it until it meets the first one.

# +
m = remembered()
psi_soft, updates = memory.damaged(psi, m, d_max=0.6, W=0.1)
energy = psi_soft + psi_vol
problem = NonlinearProblem(
    energy * dx, u, bcs=stretched, condense=p, subdomains=4, internal_variables=updates
)
softened = ufl.diff(energy, F)[0, 0]
u.x.array[:], p.x.array[:] = 0.0, 0.0
path = []
follow_load(
    problem,
    lambda stretch: setattr(pull, "value", stretch),
    [0.3, 0.0, 0.4],
    Steps(first=0.1, least=0.01, growth=1.0),
    state=[u, p],
    unloading=True,
    on_step=lambda step: path.append((step.load, mean(softened))),
)
path = np.array(path)
λ = 1.0 + path[:, 0]
highest = np.maximum.accumulate(c / 2 * (λ**2 + 2 / λ - 3))
softer = (1.0 - 0.6 * (1.0 - np.exp(-highest / 0.1))) * c * (λ - λ**-2)
error = np.abs(path[:, 1] - softer).max() / softer.max()
if comm.rank == 0:
    print(f"softening: largest error {error:.1e}", flush=True)
assert error < 1e-3
# -

# ## What they remember

# +
folder = writable_folder(Path("output/memory"), comm)
if comm.rank == 0:
    fig, (left, right) = plt.subplots(1, 2, figsize=(9, 3.5), layout="constrained")
    left.plot(times, relaxed, label="closed form")
    left.plot(times, forces, "o", label="FETI")
    left.set(xlabel="time [s]", ylabel="stress [kPa]", title="relaxation")
    right.plot(λ, softer, label="closed form")
    right.plot(λ, path[:, 1], "o", label="FETI")
    right.set(xlabel="stretch", ylabel="stress [kPa]", title="softening: up, down and up")
    left.legend()
    fig.savefig(folder / "memory.png", dpi=150)
