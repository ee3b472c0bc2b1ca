# # A thick tube under pressure, compared with its closed form
#
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
#
# A tube of rubber is inflated until its inner radius has grown by half. Rubber keeps its volume,
# and that alone determines how every point moves; so the pressure is known in closed form.
#
#     python3 demos/demo_thick_tube.py
#
# Units: mm and kPa.

# +
from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np

import basix.ufl
import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, kinematics, loads, materials
from dolfinx_feti.loading import Steps, follow_load
from dolfinx_feti.output import pictures

comm = MPI.COMM_WORLD
inner = 1.0  # radius
outer = 1.5
length = 0.2
c = 3.0  # kPa
# -

# ## Closed form
#
# In plane strain $r^2 = R^2 + k$, with one number k for the whole tube. With the energy
# $\frac c2 (I_1 - 3)$ the balance of the radial stress, integrated from a to b, gives
#
# $$ p = c \left[ \ln\frac{B\,a}{A\,b}
#    + \frac k2 \left(\frac 1{a^2} - \frac 1{b^2}\right) \right], \qquad
#    a^2 = A^2 + k, \quad b^2 = B^2 + k . $$


# +
def exact_pressure(a):
    """Return the pressure [kPa] at which the inner radius is a."""
    k = a**2 - inner**2
    b = np.sqrt(outer**2 + k)
    return c * (np.log(outer * a / (inner * b)) + k / 2 * (1 / a**2 - 1 / b**2))


# -

# ## A quarter of a slice with curved cells
#
# A box of hexahedra in the coordinates radius, angle and z is bent into a quarter of a ring. The
# geometry is quadratic like the displacement, so that the edges of the cells are curved: dolfinx
# creates a mesh of the nodes of a quadratic space on the box.

# +
corners = [(inner, 0.0, 0.0), (outer, np.pi / 2, length)]
hexahedron = dolfinx.mesh.CellType.hexahedron
box = dolfinx.mesh.create_box(comm, corners, (3, 6, 1), cell_type=hexahedron)
quadratic = basix.ufl.element("Lagrange", "hexahedron", 2, shape=(3,))
nodes = dolfinx.fem.functionspace(box, quadratic)
n_nodes = nodes.dofmap.index_map.size_local
n_cells = box.topology.index_map(3).size_local
radius, angle, z = nodes.tabulate_dof_coordinates()[:n_nodes].T
x = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), z])
cells = nodes.dofmap.index_map.local_to_global(nodes.dofmap.list[:n_cells].ravel())
mesh = dolfinx.mesh.create_mesh(comm, cells=cells.reshape(n_cells, -1), x=x, e=quadratic)
# -

# ## Conditions
#
# Points slide in the planes x = 0, y = 0, z = 0 and z = length. The pressure acts on the lumen.

# +
V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (3,)))
bcs = []
for axis, place in [(0, 0.0), (1, 0.0), (2, 0.0), (2, length)]:

    def on_plane(x, axis=axis, place=place):
        return np.isclose(x[axis], place)

    facets = dolfinx.mesh.locate_entities_boundary(mesh, 2, on_plane)
    dofs = dolfinx.fem.locate_dofs_topological(V.sub(axis), 2, facets)
    bcs.append(dolfinx.fem.dirichletbc(0.0, dofs, V.sub(axis)))


def at_lumen(x):
    return np.isclose(np.hypot(x[0], x[1]), inner)


lumen = dolfinx.mesh.locate_entities_boundary(mesh, 2, at_lumen)
tags = dolfinx.mesh.meshtags(mesh, 2, np.sort(lumen), 1)
ds = ufl.Measure("ds", mesh, subdomain_data=tags)(1)
# -

# ## Energy and load
#
# The pressure p inside the rubber is linear in each cell and discontinuous. The potential of the
# pressure in the lumen is −P times the enclosed volume, here that between two planes normal to the
# axis. The whole problem is therefore one energy of u and p.

# +
u = dolfinx.fem.Function(V, name="u")
p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DPC", 1)), name="p")
pressure = dolfinx.fem.Constant(mesh, 0.0)
F = kinematics.deformation_gradient(u)
C = kinematics.right_cauchy_green(F)
J = kinematics.jacobian(F)
psi = materials.neo_hookean(C, c=c, J=J) + materials.perturbed_lagrangian(J, p, kappa=1e4)
energy = psi * ufl.dx + loads.pressure_potential(pressure, u, ds, axis=(0.0, 0.0, 1.0))
problem = NonlinearProblem(energy, u, bcs=bcs, condense=p, subdomains=4, quadrature_degree=4)
# -

# ## Inflation, in steps that adapt
#
# `on_step` records the mean radius of the lumen in each equilibrium.

# +
X = ufl.SpatialCoordinate(mesh)
outward = ufl.as_vector([X[0], X[1], 0.0]) / ufl.sqrt(X[0] ** 2 + X[1] ** 2)
area = comm.allreduce(dolfinx.fem.assemble_scalar(dolfinx.fem.form(1.0 * ds)))
growth = dolfinx.fem.form(ufl.inner(u, outward) * ds)
path = [(inner, 0.0)]


def set_pressure(kpa):
    pressure.value = kpa


def record(step):
    a = inner + comm.allreduce(dolfinx.fem.assemble_scalar(growth)) / area
    path.append((a, step.load))
    if comm.rank == 0:
        print(f"a = {a:.4f} mm   p = {step.load:.4f} kPa   exact {exact_pressure(a):.4f} kPa")


target = float(exact_pressure(1.5 * inner))
steps = Steps(first=0.2, least=0.01)
follow_load(problem, set_pressure, [target], steps, on_step=record, unit="kPa")
# -

# ## Compared with the closed form

# +
radii, pressures = np.transpose(path)
error = np.abs(pressures[1:] / exact_pressure(radii[1:]) - 1).max()
if comm.rank == 0:
    print(f"The pressure is off by {100 * error:.3f} % at most.")
    fig, ax = plt.subplots(figsize=(6, 4))
    fine = np.linspace(inner, 1.55 * inner, 100)
    ax.plot(fine, exact_pressure(fine), color="0.6", label="exact")
    ax.plot(radii, pressures, "o", label="FETI, Q2–P1disc")
    ax.set_xlabel("inner radius [mm]")
    ax.set_ylabel("pressure [kPa]")
    ax.legend()
    fig.savefig("thick_tube_curve.png", dpi=150)
assert error < 1e-3
# -

# ## The stress in the slice

sigma = kinematics.cauchy_stress(psi, F)
pictures.draw(
    "thick_tube.png",
    pictures.subdomains(problem, title="4 subdomains"),
    pictures.field(
        kinematics.stress_magnitude(sigma),
        "stress magnitude √(σ : σ) [kPa]",
        displacement=u,
        title="a/A = 1.5",
    ),
    viewer=(0.3, 0.4, 1.0),
)
