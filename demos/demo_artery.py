# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: light
# ---

# # A pressurised artery wall, torn and glued
#
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
#
# The wall of a branched vessel with a sac, two layers of fibre-reinforced tissue, is inflated from
# rest. Each Newton step is solved by an all-floating FETI method on 64 subdomains, and the first
# one by a direct solver (MUMPS) as well. After G. Augustin, Holzapfel, Steinbach, *Classical and
# all-floating FETI methods for the simulation of arterial tissues*, IJNME 99 (2014).
#
#     python3 demos/demo_artery.py --pressure 10
#     mpirun -n 2 python3 demos/demo_artery.py -feti_pc_type lumped -snes_monitor
#
# `--geometry tube` takes a two-layer tube instead, `--mesh FILE` a wall of your own
# (`meshes/README.md`), and `--wall FILE.toml` its layers and the conditions on its surfaces, too
# (`docs/walls.md`; `demos/wall.toml` is an example). `--checkpoint FOLDER` keeps the last load
# step, and with `--restart` beside it a run that was killed goes on. `--help` lists all options;
# those with one dash are PETSc's.
#
# Units: mm, kPa, and hence mN; pressures on the command line are in mmHg.

# +
import json
import logging
import sys
import time

import petsc4py

from artery import arguments

args, petsc_options, rest = arguments.parse(sys.argv[1:])
petsc4py.init([sys.argv[0], *rest])

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from artery.case import default_case
from artery.estimate import estimated_seconds
from artery.wall_file import read_case
from drawing import pictures
from drawing.render import gather_cells

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, compare, kinematics, loads, materials
from dolfinx_feti.collective import on_first
from dolfinx_feti.loading import Checkpoint, LoadStep, Steps, follow_load, write_history
from dolfinx_feti.loading.progress import duration
from dolfinx_feti.loading.steps import load_step
from dolfinx_feti.output import (
    FieldWriter,
    cell_values,
    create_patches,
    recovered_field,
    writable_folder,
)
from dolfinx_feti.wall import apply_conditions, by_layer
from dolfinx_feti.wall.fibres import fibre_families, fibre_frame
from meshes.walls import create_wall

comm = MPI.COMM_WORLD
started = time.perf_counter()

# Kernels for this processor, sums in any order: a third less time. NaN stay, unlike with -Ofast.
FAST = "-O3 -march=native -fno-math-errno -fno-trapping-math -fno-signed-zeros -fassociative-math"

logging.basicConfig(format="%(message)s", stream=sys.stdout)
logging.getLogger("dolfinx_feti").setLevel(logging.INFO)  # a line for each load step


def say(text: str) -> None:
    """Print on the first process."""
    if comm.rank == 0:
        print(text, flush=True)


# -

# What is wrong with the input ends the demo with one line, now and not after the computation: a
# folder that cannot be written, or a checkpoint of another wall.

# +
with arguments.input_errors(comm):
    case = None if args.wall is None else read_case(args.wall, comm)
    folder = writable_folder(args.output, comm)
    checkpoint, restarted = None, ""
    if args.checkpoint:
        physics = {"c [kPa]": args.c} if case is None else {"wall": case.description}
        parameters = physics | {"κ [kPa]": args.kappa}
        checkpoint = Checkpoint(args.checkpoint, comm, parameters=parameters, restart=args.restart)
if args.restart:
    load = checkpoint.record["loads"][-1]
    say(f"from {load:g} mmHg on")
    restarted = f"_from_{load:g}_mmHg"
# -

# ## The wall
#
# The vessel is grown on a surface that comes with Gmsh: two thirds of the thickness of 1 mm are the
# *media*, the rest is the *adventitia*. It has three openings. A wall knows the names of its layers
# and surfaces.

# +
source = (args.mesh or args.geometry) if case is None else case.mesh
with arguments.input_errors(comm):
    scale = 1.0 if case is None else case.scale
    wall, quality = create_wall(source, comm, size=args.size, folder=folder, scale=scale)
    if case is None:
        case = default_case(wall, source, c=args.c, pressure=args.pressure)
    case.check(wall)
mesh = wall.mesh
say(f"{quality}")
# -

# In the media and in the adventitia lie two families of collagen fibres each, with the angles ±29°
# and ±62° from the circumferential direction. That direction comes from two Laplace problems: one
# potential grows from the lumen to the outer wall, the other from the inlet to the other openings.

# +
frame, fibres = None, ()
if case.has_fibres:
    with arguments.input_errors(comm):
        frame = fibre_frame(wall, **case.fibres)
    fibres = fibre_families(wall, frame, {name: t.angle for name, t in case.layers.items()})
# -

# ## The energy
#
# The matrix material resists shear, the fibres resist tension, and κ penalises a change of volume
# (Holzapfel, Gasser, Ogden 2000):
#
# $$
# \bar\Psi(C) = \frac c2 (\bar I_1 - 3)
#   + \sum_{i=4,6} \frac{k_1}{2 k_2}\left(e^{k_2 (\bar I_i - 1)^2} - 1\right)_{\bar I_i > 1},
# \qquad
# \Pi(u, p) = \int_\Omega \bar\Psi(C) + p\,(J - 1) - \frac{p^2}{2\kappa}\,\mathrm d X .
# $$
#
# Each layer has its own c, k₁ and k₂. u is quadratic and continuous, p constant in each cell: it
# will be condensed out of each Newton step, so that the solver sees displacements only.

# +
V = dolfinx.fem.functionspace(mesh, ("Lagrange", args.degree, (3,)))
Q = dolfinx.fem.functionspace(mesh, ("DG", 0))
u, p = dolfinx.fem.Function(V, name="displacement"), dolfinx.fem.Function(Q, name="p")
v, q, du = ufl.TestFunction(V), ufl.TestFunction(Q), ufl.TrialFunction(V)

c, k1, k2 = (
    by_layer(wall, {name: getattr(tissue, key) for name, tissue in case.layers.items()})
    for key in ("c", "k1", "k2")
)
F = kinematics.deformation_gradient(u)
C, J = kinematics.right_cauchy_green(F), kinematics.jacobian(F)
if fibres:
    psi = materials.holzapfel_gasser_ogden(C, *fibres, c=c, k1=k1, k2=k2, J=J)
else:
    psi = materials.neo_hookean(C, c=c, J=J)
psi += materials.perturbed_lagrangian(J, p, args.kappa)
energy = psi * ufl.dx
# -

# ## Load and boundary conditions
#
# The pressure follows the deformed lumen: its virtual work is $\int p\,(J F^{-\top} N)\cdot v\,
# \mathrm d A$. Where the rims are clamped its tangent is symmetric in sum, but not subdomain by
# subdomain; taking the symmetric part changes nothing in the assembled matrix and keeps the local
# ones symmetric. The openings are clamped, if a file does not say otherwise.

# +
with arguments.input_errors(comm):
    boundary = apply_conditions(wall, u, case.conditions, axis=case.axis)
F_u = ufl.derivative(energy, u, v) + boundary.residual
F_p = ufl.derivative(energy, p, q)
K = ufl.derivative(ufl.derivative(energy, u, v), u, du) + boundary.tangent
# -

# ## Tearing and gluing
#
# Up to here everything is a dolfinx user's own. The problem cuts the cells of each process into
# subdomains $\Omega_i$ that share no dof. Neighbours are glued, and the clamped rims held, by
# multipliers λ:
#
# $$
# K_i\, u_i + B_i^\top \lambda = f_i, \qquad \sum_i B_i u_i = 0 .
# $$
#
# All subdomains float, so that each has the same six rigid body motions in its kernel, as long as
# it carries no load. What the options on the command line say goes to this solver's prefix.

# +
with arguments.input_errors(comm):
    problem = NonlinearProblem(
        [F_u, F_p],
        u,
        bcs=boundary.bcs,
        J=K,
        condense=p,
        energy=None if boundary.energy is None else energy + boundary.energy,
        subdomains=args.subdomains,
        petsc_options_prefix="artery_",
        petsc_options=petsc_options,
        quadrature_degree=2 * args.degree,
        jit_options={"cffi_extra_compile_args": FAST.split()},
    )
    if args.restart:
        checkpoint.read([u, p])  # of this problem
        if case.axis is not None:
            boundary.set_stretch(case.stretch)
parts = problem.decomposition
subdomains = comm.allreduce(parts.count)
dofs = V.dofmap.index_map.size_global * V.dofmap.index_map_bs
say(f"{dofs} dofs, {subdomains} subdomains, {comm.size} process(es)")
way = 1.0 if not args.restart else max(case.pressure - load, 0.0) / case.pressure
guess = estimated_seconds(dofs, way * args.steps, comm.size)
about = f"about {duration(guess)}, roughly" if guess >= 30.0 else "less than two minutes"
say(f"This takes {about}; a line for each load step says more")
# -

# ## What is written
#
# The Cauchy stress of the energy above is $\sigma = J^{-1}\,\partial_F(\bar\Psi + p J)\,F^\top$;
# its magnitude is $\sigma_\mathrm{mag} = \sqrt{\sigma:\sigma}$. It jumps from cell to cell, as
# p does, and is written so. The pictures show the magnitude of the recovered stress, which is
# continuous in each layer (`docs/stresses.md`). What each Newton step cost goes to `history.csv`.

# +
stress = kinematics.cauchy_stress(psi, F)
sigma = kinematics.stress_magnitude(stress)
layer = by_layer(wall, {name: float(i) for i, name in enumerate(case.layers)})
subdomain = dolfinx.fem.Function(Q)
subdomain.x.array[Q.dofmap.list[: len(parts.subdomain), 0]] = parts.first + parts.subdomain
layer.name, subdomain.name = "layer", "subdomain"
fields = [u, layer, subdomain, *fibres]
writer = FieldWriter(folder / f"wall{restarted}", fields, {"stress_magnitude": sigma, "J": J})
writer.write(0.0)


def report(step: LoadStep) -> None:
    """Write the fields and the history; dashpots begin a new time step."""
    boundary.advance(u)
    reached.append(step.load)
    history.append(step)
    writer.write(step.load)
    on_first(lambda: write_history(folder / "history.csv", history), comm)


# -

# ## Inflation
#
# The wall is soft in bending and stiffens in tension. Each load step begins with the tangent of the
# last equilibrium, a prediction along the path; the pressure's increment grows after quick steps,
# and is halved where Newton's method fails. On the way equilibrium is met to 1e-3 of the residual
# that the new load leaves, and linear systems to 1e-4; at the wanted pressure both are met to
# 1e-8. Dashpots see the pressure grow at the file's rate. A prestretch comes first: ends that are
# clamped or slide are pulled apart. Each load step leaves a line in the log.


# +
def set_load(mmhg: float) -> None:
    """Set the pressure, and the time that it takes to get there."""
    boundary.pressure.value = loads.mmhg(mmhg)
    if case.rate is not None and mmhg != reached[-1]:
        boundary.time_step.value = abs(mmhg - reached[-1]) / case.rate


if case.axis is not None and not args.restart:
    follow_load(
        problem,
        boundary.set_stretch,
        [case.stretch],
        Steps(first=abs(case.stretch - 1.0) / 4, least=1e-4, rtol=1e-3),
        state=[u, p],
        start=1.0,
        unit="times the length",
    )
    boundary.advance(u)
reached, history = [0.0], []
if args.restart:
    reached.append(load)
    history += [load_step(step) for step in checkpoint.record["steps"]]
    boundary.advance(u)
first = case.pressure / args.steps
steps = follow_load(
    problem,
    set_load,
    [case.pressure],
    Steps(first=first, least=first / 64, growth=1.15, quick=4, rtol=1e-3, linear_rtol=1e-4),
    state=[u, p],
    on_step=report,
    checkpoint=checkpoint,
    unit="mmHg",
)
writer.close()
newton = [s for step in steps for s in step.history]
spent = [s for step in steps for s in step.all_steps]  # failed attempts included
# -

# ## Pictures
#
# The first process draws them; were its disk full, `on_first` would let all of them know.

# +
recovered = recovered_field(
    stress,
    create_patches(mesh, wall.cell_tags),
    normal=None if frame is None else ufl.inv(F).T * frame.transmural,
)
values = {
    "stress": cell_values(kinematics.stress_magnitude(recovered), mesh),
    "subdomain": parts.first + parts.subdomain,
    "layer": layer.x.array[: len(parts.subdomain)],
}
for a in fibres:
    values[a.name] = a.x.array.reshape(-1, 3)[: len(parts.subdomain)]
cells = gather_cells(u, values)


def draw() -> None:
    """Draw the wall, its fibres, and Newton's convergence."""
    pictures.draw_wall(folder / "wall.png", cells, pressure=case.pressure)
    if fibres:
        pictures.draw_fibres(folder / "fibres.png", cells, list(case.layers))
    pictures.draw_convergence(folder / "convergence.png", steps)


on_first(draw, comm)
# -

# ## FETI beside a direct solver
#
# A last Newton step, towards one per cent more pressure: FETI gets the torn matrix, MUMPS the
# assembled one, and both begin with nothing set up. On the way FETI has kept parts of its set-up
# from one Newton step to the next; MUMPS is taken to need the same for each.

# +
unbalanced = problem.residual_norm()
boundary.pressure.value = 0.0
load_alone = problem.residual_norm()  # what the stress balances
boundary.pressure.value = 1.01 * loads.mmhg(case.pressure)
comparison = compare(problem, ["feti", "mumps"])
boundary.pressure.value = loads.mmhg(case.pressure)
feti, mumps = comparison.records
solves, way = sum(s.solves for s in spent), sum(s.seconds_linear for s in spent)
direct = solves * (mumps["seconds_setup"] + mumps["seconds_solve"])
say(f"\nA Newton step at {case.pressure:g} mmHg: {comparison}\n")
say(f"{solves} linear solves on the way: FETI {way:.0f} s, MUMPS would take {direct:.0f} s")
# -

# ## Summary
#
# Every linear system was solved to its tolerance, as measured on the assembled one, and the last
# one agrees with MUMPS.

# +
furthest = np.linalg.norm(u.x.array.reshape(-1, 3), axis=1).max()
summary = {
    "geometry": str(source),
    "pressure_mmhg": steps[-1].load,
    "kappa_kpa": args.kappa,
    "c_kpa": {name: tissue.c for name, tissue in case.layers.items()},
    "processes": comm.size,
    "subdomains": subdomains,
    "cells": mesh.topology.index_map(3).size_global,
    "least_quality": quality.minimum,
    "dofs": dofs,
    "load_steps": [step.load for step in steps],
    "failed_steps": sum(step.failures for step in steps),
    "newton_iterations": len(spent),
    "linear_iterations": sum(s.linear_iterations for s in spent),
    "iterations_per_newton": [s.linear_iterations for s in newton],
    "max_linear_ratio": max(s.linear_residual / s.linear_rtol for s in newton),
    "newton_residual": unbalanced / load_alone,
    "max_displacement_mm": comm.allreduce(furthest, op=MPI.MAX),
    "difference_to_mumps": feti["difference_to_direct"],
    "last_step": {"feti": feti, "mumps": mumps},
    "seconds_linear_feti": way,
    "seconds_linear_mumps": direct,
    "seconds": time.perf_counter() - started,
    "versions": {"dolfinx": dolfinx.__version__, "petsc": list(PETSc.Sys.getVersion())},
}
on_first(lambda: (folder / "summary.json").write_text(json.dumps(summary, indent=1) + "\n"), comm)
say(f"\n{summary['seconds']:.0f} s; the results are in {folder}/")

assert summary["max_linear_ratio"] <= 1.0
assert summary["difference_to_mumps"] <= 1e-6
