# # A ring that grows, and muscle that pulls
#
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
#
# Growth is an *internal variable*: a Function that is updated between solves, here by an expression
# in UFL. Active tension is a stress without a potential. Both are compared with closed forms.
#
#     python3 demos/demo_growth.py
#
# Units: mm, kPa, s.

# +
from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
import scipy.optimize

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, kinematics, materials
from dolfinx_feti.output import pictures

comm = MPI.COMM_WORLD
c = 3.0  # kPa
kappa = 1e5  # kPa
# -

# ## A ring that grows
#
# The ring on a rigid rod grows in its plane: $F = F_e F_g$ with $F_g = ϑ I$. The growth ϑ
# approaches 1.3, $\dot ϑ = (1.3 - ϑ)/τ$. Elastically the material keeps its volume, so that the
# outer radius follows from $r_o^2 = R_i^2 + ϑ^2 (R_o^2 - R_i^2)$.
#
# A rectangle in polar coordinates is bent into a quarter of the ring, in plane strain.

# +
inner = 1.0  # radius
outer = 1.5
τ = 5.0  # s
ring = dolfinx.mesh.create_rectangle(comm, [(inner, 0.0), (outer, np.pi / 2)], (6, 12))
radius = ring.geometry.x[:, 0].copy()
angle = ring.geometry.x[:, 1].copy()
ring.geometry.x[:, 0] = radius * np.cos(angle)
ring.geometry.x[:, 1] = radius * np.sin(angle)
# -

# The energy depends on the elastic part of the deformation, $F_e = F / ϑ$. It is per volume of
# grown material, which is ϑ² times the volume of the mesh.

# +
V = dolfinx.fem.functionspace(ring, ("Lagrange", 2, (2,)))
P0 = dolfinx.fem.functionspace(ring, ("DG", 0))
u = dolfinx.fem.Function(V, name="u")
p = dolfinx.fem.Function(P0, name="p")
ϑ = dolfinx.fem.Function(P0, name="growth")
ϑ.x.array[:] = 1.0

F_e = kinematics.deformation_gradient(u) / ϑ
J_e = ufl.det(F_e)
psi = materials.neo_hookean(F_e.T * F_e, c=c, J=J_e)
psi += materials.perturbed_lagrangian(J_e, p, kappa=kappa)
energy = ϑ**2 * psi * ufl.dx
# -

# The ring is fixed at the rod, and slides in the planes of symmetry.


# +
def at_rod(x):
    return np.hypot(x[0], x[1]) < 1.01 * inner


def at_x_axis(x):
    return np.isclose(x[1], 0.0)


def at_y_axis(x):
    return np.isclose(x[0], 0.0)


rod = dolfinx.mesh.locate_entities_boundary(ring, 1, at_rod)
bcs = [dolfinx.fem.dirichletbc(np.zeros(2), dolfinx.fem.locate_dofs_topological(V, 1, rod), V)]
for component, on_axis in [(0, at_y_axis), (1, at_x_axis)]:
    facets = dolfinx.mesh.locate_entities_boundary(ring, 1, on_axis)
    dofs = dolfinx.fem.locate_dofs_topological(V.sub(component), 1, facets)
    bcs.append(dolfinx.fem.dirichletbc(0.0, dofs, V.sub(component)))
# -

# The update advances the growth by a time step of 2 s. `update_internal_variables` applies it.

# +
dt = 2.0  # s
problem = NonlinearProblem(
    energy,
    u,
    bcs=bcs,
    condense=p,
    internal_variables={ϑ: 1.3 + (ϑ - 1.3) * np.exp(-dt / τ)},
    subdomains=4,
    quadrature_degree=4,
)


def outer_radius():
    """Return the largest distance of the ring from its axis."""
    x = V.tabulate_dof_coordinates()[:, :2] + u.x.array.reshape(-1, 2)
    return comm.allreduce(np.hypot(x[:, 0], x[:, 1]).max(initial=0.0), op=MPI.MAX)


times = dt * np.arange(1, 7)
radii = []
for _ in times:
    problem.update_internal_variables()
    problem.solve()
    radii.append(outer_radius())

grown = 1.3 - 0.3 * np.exp(-times / τ)
exact_radii = np.sqrt(inner**2 + grown**2 * (outer**2 - inner**2))
error = np.abs(radii / exact_radii - 1.0).max()
if comm.rank == 0:
    print(f"growth: outer radius {radii[-1]:.5f} mm, largest error {error:.1e}")
assert error < 1e-3
# -

# ## Muscle that pulls
#
# A cube of muscle pulls with $T_a = 1$ kPa along its fibres $f$, per *deformed* area. The first
# Piola–Kirchhoff stress is $T_a J\, F f ⊗ f / |F f|^2$, whose tangent is not symmetric. The
# problem gets residuals instead of an energy. The cube shortens to the stretch λ with $c\, (λ^2 -
# 1/λ) + T_a = 0$.

# +
cube = dolfinx.mesh.create_unit_cube(comm, 2, 2, 2)
V_cube = dolfinx.fem.functionspace(cube, ("Lagrange", 1, (3,)))
w = dolfinx.fem.Function(V_cube, name="w")
q = dolfinx.fem.Function(dolfinx.fem.functionspace(cube, ("DG", 0)), name="q")

F = kinematics.deformation_gradient(w)
C = kinematics.right_cauchy_green(F)
J = kinematics.jacobian(F)
psi = materials.neo_hookean(C, c=c, J=J) + materials.perturbed_lagrangian(J, q, kappa=kappa)
dx = ufl.dx(metadata={"quadrature_degree": 2})

f = ufl.as_vector([1.0, 0.0, 0.0])
T_a = dolfinx.fem.Constant(cube, 1.0)  # kPa
active = T_a * J * ufl.outer(F * f, f) / ufl.inner(F * f, F * f)
v = ufl.TestFunction(V_cube)
F_w = ufl.derivative(psi * dx, w, v) + ufl.inner(active, ufl.grad(v)) * dx
F_q = ufl.derivative(psi * dx, q, ufl.TestFunction(q.function_space))
# -

# The cube slides in its three planes through the origin.

# +
bcs = []
for axis in range(3):

    def on_plane(x, axis=axis):
        return np.isclose(x[axis], 0.0)

    facets = dolfinx.mesh.locate_entities_boundary(cube, 2, on_plane)
    dofs = dolfinx.fem.locate_dofs_topological(V_cube.sub(axis), 2, facets)
    bcs.append(dolfinx.fem.dirichletbc(0.0, dofs, V_cube.sub(axis)))

muscle = NonlinearProblem([F_w, F_q], w, bcs=bcs, condense=q, subdomains=4)
muscle.solve()


def balance(stretch):
    """Return the stress along the fibres [kPa]."""
    return c * (stretch**2 - 1.0 / stretch) + 1.0


stretch = comm.allreduce(dolfinx.fem.assemble_scalar(dolfinx.fem.form(F[0, 0] * dx)))
exact_stretch = scipy.optimize.brentq(balance, 0.5, 1.0)
if comm.rank == 0:
    print(f"active tension: stretch {stretch:.5f}, exact {exact_stretch:.5f}")
assert abs(stretch / exact_stretch - 1.0) < 1e-3
# -

# ## The ring

# +
if comm.rank == 0:
    fig, ax = plt.subplots(figsize=(6, 4))
    ax.plot(times, exact_radii, label="exact")
    ax.plot(times, radii, "o", label="FETI")
    ax.set_xlabel("time [s]")
    ax.set_ylabel("outer radius [mm]")
    ax.legend()
    fig.savefig("growth_curve.png", dpi=150)

pictures.draw(
    "growth.png",
    pictures.subdomains(problem, title="at first: 4 subdomains"),
    pictures.field(u, "displacement |u| [mm]", displacement=u, title="after 12 s"),
)
