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
# (`meshes/README.md`); `--checkpoint FOLDER` keeps the last load step, and with `--restart` beside
# it a run that was killed goes on. `--help` lists all options; those with one dash are PETSc's.
#
# Units: mm, kPa, and hence mN; pressures on the command line are in mmHg.

# +
import json
import sys
import time

import petsc4py

import arguments

args, petsc_options, rest = arguments.parse(sys.argv[1:])
petsc4py.init([sys.argv[0], *rest])

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from drawing import pictures
from drawing.render import gather_cells
from first_step import FirstStep

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, kinematics, loads, materials
from dolfinx_feti.collective import on_first
from dolfinx_feti.loading import Checkpoint, LoadStep, Steps, follow_load
from dolfinx_feti.output import (
    FieldWriter,
    cell_values,
    create_patches,
    recovered_field,
    writable_folder,
)
from dolfinx_feti.wall import by_layer, facets, openings, surface_measure
from dolfinx_feti.wall.fibres import fibre_families, fibre_frame
from meshes.walls import create_wall

comm = MPI.COMM_WORLD
started = time.perf_counter()


def say(text: str) -> None:
    """Print on the first process."""
    if comm.rank == 0:
        print(text, flush=True)


# -

# An output folder that cannot be written is better found now than after the computation, and so is
# a checkpoint of another wall.

# +
folder = writable_folder(args.output, comm)
checkpoint, restarted = None, ""
if args.checkpoint:
    parameters = {"c [kPa]": args.c, "κ [kPa]": args.kappa}
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

wall, quality = create_wall(args.mesh or args.geometry, comm, size=args.size, folder=folder)
mesh = wall.mesh
say(f"{quality}")

# In the media and in the adventitia lie two families of collagen fibres each, with the angles ±29°
# and ±62° from the circumferential direction. That direction comes from two Laplace problems: one
# potential grows from the lumen to the outer wall, the other from the inlet to the other openings.

frame = fibre_frame(wall)
a1, a2 = fibre_families(wall, frame)

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
# u is quadratic and continuous, p constant in each cell: it will be condensed out of each Newton
# step, so that the solver sees displacements only.

# +
V = dolfinx.fem.functionspace(mesh, ("Lagrange", args.degree, (3,)))
Q = dolfinx.fem.functionspace(mesh, ("DG", 0))
u, p = dolfinx.fem.Function(V, name="displacement"), dolfinx.fem.Function(Q, name="p")
v, q, du = ufl.TestFunction(V), ufl.TestFunction(Q), ufl.TrialFunction(V)

tissue = materials.ArteryParameters(c=args.c)
F = kinematics.deformation_gradient(u)
C, J = kinematics.right_cauchy_green(F), kinematics.jacobian(F)
psi = materials.holzapfel_gasser_ogden(C, a1, a2, c=tissue.c, k1=tissue.k1, k2=tissue.k2, J=J)
psi += materials.perturbed_lagrangian(J, p, args.kappa)
energy = psi * ufl.dx
# -

# ## Load and boundary conditions
#
# The pressure follows the deformed lumen: its virtual work is $\int p\,(J F^{-\top} N)\cdot v\,
# \mathrm d A$. Where the rims are clamped its tangent is symmetric in sum, but not subdomain by
# subdomain; taking the symmetric part changes nothing in the assembled matrix and keeps the local
# ones symmetric. The openings are clamped.

# +
lumen = surface_measure(wall)(wall.surfaces["lumen"])
pressure = dolfinx.fem.Constant(mesh, 0.0)  # kPa

F_u = ufl.derivative(energy, u, v) + loads.follower_pressure(pressure, u, v, lumen)
F_p = ufl.derivative(energy, p, q)
K = ufl.derivative(ufl.derivative(energy, u, v), u, du)
K += loads.follower_pressure_tangent(pressure, u, v, du, lumen, "symmetric")

rims = np.concatenate([facets(wall, name) for name in openings(wall)])
bc = dolfinx.fem.dirichletbc(np.zeros(3), dolfinx.fem.locate_dofs_topological(V, 2, rims), V)
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
problem = NonlinearProblem(
    [F_u, F_p],
    u,
    bcs=[bc],
    J=K,
    condense=p,
    energy=energy + loads.pressure_potential(pressure, u, lumen),
    subdomains=args.subdomains,
    petsc_options_prefix="artery_",
    petsc_options=petsc_options,
    quadrature_degree=2 * args.degree,
)
first_step = FirstStep(problem)
parts = problem.decomposition
subdomains = comm.allreduce(parts.count)
dofs = V.dofmap.index_map.size_global * V.dofmap.index_map_bs
say(f"{dofs} dofs, {subdomains} subdomains, {comm.size} process(es)")
# -

# ## What is written
#
# The Cauchy stress of the energy above is $\sigma = J^{-1}\,\partial_F(\bar\Psi + p J)\,F^\top$;
# its magnitude is $\sigma_\mathrm{mag} = \sqrt{\sigma:\sigma}$. It jumps from cell to cell, as
# p does, and is written so. The pictures show the magnitude of the recovered stress, which is
# continuous in each layer (`docs/stresses.md`).

# +
stress = kinematics.cauchy_stress(psi, F)
sigma = kinematics.stress_magnitude(stress)
layer = by_layer(wall, {"media": 0.0, "adventitia": 1.0})
subdomain = dolfinx.fem.Function(Q)
subdomain.x.array[Q.dofmap.list[: len(parts.subdomain), 0]] = parts.first + parts.subdomain
layer.name, subdomain.name = "layer", "subdomain"
fields = [u, layer, subdomain, a1, a2]
writer = FieldWriter(folder / f"wall{restarted}", fields, {"stress_magnitude": sigma, "J": J})
writer.write(0.0)


def report(step: LoadStep) -> None:
    """Write the fields and say what a load step cost."""
    writer.write(step.load)
    linear = [s.linear_iterations for s in step.history]
    say(
        f"{step.load:8.4g} mmHg  {len(linear)} Newton steps with {linear} FETI iterations, "
        f"{step.seconds:.1f} s" + f", after {step.failures} failure(s)" * (step.failures > 0)
    )


# -

# ## Inflation
#
# The wall is soft in bending and stiffens in tension. Each load step begins with the tangent of the
# last equilibrium, a prediction along the path; the pressure's increment grows after quick steps,
# and is halved where Newton's method fails. On the way equilibrium is met to 1e-3 of the residual
# that the new load leaves, at the wanted pressure to the solver's tolerance.

# +
first = args.pressure / args.steps
steps = follow_load(
    problem,
    lambda mmhg: setattr(pressure, "value", loads.mmhg(mmhg)),
    [args.pressure],
    Steps(first=first, least=first / 64, growth=1.15, quick=4, rtol=1e-3),
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
    stress, create_patches(mesh, wall.cell_tags), normal=ufl.inv(F).T * frame.transmural
)
values = {
    "stress": cell_values(kinematics.stress_magnitude(recovered), mesh),
    "subdomain": parts.first + parts.subdomain,
    "layer": layer.x.array[: len(parts.subdomain)],
    "fibres_1": a1.x.array.reshape(-1, 3)[: len(parts.subdomain)],
    "fibres_2": a2.x.array.reshape(-1, 3)[: len(parts.subdomain)],
}
cells = gather_cells(u, values)


def draw() -> None:
    """Draw the wall, its fibres, and Newton's convergence."""
    pictures.draw_wall(folder / "wall.png", cells, pressure=args.pressure)
    pictures.draw_fibres(folder / "fibres.png", cells)
    pictures.draw_convergence(folder / "convergence.png", steps)


on_first(draw, comm)
# -

# ## FETI beside a direct solver
#
# The first linear system of the first load step, that of the wall at rest, is assembled and solved
# by MUMPS, a symmetric factorisation of the whole matrix. After a restart this is past.

# +
feti = mumps = difference = None
figures = [
    ("set-up [s]", "seconds_setup", ".2f"),
    ("solution [s]", "seconds_solve", ".2f"),
    ("memory [MiB]", "peak_mib", ".0f"),
    ("iterations", "iterations", "d"),
    ("‖b − K x‖/‖b‖", "relative_residual", ".1e"),
]
if not args.restart:
    feti = first_step.feti()
    mumps, difference = first_step.mumps()
    say(f"\nThe first Newton step, {dofs} dofs\n{'':<18}{'FETI':>10}{'MUMPS':>10}")
    for figure, key, form in figures:
        say(f"{figure:<18}{feti[key]:>10{form}}{mumps[key]:>10{form}}")
    say(f"{'difference of u':<18}{difference:>10.1e}")
# -

# ## Summary
#
# Every Newton step was solved to 1e-8, measured on the assembled system, and the first one agrees
# with MUMPS.

# +
furthest = np.linalg.norm(u.x.array.reshape(-1, 3), axis=1).max()
summary = {
    "geometry": str(args.mesh or args.geometry),
    "pressure_mmhg": steps[-1].load,
    "kappa_kpa": args.kappa,
    "c_kpa": args.c,
    "processes": comm.size,
    "subdomains": subdomains,
    "cells": mesh.topology.index_map(3).size_global,
    "least_quality": quality.minimum,
    "dofs": dofs,
    "load_steps": [step.load for step in steps],
    "failed_steps": sum(step.failures for step in steps),
    "newton_iterations": len(spent),
    "linear_iterations": sum(s.linear_iterations for s in spent),
    "max_linear_residual": max(s.linear_residual for s in newton),
    "max_displacement_mm": comm.allreduce(furthest, op=MPI.MAX),
    "difference_to_mumps": difference,
    "first_step": {"feti": feti, "mumps": mumps},
    "seconds": time.perf_counter() - started,
    "versions": {
        "dolfinx": dolfinx.__version__,
        "petsc": ".".join(map(str, PETSc.Sys.getVersion())),
    },
}
on_first(lambda: (folder / "summary.json").write_text(json.dumps(summary, indent=1) + "\n"), comm)
say(f"\n{summary['seconds']:.0f} s; the results are in {folder}/")

assert summary["max_linear_residual"] <= 1e-8
assert args.restart or difference <= 1e-6
