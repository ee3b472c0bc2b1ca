# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: light
# ---

# # From a scan at 80 mmHg to the stress at 120
#
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
#
# The wall of a vessel is imaged in the body, under the pressure of the blood, in its bed of tissue,
# and with a stress that would open its layers if they were cut. How large is its stress at
# 120 mmHg? First the wall without load is found, and brought back to 80 mmHg, where it has to be
# the image again.
#
#     mpirun -n 2 python3 demos/demo_patient.py
#     python3 demos/demo_patient.py --case my_wall.toml --output output/mine
#
# One file says it all: mesh, layers, surroundings and pressures (`demos/patient.toml`), and
# `docs/scan.md` explains the way. Units: mm, kPa, and mmHg in the file. The tissue is stiffer than
# the carotid artery of `demo_artery.py`: the vessel is a cerebral artery with a sac, which at
# 80 mmHg would have grown far beyond its size at rest if it were as soft. The numbers are no
# patient's.

# +
import json
import logging
import sys
import time
from pathlib import Path

from mpi4py import MPI

import numpy as np
from common import patient as pictures
from common.arguments import Parser
from common.render import gather_cells

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, kinematics, loads, materials
from dolfinx_feti.fem.nodes import Nodes
from dolfinx_feti.loading import LoadStep, Steps, follow_load, unload
from dolfinx_feti.mechanics.residual_stress import elastic_part, stress_free_direction
from dolfinx_feti.output import cell_values
from dolfinx_feti.runtime.collective import on_first
from dolfinx_feti.runtime.folders import writable_folder
from dolfinx_feti.wall import apply_conditions, by_layer, read_case
from dolfinx_feti.wall.fibres import fibre_families, frame_of
from dolfinx_feti.wall.opening import Opening
from meshes.arguments import count, positive, refusals
from meshes.walls import CREATE, open_wall

parser = Parser("demo_patient.py", allow_abbrev=False)
parser.add_argument("--case", type=Path, default=Path("demos/patient.toml"), help="a TOML file")
parser.add_argument("--size", type=positive, default=2.5, help="edges of a mesh made here [mm]")
parser.add_argument("--subdomains", type=count, help="over all processes")
parser.add_argument("--output", type=Path, default=Path("output/patient"), help="a folder")
args = parser.parse_args(sys.argv[1:])

comm = MPI.COMM_WORLD
started = time.perf_counter()
logging.basicConfig(format="%(message)s", stream=sys.stdout)
logging.getLogger("dolfinx_feti").setLevel(logging.INFO)  # a line for each load step
# -

# ## The image
#
# Fibres and directions are those of the wall as imaged.

# +
with refusals(parser):
    folder = writable_folder(args.output, comm)
    case = read_case(args.case, comm)
    source = case.mesh if case.mesh in CREATE else args.case.parent / case.mesh
    wall, quality = open_wall(source, comm, size=args.size, folder=folder, scale=case.scale)
    case.check(wall)
    if not 0.0 < case.image < case.pressure:
        raise ValueError(
            f"{args.case}: [image] pressure = {case.image:g}: give a number above zero, and below "
            f"the {case.pressure:g} mmHg of [surfaces], where to arrive"
        )
    others = {"[prestretch]": case.axis, "[loading] rate": case.rate, "[cavity]": case.cavities}
    for key, given in others.items():
        if given:
            raise ValueError(f"{args.case}: {key} has no effect in this demo: leave it out")
tissues = case.layers.items()
c, k1, k2, angles, opening_angles, stretches = (
    {name: getattr(tissue, key) for name, tissue in tissues}
    for key in ("c", "k1", "k2", "angle", "opening_angle", "axial_stretch")
)
mesh, nodes = wall.mesh, Nodes(wall.mesh)
opening = Opening(wall, opening_angles, stretches, **case.fibres)
fibres = fibre_families(wall, frame_of(wall, *opening.potentials), angles)
imaged = [a.x.array.copy() for a in fibres]
# -

# ## Energy, load and tissue
#
# The wall would be free of stress if it were cut. From its reference configuration, G leads there,
# and $F_e = F G^{-1}$ is what the material feels. A fibre of the image has the direction
# $A = G a/|G a|$ in the pieces:
#
# $$
# \Pi(u, p) = \int_\Omega \bar\Psi(F_e^\top F_e, A) + p\,(J - 1) - \frac{p^2}{2\kappa}\,\mathrm dX .
# $$
#
# With P2–P0 and $\kappa = 10^5$ kPa each cell keeps its volume, in the mean, to less than one per
# cent.

# +
V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (3,)))
Q = dolfinx.fem.functionspace(mesh, ("DG", 0))
u, p = dolfinx.fem.Function(V, name="displacement"), dolfinx.fem.Function(Q, name="p")
v, q, du = ufl.TestFunction(V), ufl.TestFunction(Q), ufl.TrialFunction(V)
F = kinematics.deformation_gradient(u)
F_e = elastic_part(F, opening.G)
C, J = kinematics.right_cauchy_green(F_e), kinematics.jacobian(F_e)
tissue = {"c": by_layer(wall, c), "k1": by_layer(wall, k1), "k2": by_layer(wall, k2)}
in_pieces = (stress_free_direction(a, opening.G) for a in fibres)
psi = materials.holzapfel_gasser_ogden(C, *in_pieces, **tissue, J=J)
psi += materials.perturbed_lagrangian(J, p, kappa=1e5)
energy = psi * ufl.dx
boundary = apply_conditions(wall, u, case.conditions, axis=case.axis)
problem = NonlinearProblem(
    [ufl.derivative(energy, u, v) + boundary.residual, ufl.derivative(energy, p, q)],
    u,
    bcs=boundary.bcs,
    J=ufl.derivative(ufl.derivative(energy, u, v), u, du) + boundary.tangent,
    condense=p,
    energy=None if boundary.energy is None else energy + boundary.energy,
    subdomains=args.subdomains,
    petsc_options_prefix="patient_",
    quadrature_degree=4,
)


def set_load(mmhg: float) -> None:
    """Set the pressure of the blood."""
    boundary.pressure.value = loads.mmhg(mmhg)


# -

# ## The wall without load
#
# A fixed point: the wall whose nodes are $X = x - u$, with $u$ the displacement of the last guess
# under the load. It moves the mesh; forms, layers and subdomains stay, the fibres follow, and what
# opens is found anew for each shape.

# +
increments = {"first": case.image / 10, "least": case.image / 640}
rough = {"rtol": 1e-2, "linear_rtol": 1e-4}  # on the way
loading, unloading = (Steps(**increments, **rough, quick=quick) for quick in (4, 8))
following = {"state": [u, p], "unit": "mmHg"}
of_shape = {"fibres": fibres, "on_move": opening.update}
found = unload(problem, set_load, [case.image], unloading, **of_shape, **following)
to_the_image = [f.x.array.copy() for f in (u, p)]
receded = nodes.longest(mesh.geometry.x - nodes.first)
walls = {"image and unloaded wall": gather_cells(u, {})}
# -

# ## Back to the image, and on
#
# An ordinary inflation from rest. The stress around the vessel, ê₀·(σ ê₀) with ê₀ pushed forward,
# is averaged over slices of the wall, from the lumen to the outside.

# +
sigma = kinematics.cauchy_stress(psi, F)
circumferential = F * opening.directions[0]
hoop = ufl.inner(circumferential, sigma * circumferential)
hoop /= ufl.inner(circumferential, circumferential)
magnitude = kinematics.stress_magnitude(sigma)
through = opening.potentials[0]
layer = by_layer(wall, {name: float(i) for i, name in enumerate(wall.layers)})
dx = ufl.dx(metadata={"quadrature_degree": 4})
volume, change = (dolfinx.fem.form(f * q * dx) for f in (1.0, kinematics.jacobian(F) - 1))
changes = {}


def volume_change() -> float:
    """Return the greatest |mean J − 1| of a cell."""
    sizes, changed = (dolfinx.fem.assemble_vector(form).array for form in (volume, change))
    return comm.allreduce(float(np.abs(changed / sizes).max(initial=0.0)), op=MPI.MAX)


def observe(name: str) -> None:
    """Keep the wall with the stress in its cells."""
    stress = {"stress": cell_values(magnitude, mesh), "hoop": cell_values(hoop, mesh)}
    stress |= {"depth": cell_values(through, mesh), "layer": cell_values(layer, mesh)}
    walls[name] = gather_cells(u, stress)
    changes[name] = volume_change()


u.x.array[:], p.x.array[:] = 0.0, 0.0
back = follow_load(problem, set_load, [case.image], loading, **following)
off = nodes.longest(mesh.geometry.x + nodes.displacement(u) - nodes.first)
observe(f"{case.image:g} mmHg")
on = follow_load(problem, set_load, [case.pressure], loading, start=case.image, **following)
observe(f"{case.pressure:g} mmHg")
# -

# ## The same wall without residual stress
#
# Its unloaded shape is another. At 80 mmHg the image stays where it is while the opening angles go
# to zero: they are the load of a path that leads from the one unloaded wall to the other.

# +
angle = opening.angle.x.array.copy()


def set_opening(share: float) -> None:
    """Set the opening angles to a share of those in the file."""
    opening.angle.x.array[:] = share * angle


mesh.geometry.x[:] = nodes.first
for a, image in zip(fibres, imaged, strict=True):
    a.x.array[:] = image
for f, values in zip((u, p), to_the_image, strict=True):
    f.x.array[:] = values
set_load(case.image)
closing = Steps(first=0.5, least=0.01, quick=8, **rough)
closed = unload(problem, set_opening, [0.0], closing, start=1.0, state=[u, p], **of_shape)
observe(f"{case.image:g} mmHg, no residual stress")
follow_load(problem, set_load, [case.pressure], loading, start=case.image, **following)
observe(f"{case.pressure:g} mmHg, no residual stress")
# -

# ## Pictures and numbers


# +
def draw() -> None:
    """Draw the image beside the unloaded wall, the stresses, and the stress through the wall."""
    pictures.draw_unloaded(folder / "unloaded.png", walls.pop("image and unloaded wall"))
    loaded = {name: cells for name, cells in walls.items() if "," not in name}
    pictures.draw_stress(folder / "stress.png", loaded)
    pictures.draw_profiles(folder / "profiles.png", walls, list(wall.layers))


on_first(draw, comm)


def cost(steps: list[LoadStep]) -> dict[str, int]:
    """Count load steps, Newton steps and FETI's iterations, those of failed attempts included."""
    newton = [step for load_step in steps for step in load_step.all_steps]
    return {
        "load_steps": sum(1 + step.failures for step in steps),
        "newton_steps": len(newton),
        "iterations": sum(step.linear_iterations for step in newton),
    }


paths = {"unloading": found, "back to the image": back, "on": on, "without residual stress": closed}
summary = {
    "dofs": V.dofmap.index_map.size_global * 3,
    "unloaded_wall_receded_by_mm": receded,
    "loaded_wall_off_the_image_mm": off,
    "worst_mean_volume_change": changes,
    "cost": {name: cost(steps) for name, steps in paths.items()},
    "seconds": time.perf_counter() - started,
}
on_first(lambda: (folder / "summary.json").write_text(json.dumps(summary, indent=1) + "\n"), comm)
rows = {"dofs of u": f"{summary['dofs']}"}
rows["image off the unloaded wall, at most"] = f"{receded:.3f} mm"
rows[f"image off the wall loaded to {case.image:g} mmHg, at most"] = f"{off:.1e} mm"
rows |= {f"|mean J − 1|, worst cell, {name}": f"{worst:.1e}" for name, worst in changes.items()}
rows |= {
    f"load steps, Newton steps, iterations: {name}": "{}, {}, {}".format(*spent.values())
    for name, spent in summary["cost"].items()
}
rows["time"] = f"{summary['seconds']:.0f} s"
if comm.rank == 0:
    print("\n".join(f"{what:<66}{value:>14}" for what, value in rows.items()))
assert off <= 1e-3
assert max(changes.values()) <= 0.01
