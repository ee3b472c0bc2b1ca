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
# Lengths are in mm, stresses in kPa.

# +
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np

import basix.ufl
import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, kinematics, loads, materials
from dolfinx_feti.loading import Steps, follow_load
from dolfinx_feti.output import writable_folder

comm = MPI.COMM_WORLD
INNER, OUTER, LENGTH, STIFFNESS, KAPPA = 1.0, 1.5, 0.2, 3.0, 1e4
# -

# ## What is known
#
# In plane strain $r^2 = R^2 + k$, with one number k for the whole tube. With the energy
# $\frac c2 (I_1 - 3)$ the balance of the radial stress, integrated from a to b, gives
#
# $$ p = c \left[ \ln\frac{B\,a}{A\,b}
#    + \frac k2 \left(\frac 1{a^2} - \frac 1{b^2}\right) \right], \qquad
#    a^2 = A^2 + k, \quad b^2 = B^2 + k . $$


# +
def closed_form(a: float | np.ndarray) -> float | np.ndarray:
    """Return the pressure [kPa] at which the inner radius is a."""
    k = a**2 - INNER**2
    b = np.sqrt(OUTER**2 + k)
    return STIFFNESS * (np.log(OUTER * a / (INNER * b)) + k / 2 * (1 / a**2 - 1 / b**2))


# -

# ## A quarter of a slice
#
# A box is bent into a quarter of a ring, whose points slide in its planes of symmetry. Its cells
# are hexahedra with curved edges: a node wherever a quadratic displacement has one.

# +
corners, kind = [(INNER, 0.0, 0.0), (OUTER, np.pi / 2, LENGTH)], dolfinx.mesh.CellType.hexahedron
box = dolfinx.mesh.create_box(comm, corners, (3, 6, 1), cell_type=kind)
quadratic = basix.ufl.element("Lagrange", "hexahedron", 2, shape=(3,))
nodes = dolfinx.fem.functionspace(box, quadratic)
owned, cells = nodes.dofmap.index_map.size_local, box.topology.index_map(3).size_local
radius, angle, z = nodes.tabulate_dof_coordinates()[:owned].T
number = nodes.dofmap.index_map.local_to_global(nodes.dofmap.list[:cells].ravel())
x = np.column_stack((radius * np.cos(angle), radius * np.sin(angle), z))
mesh = dolfinx.mesh.create_mesh(comm, cells=number.reshape(cells, -1), x=x, e=quadratic)

V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (3,)))


def slide(axis: int, at: float) -> dolfinx.fem.DirichletBC:
    """Let points slide in a plane normal to an axis."""
    facets = dolfinx.mesh.locate_entities_boundary(mesh, 2, lambda x: np.isclose(x[axis], at))
    dofs = dolfinx.fem.locate_dofs_topological(V.sub(axis), 2, facets)
    return dolfinx.fem.dirichletbc(0.0, dofs, V.sub(axis))


bcs = [slide(0, 0.0), slide(1, 0.0), slide(2, 0.0), slide(2, LENGTH)]
lumen = dolfinx.mesh.locate_entities_boundary(
    mesh, 2, lambda x: np.isclose(np.hypot(x[0], x[1]), INNER)
)
tags = dolfinx.mesh.meshtags(mesh, 2, np.sort(lumen), np.ones(len(lumen), dtype=np.int32))
ds = ufl.Measure("ds", mesh, subdomain_data=tags)(1)
# -

# ## Energy and load
#
# The potential of the pressure is −p times the enclosed volume, here that between two planes normal
# to the axis; with it the whole problem is one energy of u and p.

# +
u = dolfinx.fem.Function(V, name="u")
p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DPC", 1)), name="p")
pressure = dolfinx.fem.Constant(mesh, 0.0)
F = kinematics.deformation_gradient(u)
C, J = kinematics.right_cauchy_green(F), kinematics.jacobian(F)
psi = materials.neo_hookean(C, c=STIFFNESS, J=J) + materials.perturbed_lagrangian(J, p, KAPPA)
energy = psi * ufl.dx + loads.pressure_potential(pressure, u, ds, axis=(0.0, 0.0, 1.0))
problem = NonlinearProblem(energy, u, bcs=bcs, condense=p, subdomains=4, quadrature_degree=4)
# -

# ## Inflation, in steps that adapt

# +
area = comm.allreduce(dolfinx.fem.assemble_scalar(dolfinx.fem.form(1.0 * ds)))
X = ufl.SpatialCoordinate(mesh)
outward = ufl.as_vector((X[0], X[1], 0.0)) / ufl.sqrt(X[0] ** 2 + X[1] ** 2)
moved = dolfinx.fem.form(ufl.inner(u, outward) * ds)
path = [(INNER, 0.0)]


def record(step: object) -> None:
    """Keep pressure and inner radius."""
    mean = comm.allreduce(dolfinx.fem.assemble_scalar(moved)) / area
    path.append((INNER + mean, float(pressure.value)))
    if comm.rank == 0:
        a, value = path[-1]
        print(f"a = {a:.4f} mm   p = {value:.4f} kPa   closed form {closed_form(a):.4f} kPa")


steps = follow_load(
    problem,
    lambda kpa: setattr(pressure, "value", kpa),
    [float(closed_form(1.5 * INNER))],
    Steps(first=0.2, least=0.01),
    state=[u, p],
    on_step=record,
    unit="kPa",
)
# -

# ## Beside the closed form

# +
folder = writable_folder(Path("output/thick_tube"), comm)
computed = np.array(path)
error = np.abs(computed[1:, 1] / closed_form(computed[1:, 0]) - 1.0).max()
if comm.rank == 0:
    print(f"{len(steps)} load steps; the pressure is off by at most {100 * error:.3f} %")
    radii = np.linspace(INNER, 1.55 * INNER, 100)
    fig, ax = plt.subplots(figsize=(6, 4))
    ax.plot(radii, closed_form(radii), color="0.6", label="closed form")
    ax.plot(*computed.T, "o", label="FETI, Q2–P1disc")
    ax.set(xlabel="inner radius [mm]", ylabel="pressure [kPa]")
    ax.legend(frameon=False)
    fig.savefig(folder / "pressure.png", dpi=150, bbox_inches="tight")
assert error < 1e-3
