# # A balloon opens a stenosed artery
#
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
#
# A rigid balloon widens a narrowed artery of two layers under blood pressure and is deflated
# again. The wall recoils, but the balloon has softened it: the lumen stays wider than it was.
#
#     python3 demos/demo_contact.py
#
# Units: mm and kPa.

# +
from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, kinematics, loads, materials
from dolfinx_feti.contact import Contact, cylinder
from dolfinx_feti.loading import Steps, follow_load
from dolfinx_feti.mechanics.memory import damaged
from dolfinx_feti.output import pictures

comm = MPI.COMM_WORLD
# -

# ## The artery
#
# A unit cube is bent into a quarter of a tube, from the middle of the stenosis to its healthy end.
# Its coordinates are the depth in the wall, the angle, and the position along the axis. The inner
# half becomes the media, which is thicker in the middle of the stenosis, and the outer half the
# adventitia.

# +
healthy = 1.5  # radius of the lumen
border = 1.8  # radius between media and adventitia
outer = 2.1  # radius of the outside
length = 4.0
narrowing = 0.5

mesh = dolfinx.mesh.create_unit_cube(comm, 4, 4, 6)


def at_lumen(x):
    return np.isclose(x[0], 0.0)


def at_plane_x(x):
    return np.isclose(x[1], 1.0)


def at_plane_y(x):
    return np.isclose(x[1], 0.0)


def at_ends(x):
    return np.isclose(x[2], 0.0) | np.isclose(x[2], 1.0)


def in_media(x):
    return x[0] < 0.5 + 1e-6


lumen = dolfinx.mesh.locate_entities_boundary(mesh, 2, at_lumen)
plane_x = dolfinx.mesh.locate_entities_boundary(mesh, 2, at_plane_x)
plane_y = dolfinx.mesh.locate_entities_boundary(mesh, 2, at_plane_y)
ends = dolfinx.mesh.locate_entities_boundary(mesh, 2, at_ends)
media = dolfinx.mesh.locate_entities(mesh, 3, in_media)

depth, turn, along = mesh.geometry.x.T.copy()
z = length * along
inner = healthy - narrowing * np.where(z < 3.0, np.cos(np.pi * z / 6.0) ** 2, 0.0)
radius_in_media = inner + (border - inner) * 2.0 * depth
radius_in_adventitia = border + (outer - border) * (2.0 * depth - 1.0)
radius = np.where(depth < 0.5, radius_in_media, radius_in_adventitia)
angle = np.pi / 2.0 * turn
mesh.geometry.x[:, 0] = radius * np.cos(angle)
mesh.geometry.x[:, 1] = radius * np.sin(angle)
mesh.geometry.x[:, 2] = z

tags = dolfinx.mesh.meshtags(mesh, 2, np.sort(lumen), 1)
ds = ufl.Measure("ds", mesh, subdomain_data=tags)(1)
# -

# ## The wall
#
# Two families of fibres wind around each layer at ±35°. Both layers soften with the largest energy
# so far, which is an *internal variable*: `damaged` returns the softened energy and the update of
# the variable. With κ = 1000 kPa the wall swells a little, which the page on compressibility
# measures; for results take 10⁵ kPa.

# +
V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (3,)))
P0 = dolfinx.fem.functionspace(mesh, ("DG", 0))
u = dolfinx.fem.Function(V, name="u")
p = dolfinx.fem.Function(P0, name="p")
largest_energy = dolfinx.fem.Function(P0, name="largest_energy")

c = dolfinx.fem.Function(P0)
c.x.array[:] = 40.0  # of the adventitia
c.x.array[media] = 80.0
k1 = dolfinx.fem.Function(P0)
k1.x.array[:] = 40.0
k1.x.array[media] = 80.0

x = ufl.SpatialCoordinate(mesh)
R = ufl.sqrt(x[0] ** 2 + x[1] ** 2)
around = ufl.as_vector([-x[1] / R, x[0] / R, 0.0])
axial = ufl.as_vector([0.0, 0.0, 1.0])
winding = np.radians(35.0)
a1 = float(np.cos(winding)) * around + float(np.sin(winding)) * axial
a2 = float(np.cos(winding)) * around - float(np.sin(winding)) * axial

F = kinematics.deformation_gradient(u)
C = kinematics.right_cauchy_green(F)
J = kinematics.jacobian(F)
intact = materials.holzapfel_gasser_ogden(C, a1, a2, c=c, k1=k1, k2=0.8, J=J)
softened, update = damaged(intact, largest_energy, d_max=0.6, W=10.0)
psi = softened + materials.perturbed_lagrangian(J, p, kappa=1000.0)
energy = psi * ufl.dx
# -

# ## Blood pressure and balloon
#
# The balloon is a cylinder whose radius is a `Constant`. The artery slides in the planes of
# symmetry, and at its ends in planes normal to the axis; with such rims, the pressure has a
# potential.

# +
blood = dolfinx.fem.Constant(mesh, 0.0)
balloon = dolfinx.fem.Constant(mesh, 0.8)
contact = Contact(u, ds, cylinder(axis=(0, 0, 1), radius=balloon))
energy += loads.pressure_potential(blood, u, ds, axis=(0.0, 0.0, 1.0))


def slide(facets, component):
    """Return the condition that a component of u is zero on facets."""
    dofs = dolfinx.fem.locate_dofs_topological(V.sub(component), 2, facets)
    return dolfinx.fem.dirichletbc(0.0, dofs, V.sub(component))


bcs = [slide(plane_x, 0), slide(plane_y, 1), slide(ends, 2)]
problem = NonlinearProblem(
    energy,
    u,
    bcs=bcs,
    condense=p,
    contacts=[contact],
    internal_variables=update,
    subdomains=16,
    quadrature_degree=4,
)
# -

# ## Pressure, balloon, recoil
#
# Each step adds a point to the curve: the radius of the balloon, and that of the lumen where it is
# narrowest.

# +
X = V.tabulate_dof_coordinates()
is_narrowest = np.isclose(X[:, 2], 0.0)
is_narrowest &= np.isclose(np.hypot(X[:, 0], X[:, 1]), healthy - narrowing)


def opening():
    """Return the radius of the lumen where it is narrowest [mm]."""
    place = X[is_narrowest] + u.x.array.reshape(-1, 3)[is_narrowest]
    radius = np.hypot(place[:, 0], place[:, 1]).min(initial=np.inf)
    return comm.allreduce(radius, op=MPI.MIN)


curve = []


def record(step):
    curve.append((step.load, opening()))


def set_blood(mmhg):
    blood.value = loads.mmhg(mmhg)


def set_balloon(radius):
    balloon.value = radius


follow_load(problem, set_blood, [100.0], Steps(first=25.0, least=1.0), unit="mmHg")
before = opening()

steps = Steps(first=0.1, least=0.005)
follow_load(problem, set_balloon, [1.5], steps, start=0.8, on_step=record, unit="mm")
widest = opening()
penetration = contact.penetration()
stress = kinematics.stress_magnitude(kinematics.cauchy_stress(psi, F))
label = "stress magnitude √(σ : σ) [kPa]"
on_balloon = pictures.field(stress, label, displacement=u, title="on the balloon")

follow_load(problem, set_balloon, [0.8], steps, start=1.5, on_step=record, unit="mm")
after = opening()
deflated = pictures.field(stress, label, displacement=u, title="after it")
if comm.rank == 0:
    print(f"lumen: {before:.3f} mm, on the balloon {widest:.3f} mm, after it {after:.3f} mm")
assert abs(widest - 1.5) < 0.01
assert penetration < 1e-3
assert before < after < widest
# -

# ## The curve and the stress

if comm.rank == 0:
    fig, ax = plt.subplots(figsize=(6, 4))
    ax.plot(*np.transpose(curve), "o-")
    ax.axhline(before, linestyle=":", color="grey", label="before")
    ax.set_xlabel("radius of the balloon [mm]")
    ax.set_ylabel("radius of the lumen [mm]")
    ax.legend()
    fig.savefig("contact_curve.png", dpi=150)

pictures.draw("contact.png", on_balloon, deflated, viewer=(-1.0, -0.7, 0.4))
