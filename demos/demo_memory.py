# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: light
# ---

# # Materials with memory
#
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
#
# What a material remembers is a Function, an *internal variable*, with an update in UFL. A solve
# leaves it alone; it changes when a state is accepted, by `problem.update_internal_variables()`, or
# by itself in `follow_load` and `follow_time`, which also keep it in checkpoints. Four short
# programs, each beside its closed form: a wall that relaxes, one that softens, a ring that grows,
# and muscle whose tension no energy has.
#
#     python3 demos/demo_memory.py

# +
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
import scipy.optimize

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

# ## A block between planes of symmetry
#
# It is stretched along x, or contracts by itself, and is free at its sides.

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


free = [plane(k, 0.0, 0.0) for k in range(3)]
stretched = [*free, plane(0, 1.0, pull)]


def mean(expression) -> float:
    """Return the mean of an expression over the block of 1 mm³."""
    return comm.allreduce(dolfinx.fem.assemble_scalar(dolfinx.fem.form(expression * dx)))


# -

# ## Relaxation
#
# A branch of Maxwell's with half of the stiffness and a relaxation time of 2 s, beside the elastic
# material (Holzapfel 2000). Stretched at once by 20 % and held, the force falls as
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

# ## Tension that no energy has
#
# Muscle that pulls with 1 kPa along its fibres, per *deformed* area: the first Piola-Kirchhoff
# stress is $T_a J\, F f ⊗ f / |F f|^2$, whose tangent is not symmetric. Residuals take the place of
# an energy. It shortens until $c\, (λ^2 - 1/λ) + T_a = 0$.

# +
v, q = ufl.TestFunction(V), ufl.TestFunction(p.function_space)
f = ufl.as_vector([1.0, 0.0, 0.0])
T_a = dolfinx.fem.Constant(mesh, 1.0)  # kPa
elastic = (psi + psi_vol) * dx
active = T_a * J * ufl.outer(F * f, f) / ufl.inner(F * f, F * f)
F_u = ufl.derivative(elastic, u, v) + ufl.inner(active, ufl.grad(v)) * dx
F_p = ufl.derivative(elastic, p, q)
problem = NonlinearProblem([F_u, F_p], u, bcs=free, condense=p, subdomains=4)
u.x.array[:], p.x.array[:] = 0.0, 0.0
problem.solve()
found = mean(F[0, 0])
shortened = scipy.optimize.brentq(lambda s: c * (s**2 - 1.0 / s) + 1.0, 0.5, 1.0)
if comm.rank == 0:
    print(f"active tension: stretch {found:.5f}, closed form {shortened:.5f}", flush=True)
assert abs(found / shortened - 1.0) < 1e-3
# -

# ## A ring that grows
#
# The ring on a rigid rod grows in its plane: F = F_e F_g with F_g = ϑ I. The growth approaches 1.3
# as time goes by, $\dotϑ = (1.3 - ϑ)/τ$. Elastically the material keeps its volume, so that the
# outer radius follows from $r_o^2 = R_i^2 + ϑ^2 (R_o^2 - R_i^2)$. A quarter of it, in plane strain.

# +
inner, outer, τ = 1.0, 1.5, 5.0  # mm, s
ring = dolfinx.mesh.create_rectangle(comm, [(inner, 0.0), (outer, np.pi / 2)], (6, 12))
R, angle = ring.geometry.x[:, 0].copy(), ring.geometry.x[:, 1].copy()
ring.geometry.x[:, 0], ring.geometry.x[:, 1] = R * np.cos(angle), R * np.sin(angle)
W = dolfinx.fem.functionspace(ring, ("Lagrange", 2, (2,)))
w = dolfinx.fem.Function(W, name="w")
P0 = dolfinx.fem.functionspace(ring, ("DG", 0))
pressure, ϑ = dolfinx.fem.Function(P0), dolfinx.fem.Function(P0)
ϑ.x.array[:] = 1.0
G = kinematics.deformation_gradient(w)
J_e = ufl.det(G) / ϑ**2
elastic = materials.neo_hookean(G.T * G / ϑ**2, c=c, J=J_e)
elastic += materials.perturbed_lagrangian(J_e, pressure, kappa=kappa)


def on_edge(k: int | None, marker) -> dolfinx.fem.DirichletBC:
    """Hold an edge: one component, or both."""
    space = W if k is None else W.sub(k)
    dofs = dolfinx.fem.locate_dofs_topological(
        space, 1, dolfinx.mesh.locate_entities_boundary(ring, 1, marker)
    )
    return dolfinx.fem.dirichletbc(np.zeros(2) if k is None else 0.0, dofs, space)


problem = NonlinearProblem(
    ϑ**2 * elastic * ufl.dx,
    w,
    bcs=[
        on_edge(0, lambda x: np.isclose(x[0], 0.0)),
        on_edge(1, lambda x: np.isclose(x[1], 0.0)),
        on_edge(None, lambda x: np.hypot(x[0], x[1]) < inner * 1.01),
    ],
    condense=pressure,
    quadrature_degree=4,
    subdomains=4,
    internal_variables={ϑ: 1.3 + (ϑ - 1.3) * np.exp(-2.0 / τ)},  # after 2 s
)
on_rim = dolfinx.fem.locate_dofs_geometrical(W, lambda x: np.hypot(x[0], x[1]) > outer - 1e-6)
X = W.tabulate_dof_coordinates()[on_rim, :2]
for _ in range(6):
    problem.update_internal_variables()
    problem.solve()
x = X + w.x.array.reshape(-1, 2)[on_rim]
grown = 1.3 - 0.3 * np.exp(-12.0 / τ)
expected = np.sqrt(inner**2 + grown**2 * (outer**2 - inner**2))
radius = comm.allreduce(np.hypot(x[:, 0], x[:, 1]).max(initial=0.0), op=MPI.MAX)
if comm.rank == 0:
    print(f"growth: outer radius {radius:.5f} mm, closed form {expected:.5f} mm")
assert abs(radius / expected - 1.0) < 1e-3
# -

# ## What they remember

# +
folder = writable_folder(Path("output/memory"), comm)
if comm.rank == 0:
    fig, (left, right) = plt.subplots(1, 2, figsize=(9, 3.5), layout="constrained")
    left.plot(times, relaxed, label="closed form")
    left.plot(times, forces, "o", label="FETI")
    left.set(xlabel="time [s]", ylabel="force [kPa]", title="relaxation")
    right.plot(λ, softer, label="closed form")
    right.plot(λ, path[:, 1], "o", label="FETI")
    right.set(xlabel="stretch", title="softening: up, down and up")
    left.legend()
    fig.savefig(folder / "memory.png", dpi=150)
