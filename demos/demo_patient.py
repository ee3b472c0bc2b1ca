# # From a scan at 80 mmHg to the stress at 120
#
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
#
# The wall of a vessel is imaged in the body, under the pressure of the blood, in its bed of tissue,
# and with a stress that would open its layers if they were cut. The wall without load is found, and
# brought back to 80 mmHg, where it has to be the image again, and on to 120.
#
#     mpirun -n 2 python3 demos/demo_patient.py
#     python3 demos/demo_patient.py --case my_wall.toml --output output/mine
#
# One file says it all: mesh, layers, surroundings and pressures (`demos/patient.toml`), and
# `docs/scan.md` explains the way. The numbers are no patient's. Units: mm, kPa; mmHg in the file.

# +
import json
import logging
import sys
from pathlib import Path

from mpi4py import MPI

import numpy as np
from common.drawing import draw_values, gather_cells

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, kinematics, loads, materials
from dolfinx_feti.fem.nodes import Nodes
from dolfinx_feti.loading import Steps, follow_load, unload
from dolfinx_feti.mechanics.residual_stress import elastic_part, stress_free_direction
from dolfinx_feti.output import cell_values
from dolfinx_feti.runtime.collective import on_first
from dolfinx_feti.runtime.folders import writable_folder
from dolfinx_feti.wall import apply_conditions, by_layer
from dolfinx_feti.wall.fibres import fibre_families, frame_of
from dolfinx_feti.wall.opening import Opening
from meshes.arguments import Parser, count, refusals
from meshes.walls import open_case

parser = Parser("demo_patient.py", allow_abbrev=False)
parser.add_argument("--case", type=Path, default=Path("demos/patient.toml"), help="a TOML file")
parser.add_argument("--subdomains", type=count, help="over all processes")
parser.add_argument("--output", type=Path, default=Path("output/patient"), help="a folder")
args = parser.parse_args(sys.argv[1:])
comm = MPI.COMM_WORLD
logging.basicConfig(format="%(message)s", stream=sys.stdout)
logging.getLogger("dolfinx_feti").setLevel(logging.INFO)  # a line for each load step
# -

# ## The image
#
# The wall would be free of stress if it were cut: G leads there, and $F_e = F G^{-1}$ is what the
# material feels. A fibre of the image has the direction $A = G a/|G a|$ in the pieces.

# +
with refusals(parser):
    folder = writable_folder(args.output, comm)
    case, wall, _ = open_case(args.case, "vessel", comm, size=2.5, folder=folder)
    if not 0.0 < case.image < case.pressure or case.axis or case.rate or case.cavities:
        raise ValueError(f"{args.case}: give an [image] pressure below that of [surfaces], and no "
                         "[prestretch], [loading] or [cavity]")  # fmt: skip
keys = ("angle", "opening_angle", "axial_stretch", "c", "k1", "k2")
angles, *cut, c, k1, k2 = ({n: getattr(t, key) for n, t in case.layers.items()} for key in keys)
opening, nodes = Opening(wall, *cut, **case.fibres), Nodes(wall.mesh)
fibres = fibre_families(wall, frame_of(wall, *opening.potentials), angles)

V = dolfinx.fem.functionspace(wall.mesh, ("Lagrange", 2, (3,)))
u = dolfinx.fem.Function(V, name="displacement")
p = dolfinx.fem.Function(dolfinx.fem.functionspace(wall.mesh, ("DG", 0)), name="p")
v, q, du = ufl.TestFunction(V), ufl.TestFunction(p.function_space), ufl.TrialFunction(V)
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
# -

# ## The wall without load, and back
#
# A fixed point: the wall whose nodes are $X = x - u$, with u the displacement of the last guess
# under the load. It moves the mesh; the fibres follow, and what opens is found anew for each shape.
# Then an ordinary inflation from rest leads to the image, and on.


# +
def set_load(mmhg: float) -> None:
    """Set the pressure of the blood."""
    boundary.pressure.value = loads.mmhg(mmhg)


stress = kinematics.stress_magnitude(kinematics.cauchy_stress(psi, F))
rough = {"first": case.image / 10, "least": case.image / 640, "rtol": 1e-2, "linear_rtol": 1e-4}
loading, unloading = (Steps(**rough, quick=quick) for quick in (4, 8))
state = {"state": [u, p], "unit": "mmHg"}
shape = {"fibres": fibres, "on_move": opening.update}
found = unload(problem, set_load, [case.image], unloading, **shape, **state)
receded = nodes.longest(wall.mesh.geometry.x - nodes.initial)
walls = {"unloaded": gather_cells(u, {})}
u.x.array[:], p.x.array[:] = 0.0, 0.0
back = follow_load(problem, set_load, [case.image], loading, **state)
off = nodes.longest(wall.mesh.geometry.x + nodes.displacement(u) - nodes.initial)
walls[f"{case.image:g} mmHg"] = gather_cells(u, {"stress": cell_values(stress, wall.mesh)})
on = follow_load(problem, set_load, [case.pressure], loading, start=case.image, **state)
walls[f"{case.pressure:g} mmHg"] = gather_cells(u, {"stress": cell_values(stress, wall.mesh)})
# -

# ## Pictures and numbers


# +
def draw() -> None:
    """Draw the image beside the unloaded wall, and the stresses."""
    cells = walls.pop("unloaded")
    face, moved = cells.skin(), np.linalg.norm(cells.x - cells.X, axis=2)
    shapes = {"image": cells.x[face], "without load": cells.X[face]}
    panels = {name: (x, moved[face].mean(axis=1)) for name, x in shapes.items()}
    draw_values(folder / "unloaded.png", panels, "displacement |u|  [mm]")
    panels = {f"at {n}": (w.x[face], w.values["stress"][face[0][:, 0]]) for n, w in walls.items()}
    draw_values(folder / "stress.png", panels, "stress magnitude  [kPa]")


on_first(draw, comm)
summary = {"unloaded_wall_receded_by_mm": receded, "loaded_wall_off_the_image_mm": off}
for name, path in (("unloading", found), ("back", back), ("on", on)):
    newton = [step for load_step in path for step in load_step.all_steps]
    summary[f"iterations_{name}"] = sum(step.linear_iterations for step in newton)
on_first(lambda: (folder / "summary.json").write_text(json.dumps(summary, indent=1) + "\n"), comm)
if comm.rank == 0:
    print(json.dumps(summary, indent=1))
assert off <= 1e-3
