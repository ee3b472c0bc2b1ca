# # Materials with memory
#
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
#
# An *internal variable* stores the history of a material: a Function with an update in UFL. It
# changes when a state is accepted: `follow_load` and `follow_time` update it, or you call
# `problem.update_internal_variables()`. Here a block relaxes and softens; in `demo_growth.py` a
# ring grows.
#
#     python3 demos/demo_memory.py
#
# Units: mm, kPa, s.

# +
from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np

import basix.ufl
import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, kinematics, materials
from dolfinx_feti.loading import Steps, follow_load
from dolfinx_feti.mechanics import memory

comm = MPI.COMM_WORLD
c = 3.0  # kPa
# -

# ## A block that is stretched
#
# The unit cube slides in its three planes through the origin. The plane x = 1 is pulled.

# +
mesh = dolfinx.mesh.create_unit_cube(comm, 2, 2, 2)
V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (3,)))
u = dolfinx.fem.Function(V, name="u")
p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)), name="p")
pull = dolfinx.fem.Constant(mesh, 0.0)  # mm
fixed = dolfinx.fem.Constant(mesh, 0.0)

bcs = []
for axis, place, value in [(0, 0.0, fixed), (1, 0.0, fixed), (2, 0.0, fixed), (0, 1.0, pull)]:

    def on_plane(x, axis=axis, place=place):
        return np.isclose(x[axis], place)

    facets = dolfinx.mesh.locate_entities_boundary(mesh, 2, on_plane)
    dofs = dolfinx.fem.locate_dofs_topological(V.sub(axis), 2, facets)
    bcs.append(dolfinx.fem.dirichletbc(value, dofs, V.sub(axis)))

F = kinematics.deformation_gradient(u)
C = kinematics.right_cauchy_green(F)
J = kinematics.jacobian(F)
psi = materials.neo_hookean(C, c=c, J=J)
psi_volumetric = materials.perturbed_lagrangian(J, p, kappa=1e5)
dx = ufl.dx(metadata={"quadrature_degree": 2})
# -

# The internal variables are stored at the quadrature points.


# +
def quadrature_function(shape):
    """Return a Function of the quadrature points, zero at first."""
    element = basix.ufl.quadrature_element("tetrahedron", value_shape=shape, degree=2)
    return dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, element))


def mean(expression):
    """Return the mean of an expression over the block of 1 mm³."""
    return comm.allreduce(dolfinx.fem.assemble_scalar(dolfinx.fem.form(expression * dx)))


# -

# ## Relaxation
#
# A Maxwell branch with half of the stiffness and a relaxation time of 2 s lies beside the elastic
# material (Holzapfel 2000). The block is stretched at once by 20 % and held. The stress falls as
# $1 + ½\, e^{-t/2\,\mathrm{s}}$.

# +
dt = dolfinx.fem.Constant(mesh, 1e-7)  # s
S = quadrature_function((3, 3))
Q = quadrature_function((3, 3))
branch = memory.MaxwellBranch(Q, share=0.5, time=2.0)
psi_viscous, updates = memory.viscoelastic(psi, F, S, [branch], dt=dt)
energy = psi_viscous + psi_volumetric
problem = NonlinearProblem(
    energy * dx, u, bcs=bcs, condense=p, internal_variables=updates, subdomains=4
)
stress = ufl.diff(energy, F)[0, 0]

pull.value = 0.2
times = np.linspace(0.0, 8.0, 9)
relaxing = []
for _ in times:
    problem.solve()
    relaxing.append(mean(stress))
    problem.update_internal_variables()
    dt.value = times[1]

elastic = c * (1.2 - 1.2**-2)
exact_relaxing = elastic * (1.0 + 0.5 * np.exp(-times / 2.0))
error = np.abs(relaxing / exact_relaxing - 1.0).max()
if comm.rank == 0:
    print(f"relaxation: largest error {error:.1e}")
assert error < 1e-3
# -

# ## Softening
#
# The damage depends on the largest energy so far (Simo 1987). The block is stretched, released and
# stretched again: the way back is softer, and the second way up follows it as far as the first one
# led.

# +
u.x.array[:] = 0.0
p.x.array[:] = 0.0
largest_energy = quadrature_function(())
psi_soft, updates = memory.damaged(psi, largest_energy, d_max=0.6, W=0.1)
energy = psi_soft + psi_volumetric
problem = NonlinearProblem(
    energy * dx, u, bcs=bcs, condense=p, internal_variables=updates, subdomains=4
)
stress = ufl.diff(energy, F)[0, 0]
path = []


def set_pull(length):
    pull.value = length


def record(step):
    path.append((1.0 + step.load, mean(stress)))


steps = Steps(first=0.1, least=0.01, growth=1.0)
follow_load(problem, set_pull, [0.3, 0.0, 0.4], steps, unloading=True, on_step=record, unit="mm")

λ, softening = np.transpose(path)
largest = np.maximum.accumulate(c / 2 * (λ**2 + 2 / λ - 3))
damage = 0.6 * (1.0 - np.exp(-largest / 0.1))
exact_softening = (1.0 - damage) * c * (λ - λ**-2)
error = np.abs(softening - exact_softening).max() / exact_softening.max()
if comm.rank == 0:
    print(f"softening: largest error {error:.1e}")
assert error < 1e-3
# -

# ## Compared with the closed forms

if comm.rank == 0:
    fig, (left, right) = plt.subplots(1, 2, figsize=(9, 3.5), layout="constrained")
    left.plot(times, exact_relaxing, label="exact")
    left.plot(times, relaxing, "o", label="FETI")
    left.set_xlabel("time [s]")
    left.set_ylabel("stress [kPa]")
    left.set_title("relaxation")
    left.legend()
    right.plot(λ, exact_softening, label="exact")
    right.plot(λ, softening, "o", label="FETI")
    right.set_xlabel("stretch")
    right.set_ylabel("stress [kPa]")
    right.set_title("softening: up, down and up")
    fig.savefig("memory.png", dpi=150)
