# # A pressurised artery wall, torn and glued
#
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
#
# A wall of two fibre-reinforced layers is inflated from rest. FETI solves each Newton step, and a
# direct solver (MUMPS) the last one. After Augustin, Holzapfel, Steinbach, IJNME 99 (2014).
#
#     python3 demos/demo_artery.py --pressure 10
#     mpirun -n 2 python3 demos/demo_artery.py --mesh tube -artery_feti_pc_type lumped
#
# `--mesh FILE` takes a wall of your own (`meshes/README.md`), and `--wall FILE.toml` its layers and
# the conditions on its surfaces, too (`docs/cases.md`; `demos/wall.toml` is an example). Words with
# a single dash are PETSc's. Units: mm, kPa, mN; pressures on the command line are in mmHg.

# +
import csv
import json
import logging
import sys
from dataclasses import asdict
from pathlib import Path

import petsc4py
from mpi4py import MPI

from meshes.arguments import Parser, count, parse_all, positive, refusals, without_petsc

own, petsc = without_petsc(sys.argv[1:])
petsc4py.init([sys.argv[0], *petsc])

import numpy as np
from common.drawing import draw_fibres, draw_wall, gather_cells

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, compare, kinematics, loads, materials
from dolfinx_feti.loading import Steps, follow_load
from dolfinx_feti.output import FieldWriter, cell_values, create_patches, recovered_field
from dolfinx_feti.runtime.collective import on_first
from dolfinx_feti.runtime.folders import writable_folder
from dolfinx_feti.wall import apply_conditions, by_layer
from dolfinx_feti.wall.fibres import fibre_families, fibre_frame
from meshes.walls import open_case

comm = MPI.COMM_WORLD
parser = Parser("demo_artery.py", allow_abbrev=False)
parser.add_argument("--mesh", default="vessel", help="vessel, tube, or a file in mm")
parser.add_argument("--wall", type=Path, help="TOML file with mesh, layers and conditions")
parser.add_argument("--size", type=positive, help="length of the elements' edges [mm]")
parser.add_argument("--pressure", type=positive, help="[mmHg], 10 or what the file says")
parser.add_argument("--steps", type=count, default=10, help="the first load step is a … of it")
parser.add_argument("--subdomains", type=count, default=64, help="over all processes, 64")
parser.add_argument("--degree", type=int, choices=(1, 2), default=2, help="of displacements, 2")
parser.add_argument("--output", type=Path, default=Path("output/artery"), help="a folder")
args = parse_all(parser, own)
logging.basicConfig(format="%(message)s", stream=sys.stdout)
logging.getLogger("dolfinx_feti").setLevel(logging.INFO)  # a line for each load step
# -

# ## The wall
#
# Two families of collagen fibres lie in each layer, *media* and *adventitia*, at ±29° and ±62° from
# the circumferential direction. The pressure acts on the inner surface; the openings are clamped.

# +
with refusals(parser):
    folder = writable_folder(args.output, comm)
    case, wall, quality = open_case(args.wall, args.mesh, comm, size=args.size, folder=folder)
    if case.image or case.has_residual_stress or case.cavities:
        raise ValueError(f"{args.wall}: leave out [image], [cavity], opening_angle, axial_stretch")
    tissues = case.layers.items()
    stiffness = {key: by_layer(wall, {name: getattr(tissue, key) for name, tissue in tissues})
                 for key in ("c", "k1", "k2")}  # fmt: skip
    frame, fibres = None, ()
    if any(tissue.k1 for _, tissue in tissues):
        frame = fibre_frame(wall, **case.fibres)
        fibres = fibre_families(wall, frame, {name: tissue.angle for name, tissue in tissues})
mesh, target = wall.mesh, args.pressure or case.pressure  # [mmHg]
# -

# ## The energy
#
# Of Holzapfel, Gasser, Ogden (2000). u is quadratic, p constant in each cell: it will be condensed
# out of each Newton step.

# +
V = dolfinx.fem.functionspace(mesh, ("Lagrange", args.degree, (3,)))
u = dolfinx.fem.Function(V, name="displacement")
p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)), name="p")
v, q, du = ufl.TestFunction(V), ufl.TestFunction(p.function_space), ufl.TrialFunction(V)
F = kinematics.deformation_gradient(u)
C, J = kinematics.right_cauchy_green(F), kinematics.jacobian(F)
psi = (materials.holzapfel_gasser_ogden(C, *fibres, **stiffness, J=J) if fibres
       else materials.neo_hookean(C, c=stiffness["c"], J=J))  # fmt: skip
psi += materials.perturbed_lagrangian(J, p, kappa=1000.0)
energy = psi * ufl.dx
# -

# ## Tearing and gluing
#
# The problem cuts the cells into subdomains, each with its own copy of the dofs on its boundary. CG
# on the interfaces solves a Newton step; its preconditioner solves on each subdomain and averages
# the copies of a dof. With `-artery_feti_formulation dual` it is the method of the paper.

# +
with refusals(parser):
    boundary = apply_conditions(wall, u, case.conditions, axis=case.axis)
    problem = NonlinearProblem(
        [ufl.derivative(energy, u, v) + boundary.residual, ufl.derivative(energy, p, q)],
        u,
        bcs=boundary.bcs,
        J=ufl.derivative(ufl.derivative(energy, u, v), u, du) + boundary.tangent,
        condense=p,
        energy=None if boundary.energy is None else energy + boundary.energy,
        subdomains=args.subdomains,
        petsc_options_prefix="artery_",
        quadrature_degree=2 * args.degree,
    )
parts = problem.decomposition
sizes = {"dofs": V.dofmap.index_map.size_global * 3, "subdomains": comm.allreduce(parts.count)}
if comm.rank == 0:
    print(f"{quality}\n{sizes}, {comm.size} process(es)", flush=True)
# -

# ## Inflation
#
# The increment of the load adapts. On the way equilibrium and linear systems are met to 1e-3, at
# the end to 1e-8. Dashpots see the pressure grow at the file's rate; a prestretch comes first.

# +
stress = kinematics.cauchy_stress(psi, F)
writer = FieldWriter(folder / "wall", [u, *fibres], {"J": J})  # for ParaView
history = []


def set_load(mmhg: float) -> None:
    """Set the pressure, and the time that it takes to get there."""
    boundary.pressure.value = loads.mmhg(mmhg)
    before = history[-1].load if history else 0.0
    if case.rate is not None and mmhg != before:
        boundary.time_step.value = abs(mmhg - before) / case.rate


if case.stretch != 1.0:
    pull = Steps(first := abs(case.stretch - 1.0) / 4, least=first / 64, rtol=1e-3)
    follow_load(problem, boundary.set_stretch, [case.stretch], pull, state=[u, p], start=1.0)
keep = lambda step: (history.append(step), writer.write(step.load))  # noqa: E731
first = target / args.steps
way = Steps(first, least=first / 64, growth=1.15, quick=4, rtol=1e-3, linear_rtol=1e-3)
follow_load(problem, set_load, [target], way, state=[u, p], on_step=keep, unit="mmHg")
writer.close()
if comm.rank == 0:  # what each Newton step has cost
    steps = [{"load": step.load} | asdict(s) for step in history for s in step.all_steps]
    with (folder / "history.csv").open("w", newline="") as file:
        table = csv.DictWriter(file, steps[0])
        table.writeheader()
        table.writerows(steps)
# -

# ## The wall, and its fibres
#
# The stress is *recovered*: continuous in each layer (`docs/stresses.md`). The first process draws.

# +
normal = ufl.inv(F).T * frame.transmural if frame else None
recovered = recovered_field(stress, create_patches(mesh, wall.cell_tags), normal=normal)
layer = by_layer(wall, {name: float(i) for i, name in enumerate(case.layers)})
fields = {"stress": kinematics.stress_magnitude(recovered), "layer": layer}
fields |= {f"fibres_{i}": a for i, a in enumerate(fibres, 1)}
values = {name: cell_values(field, mesh) for name, field in fields.items()}
cells = gather_cells(u, values | {"subdomain": parts.first + parts.subdomain})
on_first(lambda: draw_wall(folder / "wall.png", cells, pressure=target), comm)
if fibres:
    on_first(lambda: draw_fibres(folder / "fibres.png", cells, list(case.layers)), comm)
# -

# ## Compared with a direct solver
#
# One more Newton step, towards one per cent more pressure: FETI gets the torn matrix, MUMPS the
# assembled one, and neither has anything set up.

# +
boundary.pressure.value = 1.01 * loads.mmhg(target)
comparison = compare(problem, ["feti", "mumps"])
newton = [step for load_step in history for step in load_step.all_steps]
largest = comm.allreduce(np.linalg.norm(u.x.array.reshape(-1, 3), axis=1).max(), op=MPI.MAX)
summary = sizes | {
    "load_steps": [step.load for step in history],
    "newton_iterations": len(newton),
    "max_displacement_mm": largest,
    "last_step": comparison.records,
}
on_first(lambda: (folder / "summary.json").write_text(json.dumps(summary, indent=1) + "\n"), comm)
if comm.rank == 0:
    print(f"A Newton step at {target:g} mmHg: {comparison}\nThe results are in {folder}/")
assert all(s.linear_residual <= s.linear_rtol for step in history for s in step.history)
assert comparison.records[0]["difference_to_direct"] <= 1e-6
