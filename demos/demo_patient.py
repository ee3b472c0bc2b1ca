# # From a scan at 80 mmHg to the stress at 120
#
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
#
# A scan shows the wall of a vessel in the body: under blood pressure, supported by tissue, and with
# a residual stress that would open its layers if they were cut. This program computes the unloaded
# wall, inflates it to 80 mmHg, where it must match the image, and then to 120 mmHg.
#
#     python3 demos/demo_patient.py
#     mpirun -n 2 python3 demos/demo_patient.py
#
# The page *From a scan to an answer* explains the method. The data are synthetic. Units: mm, kPa;
# pressures in mmHg.

# +
from pathlib import Path

from mpi4py import MPI

import numpy as np

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, kinematics, loads, materials
from dolfinx_feti.loading import Steps, follow_load, unload
from dolfinx_feti.mechanics.residual_stress import elastic_part, stress_free_direction
from dolfinx_feti.meshes.walls import open_wall
from dolfinx_feti.output import pictures
from dolfinx_feti.wall import (
    Clamp,
    OpeningAngles,
    Pressure,
    Spring,
    apply_conditions,
    by_layer,
    fibre_families,
    fibre_frame,
    openings,
)

comm = MPI.COMM_WORLD
size = 2.5  # length of the elements' edges [mm]
wall, _ = open_wall("vessel", comm, size=size, folder=Path("output/patient"))
# -

# ## Residual stress
#
# A ring of each layer opens by an angle when it is cut, and is then free of stress.
# `OpeningAngles` computes the deformation G from the wall to these pieces. The energy depends on
# $F_e = F G^{-1}$; a fibre with the direction $a$ in the wall has the direction $G a/|G a|$ in the
# pieces.

# +
opening = OpeningAngles(wall, {"media": 120.0, "adventitia": 60.0})  # degrees
a1, a2 = fibre_families(wall, fibre_frame(wall), {"media": 29.0, "adventitia": 62.0})

V = dolfinx.fem.functionspace(wall.mesh, ("Lagrange", 2, (3,)))
u = dolfinx.fem.Function(V, name="displacement")
p = dolfinx.fem.Function(dolfinx.fem.functionspace(wall.mesh, ("DG", 0)), name="p")

F = kinematics.deformation_gradient(u)
F_e = elastic_part(F, opening.G)
C = kinematics.right_cauchy_green(F_e)
J = kinematics.jacobian(F_e)
# -

# ## Material and surroundings
#
# The layers are fibre-reinforced (Holzapfel, Gasser, Ogden 2000). Springs model the tissue around
# the vessel.

# +
c = by_layer(wall, {"media": 200.0, "adventitia": 100.0})  # kPa
k1 = by_layer(wall, {"media": 160.0, "adventitia": 80.0})  # kPa
k2 = by_layer(wall, {"media": 0.8393, "adventitia": 0.7112})
A1 = stress_free_direction(a1, opening.G)
A2 = stress_free_direction(a2, opening.G)
psi = materials.holzapfel_gasser_ogden(C, A1, A2, c=c, k1=k1, k2=k2, J=J)
psi += materials.perturbed_lagrangian(J, p, kappa=1e5)

conditions = {"lumen": Pressure(), "outer": Spring(1.0)}
for name in openings(wall):
    conditions[name] = Clamp()
boundary = apply_conditions(wall, u, conditions)
problem = NonlinearProblem(psi * ufl.dx, u, boundary=boundary, condense=p, quadrature_degree=4)


def set_pressure(mmhg):
    boundary.set_pressure(loads.mmhg(mmhg))


# -

# ## The wall without load
#
# `unload` computes the wall whose nodes are $X = x - u$, where x is a node of the image and u its
# displacement under the load. It moves the nodes of the mesh to X and updates fibres and opening
# angles. Afterwards u is the displacement from X to the image.

# +
unload(
    problem,
    set_pressure,
    [80.0],
    Steps(first=8.0, least=0.125, rtol=1e-2, linear_rtol=1e-4, quick=8),
    fibres=[a1, a2],
    on_move=opening.update,
    unit="mmHg",
)
to_image = u.x.array.copy()
pictures.draw(
    "unloaded.png",
    pictures.field(u, "displacement |u| [mm]", displacement=u, title="image"),
    pictures.field(u, "displacement |u| [mm]", title="without load"),
)
# -

# ## Back to the image, and on to 120 mmHg
#
# Now inflate the wall from rest:

# +
u.x.array[:] = 0.0
p.x.array[:] = 0.0
steps = Steps(first=8.0, least=0.125, rtol=1e-2, linear_rtol=1e-4, quick=4)
follow_load(problem, set_pressure, [80.0], steps, unit="mmHg")

difference = np.abs(u.x.array - to_image).max(initial=0.0)
difference = comm.allreduce(difference, op=MPI.MAX)
if comm.rank == 0:
    print(f"At 80 mmHg the wall is {difference:.1e} mm off the image.")
assert difference <= 1e-3

sigma = kinematics.stress_magnitude(kinematics.cauchy_stress(psi, F))
label = "stress magnitude √(σ : σ) [kPa]"
at_80 = pictures.field(sigma, label, displacement=u, title="at 80 mmHg")

follow_load(problem, set_pressure, [120.0], steps, start=80.0, unit="mmHg")
at_120 = pictures.field(sigma, label, displacement=u, title="at 120 mmHg")
# -

# ## The stress

pictures.draw("patient.png", at_80, at_120)
