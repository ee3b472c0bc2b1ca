# # A case in a file, and a command line
#
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
#
# The wall, its layers and the conditions on its surfaces are in a TOML file; the command line
# chooses mesh size, pressure and subdomains. The program inflates any such wall, and ends with one
# line if the file or an argument is wrong. Without a file it inflates the artery of
# `demo_artery.py`.
#
#     python3 demos/demo_case.py --wall demos/wall.toml
#     mpirun -n 2 python3 demos/demo_case.py --mesh tube -case_feti_pc_type lumped
#
# `docs/cases.md` explains all keys. Words with a single dash are PETSc's. Units: mm, kPa, mN;
# pressures on the command line are in mmHg.

# +
import csv
import json
import logging
import sys
from dataclasses import asdict
from pathlib import Path

import petsc4py
from mpi4py import MPI

petsc4py.init(sys.argv)  # for options of PETSc such as -log_view, before anything imports PETSc

import numpy as np

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, compare, kinematics, loads, materials
from dolfinx_feti.loading import Steps, follow_load
from dolfinx_feti.meshes.arguments import (
    RootParser,
    count,
    exit_on_errors,
    parse_all,
    positive,
    split_petsc_options,
)
from dolfinx_feti.meshes.walls import open_case
from dolfinx_feti.output import (
    FieldWriter,
    create_patches,
    pictures,
    recovered_field,
    writable_folder,
)
from dolfinx_feti.wall import apply_conditions, by_layer, fibre_families, fibre_frame

comm = MPI.COMM_WORLD
# -

# ## The command line
#
# `exit_on_errors` turns errors of the user's input into one line and the exit status 2, on all
# processes.

# +
parser = RootParser("demo_case.py", allow_abbrev=False)
parser.add_argument("--mesh", default="vessel", help="vessel, tube, or a file in mm")
parser.add_argument("--wall", type=Path, help="TOML file with mesh, layers and conditions")
parser.add_argument("--size", type=positive, help="length of the elements' edges [mm]")
parser.add_argument("--pressure", type=positive, help="[mmHg], 10 or what the file says")
parser.add_argument("--steps", type=count, default=10, help="the first load step is a … of it")
parser.add_argument("--subdomains", type=count, default=64, help="over all processes, 64")
parser.add_argument("--degree", type=int, choices=(1, 2), default=2, help="of displacements, 2")
parser.add_argument("--output", type=Path, default=Path("output/case"), help="a folder")
words, _ = split_petsc_options(sys.argv[1:])
args = parse_all(parser, words)
logging.basicConfig(format="%(message)s", stream=sys.stdout)
logging.getLogger("dolfinx_feti").setLevel(logging.INFO)  # a line for each load step
# -

# ## The case
#
# `case.layers` has a material with the keys of the file for each layer. A wall without fibres is
# neo-Hookean.

# +
with exit_on_errors(parser):
    folder = writable_folder(args.output, comm)
    case, wall, quality = open_case(args.wall, args.mesh, comm, size=args.size, folder=folder)
    if case.image_pressure or case.has_residual_stress or case.cavities:
        raise ValueError(
            f"{args.wall}: leave out [image], [cavity], opening_angle, axial_stretch; "
            "demo_patient.py has a wall from an image"
        )
    c = by_layer(wall, {name: material.c for name, material in case.layers.items()})
    k1 = by_layer(wall, {name: material.k1 for name, material in case.layers.items()})
    k2 = by_layer(wall, {name: material.k2 for name, material in case.layers.items()})
    has_fibres = any(material.k1 for material in case.layers.values())
    frame = None
    fibres = []
    if has_fibres:
        angles = {name: material.angle for name, material in case.layers.items()}
        frame = fibre_frame(wall, **case.fibres)
        fibres = [*fibre_families(wall, frame, angles)]
mesh = wall.mesh
target = args.pressure or case.pressure  # mmHg
# -

# ## The problem
#
# κ is 1000 kPa, for the 10 mmHg of the default case; take 10⁵ kPa at the pressure of blood.

# +
V = dolfinx.fem.functionspace(mesh, ("Lagrange", args.degree, (3,)))
u = dolfinx.fem.Function(V, name="displacement")
p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)), name="p")
F = kinematics.deformation_gradient(u)
C = kinematics.right_cauchy_green(F)
J = kinematics.jacobian(F)
if has_fibres:
    psi = materials.holzapfel_gasser_ogden(C, *fibres, c=c, k1=k1, k2=k2, J=J)
else:
    psi = materials.neo_hookean(C, c=c, J=J)
psi += materials.perturbed_lagrangian(J, p, kappa=1000.0)

with exit_on_errors(parser):
    boundary = apply_conditions(wall, u, case.conditions, axis=case.prestretch_axis)
    problem = NonlinearProblem(
        psi * ufl.dx,
        u,
        boundary=boundary,
        condense=p,
        subdomains=args.subdomains,
        petsc_options_prefix="case_",
        quadrature_degree=2 * args.degree,
    )
sizes = {
    "dofs": V.dofmap.index_map.size_global * 3,
    "subdomains": comm.allreduce(problem.decomposition.count),
}
if comm.rank == 0:
    print(f"{quality}\n{sizes}, {comm.size} process(es)", flush=True)
# -

# ## Prestretch and inflation
#
# First the prestretch is applied, then the pressure. If there are dashpots, the pressure grows at
# the rate in the file.

# +
if case.prestretch != 1.0:
    first = abs(case.prestretch - 1.0) / 4
    steps = Steps(first=first, least=first / 64, rtol=1e-3)
    follow_load(problem, boundary.set_stretch, [case.prestretch], steps, start=1.0)

history = []


def set_load(mmhg):
    """Set the pressure, and the time that it takes to get there."""
    boundary.set_pressure(loads.mmhg(mmhg))
    before = history[-1].load if history else 0.0
    if case.rate is not None and mmhg != before:
        boundary.time_step.value = abs(mmhg - before) / case.rate


with FieldWriter(folder / "wall", [u, *fibres], {"J": J}) as writer:

    def record(step):
        history.append(step)
        writer.write(step.load)

    first = target / args.steps
    steps = Steps(first=first, least=first / 64, growth=1.15, quick=4, rtol=1e-3, linear_rtol=1e-3)
    follow_load(problem, set_load, [target], steps, on_step=record, unit="mmHg")
# -

# ## Pictures

# +
if has_fibres:
    panels = [pictures.fibres(wall, fibres, layer, title=layer) for layer in case.layers]
    pictures.draw(folder / "fibres.png", *panels)

normal = None
if frame is not None:
    normal = ufl.inv(F).T * frame.transmural
sigma = kinematics.cauchy_stress(psi, F)
stress = recovered_field(sigma, create_patches(mesh, wall.cell_tags), normal=normal)
pictures.draw(
    folder / "wall.png",
    pictures.subdomains(problem, title="subdomains at rest"),
    pictures.field(
        kinematics.stress_magnitude(stress),
        "stress magnitude √(σ : σ) [kPa]",
        displacement=u,
        title=f"at {target:g} mmHg",
    ),
)
# -

# ## Compared with a direct solver, and tables
#
# The program solves one more Newton step, towards one per cent more pressure. `history.csv` has a
# line for each Newton step.

# +
boundary.set_pressure(1.01 * loads.mmhg(target))
comparison = compare(problem, ["feti", "mumps"])
assert comparison.records[0]["difference_to_direct"] <= 1e-6

newton_steps = []
for load_step in history:
    for newton_step in load_step.all_steps:
        newton_steps.append({"load": load_step.load} | asdict(newton_step))
displacements = np.linalg.norm(u.x.array.reshape(-1, 3), axis=1)
summary = sizes | {
    "load_steps": [step.load for step in history],
    "newton_iterations": len(newton_steps),
    "max_displacement_mm": comm.allreduce(displacements.max(), op=MPI.MAX),
    "last_step": comparison.records,
}
if comm.rank == 0:
    print(f"A Newton step at {target:g} mmHg: {comparison}\nThe results are in {folder}/")
    (folder / "summary.json").write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    with (folder / "history.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, newton_steps[0])
        table.writeheader()
        table.writerows(newton_steps)
