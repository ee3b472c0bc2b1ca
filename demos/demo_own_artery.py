# # Your own artery
#
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
#
# From a geometry to results: this program meshes an artery by Gmsh, gives it two layers with
# collagen fibres, and inflates it to 16 kPa (120 mmHg). It prints a stress at a point and the
# force at a clamped end, and draws the wall. It needs the extras `meshes` and `plot`.
#
#     python3 demos/demo_own_artery.py
#     mpirun -n 4 python3 demos/demo_own_artery.py
#
# To use your own mesh, omit the first section. Units are mm and kPa, hence mN; `loads.mmhg(120.0)`
# converts a pressure from mmHg to kPa.

# +
from mpi4py import MPI

import gmsh
import numpy as np

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, kinematics, materials
from dolfinx_feti.loading import Steps, follow_load
from dolfinx_feti.output import create_patches, evaluate, pictures, recovered_field
from dolfinx_feti.wall import (
    Clamp,
    Pressure,
    Spring,
    apply_conditions,
    by_layer,
    facets,
    fibre_families,
    fibre_frame,
    read_wall,
)

comm = MPI.COMM_WORLD
# -

# ## The mesh
#
# A ring of two layers, media and adventitia, is swept along a quarter of a circle. Each volume and
# each surface that the program refers to becomes a *physical group* with a name. Gmsh runs on the
# first process.

# +
bend = 6.0  # radius of the centre line [mm]
radii = [
    1.0,
    1.3,
    1.5,
]  # of the lumen, of the media's outside, and of the adventitia's outside [mm]
size = 0.45  # length of the elements' edges [mm]


def create_mesh(path):
    """Write the mesh of a bent artery."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    occ = gmsh.model.occ
    disks = [(2, occ.addDisk(0, 0, 0, radius, radius)) for radius in radii]
    occ.fragment(disks[:1], disks[1:])
    occ.synchronize()
    lumen, media, adventitia = sorted(gmsh.model.getEntities(2))
    occ.remove([lumen])
    occ.revolve([media, adventitia], bend, 0, 0, 0, 1, 0, np.pi / 2)
    occ.synchronize()

    media, adventitia = gmsh.model.getEntities(3)
    around = set(gmsh.model.getBoundary([media, adventitia], oriented=False))
    box = gmsh.model.getEntitiesInBoundingBox
    inlet = set(box(-9, -9, -0.01, 9, 9, 0.01, dim=2))  # in the plane z = 0
    outlet = set(box(bend - 0.01, -9, -9, bend + 0.01, 9, 9, dim=2))  # in the plane x = 6
    lumen = set(box(-9, -radii[0] - 0.01, -9, 9, radii[0] + 0.01, 9, dim=2))
    outer = around - inlet - outlet - lumen
    groups = {
        "media": [media],
        "adventitia": [adventitia],
        "inlet": inlet,
        "outlet": outlet,
        "lumen": lumen,
        "outer": outer,
    }
    for name, entities in groups.items():
        dimension = next(iter(entities))[0]
        tags = [tag for _, tag in entities]
        gmsh.model.addPhysicalGroup(dimension, tags, name=name)

    gmsh.option.setNumber("Mesh.MeshSizeMin", size)
    gmsh.option.setNumber("Mesh.MeshSizeMax", size)
    gmsh.model.mesh.generate(3)
    gmsh.write(path)
    gmsh.finalize()


if comm.rank == 0:
    create_mesh("artery.msh")
comm.Barrier()
# -

# ## The wall
#
# `read_wall` reads the names of layers and surfaces from the file.

wall = read_wall("artery.msh", comm)
if comm.rank == 0:
    print("layers:", ", ".join(wall.layers))
    print("surfaces:", ", ".join(wall.surfaces))

# ## The fibres
#
# In each layer two families of collagen fibres wind around the vessel, in opposite directions. The
# angle is measured from the circumferential direction, which follows from two Laplace problems:
# between the lumen and the outside, and between the ends.

frame = fibre_frame(wall, ends=["inlet", "outlet"], inlet="inlet")
a1, a2 = fibre_families(wall, frame, {"media": 29.0, "adventitia": 62.0})

# ## The material
#
# The energy of Holzapfel, Gasser and Ogden (2000) is that of a matrix and of the stretched fibres,
#
# $$ Ψ = \frac c2 (\bar I_1 - 3) + \frac{k_1}{2 k_2} \sum_{i = 4, 6}
#    \left( e^{k_2 \langle \bar I_i - 1 \rangle^2} - 1 \right) + p\, (J - 1) - \frac{p^2}{2κ} , $$
#
# where $\bar I_4$ and $\bar I_6$ are the squared stretches of the fibres. The pressure $p$,
# constant in each cell, enforces incompressibility: with κ = 10⁵ kPa the wall keeps its volume to
# about 0.1 %. Quadratic displacements with this pressure suffice for displacements, forces and
# recovered stresses; second-order pairs, for accurate stresses inside the cells, change the two
# lines of the function spaces and the quadrature degree.

# +
V = dolfinx.fem.functionspace(wall.mesh, ("Lagrange", 2, (3,)))
u = dolfinx.fem.Function(V, name="displacement")
p = dolfinx.fem.Function(dolfinx.fem.functionspace(wall.mesh, ("DG", 0)), name="p")

F = kinematics.deformation_gradient(u)
C = kinematics.right_cauchy_green(F)
J = kinematics.jacobian(F)
c = by_layer(wall, {"media": 40.0, "adventitia": 10.0})  # kPa
k1 = by_layer(wall, {"media": 40.0, "adventitia": 10.0})  # kPa
k2 = by_layer(wall, {"media": 0.8393, "adventitia": 0.7112})
psi = materials.holzapfel_gasser_ogden(C, a1, a2, c=c, k1=k1, k2=k2, J=J)
psi += materials.perturbed_lagrangian(J, p, kappa=1e5)
# -

# ## Pressure and supports
#
# The pressure follows the deformed lumen. Springs model the tissue around the vessel, and both
# ends are clamped. The number of subdomains is that of the picture below; by default there is one
# for every 2000 dofs or so.

# +
conditions = {
    "lumen": Pressure(),
    "outer": Spring(0.5),  # kPa/mm
    "inlet": Clamp(),
    "outlet": Clamp(),
}
boundary = apply_conditions(wall, u, conditions)
problem = NonlinearProblem(
    psi * ufl.dx, u, boundary=boundary, condense=p, subdomains=16, quadrature_degree=4
)
# -

# ## Inflation
#
# `follow_load` increases the pressure from equilibrium to equilibrium, by 2 kPa at first. The
# increment grows if Newton's method converges quickly, and is halved if it fails. A terminal shows
# a progress bar; for a batch job, the page on load steps says how to print the log.

# +
steps = Steps(first=2.0, least=0.05, growth=2.0, rtol=1e-3, linear_rtol=1e-3)
follow_load(problem, boundary.set_pressure, [16.0], steps, unit="kPa")

iterations = [step.linear_iterations for step in problem.history]
if comm.rank == 0:
    print(f"{V.dofmap.index_map.size_global * 3} dofs; FETI iterations at 16 kPa: {iterations}")
# -

# ## The stress at a point
#
# The point is in the media, half way along the artery. `recovered_field` returns a stress that is
# continuous in each layer and more accurate than that inside the cells.

# +
sigma = kinematics.cauchy_stress(psi, F)
normal = ufl.inv(F).T * frame.transmural
stress = recovered_field(sigma, create_patches(wall.mesh, wall.cell_tags), normal=normal)

around = F * frame.circumferential
hoop = ufl.inner(around, stress * around) / ufl.inner(around, around)
middle = bend * np.cos(np.pi / 4)
point = [bend - middle, 1.15, middle]
hoop_stress = evaluate(hoop, point)
if comm.rank == 0:
    print(f"circumferential stress in the media: {float(hoop_stress):.1f} kPa")
# -

# ## The force at the inlet
#
# The clamp exerts this force on the wall:

force = problem.reaction(facets(wall, "inlet")).force
if comm.rank == 0:
    print(f"force on the wall at the inlet: {force.round(1)} mN")

# ## Pictures
#
# The media with its fibres, the subdomains, and the stress of the media under pressure.

pictures.draw(
    "artery.png",
    pictures.fibres(wall, [a1, a2], "media", title="fibres of the media"),
    pictures.subdomains(problem, title="subdomains"),
    pictures.field(
        hoop,
        "circumferential stress [kPa]",
        displacement=u,
        cells=wall.cell_tags.find(wall.layers["media"]),
        title="media at 16 kPa",
    ),
)
