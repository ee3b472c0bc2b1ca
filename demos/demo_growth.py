# # A ring that grows, and muscle that pulls
#
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
#
# Growth is an internal variable with an update in UFL, as the memory of `demo_memory.py`; active
# tension is a stress that no energy has. Both beside their closed form.
#
#     python3 demos/demo_growth.py
#
# Lengths are in mm, stresses in kPa, times in s.

# +
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
import scipy.optimize

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, kinematics, materials
from dolfinx_feti.output import writable_folder

comm = MPI.COMM_WORLD
c, kappa = 3.0, 1e5  # kPa
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
times, radii = 2.0 * np.arange(1, 7), []
for _ in times:
    problem.update_internal_variables()
    problem.solve()
    x = X + w.x.array.reshape(-1, 2)[on_rim]
    radii.append(comm.allreduce(np.hypot(x[:, 0], x[:, 1]).max(initial=0.0), op=MPI.MAX))
grown = 1.3 - 0.3 * np.exp(-times / τ)
expected = np.sqrt(inner**2 + grown**2 * (outer**2 - inner**2))
error = np.abs(radii / expected - 1.0).max()
if comm.rank == 0:
    print(f"growth: outer radius {radii[-1]:.5f} mm, largest error {error:.1e}", flush=True)
assert error < 1e-3
# -

# ## Tension that no energy has
#
# Muscle that pulls with 1 kPa along its fibres, per *deformed* area: the first Piola-Kirchhoff
# stress is $T_a J\, F f ⊗ f / |F f|^2$, whose tangent is not symmetric. Residuals take the place of
# an energy. It shortens until $c\, (λ^2 - 1/λ) + T_a = 0$.

# +
mesh = dolfinx.mesh.create_unit_cube(comm, 2, 2, 2)
V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (3,)))
u = dolfinx.fem.Function(V, name="u")
p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)), name="p")
F = kinematics.deformation_gradient(u)
J = kinematics.jacobian(F)
psi = materials.neo_hookean(kinematics.right_cauchy_green(F), c=c, J=J)
psi += materials.perturbed_lagrangian(J, p, kappa=kappa)
dx = ufl.dx(metadata={"quadrature_degree": 2})
v, q = ufl.TestFunction(V), ufl.TestFunction(p.function_space)
f = ufl.as_vector([1.0, 0.0, 0.0])
T_a = dolfinx.fem.Constant(mesh, 1.0)  # kPa
elastic = psi * dx
active = T_a * J * ufl.outer(F * f, f) / ufl.inner(F * f, F * f)
F_u = ufl.derivative(elastic, u, v) + ufl.inner(active, ufl.grad(v)) * dx
F_p = ufl.derivative(elastic, p, q)
free = []
for k in range(3):
    on = dolfinx.mesh.locate_entities_boundary(mesh, 2, lambda x, k=k: np.isclose(x[k], 0.0))
    dofs = dolfinx.fem.locate_dofs_topological(V.sub(k), 2, on)
    free.append(dolfinx.fem.dirichletbc(0.0, dofs, V.sub(k)))
problem = NonlinearProblem([F_u, F_p], u, bcs=free, condense=p, subdomains=4)
problem.solve()
found = comm.allreduce(dolfinx.fem.assemble_scalar(dolfinx.fem.form(F[0, 0] * dx)))
shortened = scipy.optimize.brentq(lambda s: c * (s**2 - 1.0 / s) + 1.0, 0.5, 1.0)
if comm.rank == 0:
    print(f"active tension: stretch {found:.5f}, closed form {shortened:.5f}", flush=True)
assert abs(found / shortened - 1.0) < 1e-3
# -

# ## The ring

# +
folder = writable_folder(Path("output/growth"), comm)
if comm.rank == 0:
    fig, ax = plt.subplots(figsize=(6, 4), layout="constrained")
    ax.plot(times, expected, label="closed form")
    ax.plot(times, radii, "o", label="FETI")
    ax.set(xlabel="time [s]", ylabel="outer radius [mm]")
    ax.legend()
    fig.savefig(folder / "growth.png", dpi=150)
