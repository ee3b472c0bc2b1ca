# # A material of your own
#
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
#
# A material is a function that returns an energy in UFL, and nothing else: stress and tangent are
# derived from it. This demo writes down fibres with a dispersed direction (Gasser, Ogden, Holzapfel
# 2006), checks them at single points, and inflates a tube that is made of them.
#
#     python3 demos/demo_own_material.py
#     mpirun -n 2 python3 demos/demo_own_material.py
#
# Units: mm and kPa.

# +
from mpi4py import MPI

import numpy as np

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, compare, kinematics, loads, materials
from dolfinx_feti.loading import Steps, follow_load
from dolfinx_feti.meshes.walls import create_tube_wall
from dolfinx_feti.output import create_patches, pictures, recovered_field
from dolfinx_feti.wall import Clamp, Pressure, apply_conditions, fibre_families, fibre_frame
from dolfinx_feti.workshop import check, compile_material

comm = MPI.COMM_WORLD
# -

# ## The energy
#
# A share $ϰ$ of the fibres of a family points anywhere, from 0 for a single direction to 1/3 for
# an isotropic material. With the mean strain $E_i = ϰ(\bar I_1 - 3) + (1 - 3ϰ)(\bar I_i - 1)$ of
# family $i$,
#
# $$ \bar Ψ = \frac c2(\bar I_1 - 3)
#    + \frac{k_1}{2k_2}\sum_{i=4,6}\left(e^{k_2\langle E_i\rangle^2} - 1\right). $$
#
# The bars mark isochoric invariants, which a change of volume alone does not affect. The pressure,
# added below, resists it.

# +
c = 3.0  # kPa
k1 = 2.3632  # kPa
k2 = 0.8393
dispersion = 0.226


def dispersed_fibres(C, J, a1, a2):
    """Return the energy of Gasser, Ogden and Holzapfel [kPa]."""
    I1 = kinematics.isochoric_invariant_1(C, J)
    psi = c / 2 * (I1 - 3)
    for a in (a1, a2):
        I4 = kinematics.isochoric_invariant_4(C, a, J)
        E = dispersion * (I1 - 3) + (1 - 3 * dispersion) * (I4 - 1)
        stretched = k1 / (2 * k2) * (ufl.exp(k2 * E**2) - 1)
        psi += ufl.conditional(ufl.gt(E, 0.0), stretched, 0.0)
    return psi


# -

# ## Checked before it meets a mesh
#
# The workshop checks an energy at single points, in seconds: derivatives, symmetry, the state at
# rest, stability along stretches from 0.7 to 1.5. Here the fibres lie in the x–y plane. Expect one
# warning: the tangent jumps where unstretched fibres begin to carry load.


# +
def at_a_point(C, J):
    """Return the energy with fibres at ±29° from x."""
    angle = np.radians(29.0)
    a1 = ufl.as_vector([np.cos(angle), np.sin(angle), 0.0])
    a2 = ufl.as_vector([np.cos(angle), -np.sin(angle), 0.0])
    return dispersed_fibres(C, J, a1, a2)


report = check(compile_material(at_a_point), stretches=(0.7, 1.5))
if comm.rank == 0:
    print(report)
assert report.ok
# -

# ## A tube of it
#
# The tube has named surfaces. Its fibres follow the circumference at ±29° in the media and ±62° in
# the adventitia, the defaults of `fibre_families`.

# +
wall = create_tube_wall(comm, size=0.3)
a1, a2 = fibre_families(wall, fibre_frame(wall))

V = dolfinx.fem.functionspace(wall.mesh, ("Lagrange", 2, (3,)))
u = dolfinx.fem.Function(V, name="displacement")
p = dolfinx.fem.Function(dolfinx.fem.functionspace(wall.mesh, ("DG", 0)), name="p")

F = kinematics.deformation_gradient(u)
C = kinematics.right_cauchy_green(F)
J = kinematics.jacobian(F)
psi = dispersed_fibres(C, J, a1, a2) + materials.perturbed_lagrangian(J, p, kappa=1e5)

conditions = {"lumen": Pressure(), "opening_1": Clamp(), "opening_2": Clamp()}
boundary = apply_conditions(wall, u, conditions)
problem = NonlinearProblem(
    psi * ufl.dx, u, boundary=boundary, condense=p, subdomains=12, quadrature_degree=4
)
# -

# ## Inflation to 20 mmHg

# +
steps = Steps(first=loads.mmhg(5.0), least=loads.mmhg(0.1), growth=1.5)
path = follow_load(problem, boundary.set_pressure, [loads.mmhg(20.0)], steps, unit="kPa")
if comm.rank == 0:
    for step in path:
        iterations = [newton.linear_iterations for newton in step.history]
        print(f"{step.load:.2f} kPa: FETI iterations of each Newton step {iterations}")
# -

# ## Compared with a direct solver
#
# Both solvers compute one more Newton step, towards one per cent more pressure:

# +
boundary.set_pressure(1.01 * loads.mmhg(20.0))
comparison = compare(problem, ["feti", "mumps"])
if comm.rank == 0:
    print(comparison)
assert comparison.records[0]["difference_to_direct"] <= 1e-6
# -

# ## The stress

# +
sigma = kinematics.cauchy_stress(psi, F)
normal = ufl.inv(F).T * fibre_frame(wall).transmural
stress = recovered_field(sigma, create_patches(wall.mesh, wall.cell_tags), normal=normal)
pictures.draw(
    "own_material.png",
    pictures.fibres(wall, [a1, a2], "media", title="fibres of the media"),
    pictures.field(
        kinematics.stress_magnitude(stress),
        "stress magnitude √(σ : σ) [kPa]",
        displacement=u,
        cells=wall.cell_tags.find(wall.layers["media"]),
        title="media at 20 mmHg",
    ),
)
