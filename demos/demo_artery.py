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
# rest. A FETI method with 64 subdomains solves each Newton step, and at the end a direct solver
# (MUMPS) takes one as well. After C. M. Augustin, G. A. Holzapfel, O. Steinbach, *Classical and
# all-floating FETI methods for the simulation of arterial tissues*, IJNME 99 (2014).
#
#     python3 demos/demo_artery.py --pressure 10
#     mpirun -n 2 python3 demos/demo_artery.py --mesh tube -feti_pc_type lumped -snes_monitor
#
# `--mesh FILE` takes a wall of your own (`meshes/README.md`), and `--wall FILE.toml` its layers and
# the conditions on its surfaces, too (`docs/cases.md`; `demos/wall.toml` is an example). `--help`
# lists all options.
#
# Units: mm, kPa, and hence mN; pressures on the command line are in mmHg.

# +
import json
import logging
import sys
import time

import petsc4py
from mpi4py import MPI

from common.arguments import parse, parser

args, petsc_options, rest = parse(sys.argv[1:])
petsc4py.init([sys.argv[0], *rest])

import numpy as np
from common import pictures
from common.render import gather_cells

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, compare, kinematics, loads, materials
from dolfinx_feti.loading import LoadStep, Steps, follow_load, write_history
from dolfinx_feti.output import FieldWriter, cell_values, create_patches, recovered_field
from dolfinx_feti.runtime.collective import on_first
from dolfinx_feti.runtime.folders import writable_folder
from dolfinx_feti.wall import (
    Case,
    Clamp,
    Pressure,
    Tissue,
    apply_conditions,
    by_layer,
    openings,
    read_case,
)
from dolfinx_feti.wall.fibres import ANGLES, fibre_families, fibre_frame
from meshes.arguments import refusals
from meshes.walls import CREATE, open_wall

comm = MPI.COMM_WORLD
started = time.perf_counter()

logging.basicConfig(format="%(message)s", stream=sys.stdout)
logging.getLogger("dolfinx_feti").setLevel(logging.INFO)  # a line for each load step


def say(text: str) -> None:
    """Print on the first process."""
    if comm.rank == 0:
        print(text, flush=True)


# -

# ## The wall
#
# The vessel is grown on a surface that comes with Gmsh: two thirds of the thickness of 1 mm are the
# *media*, the rest is the *adventitia*. The pressure acts on the *lumen*, the inner surface; the
# three openings are clamped. Two families of collagen fibres lie in each layer, at ±29° and ±62°
# from the circumferential direction. That direction comes from two Laplace problems: one potential
# grows from the lumen to the outer wall, the other from the inlet to the other openings.
#
# A file given by `--wall` states all this for another wall. What is wrong with the input ends the
# demo with one line (`refusals`), before anything is computed.

# +
with refusals(parser):
    folder = writable_folder(args.output, comm)
    case, source, scale = None, args.mesh, 1.0
    if args.wall:
        case = read_case(args.wall, comm)
        if case.image or case.has_residual_stress or case.cavities:
            raise ValueError(
                f"{args.wall}: leave out [image], [cavity], opening_angle and axial_stretch: this "
                "wall is at rest, free of stress, and under a given pressure"
            )
        source = case.mesh if case.mesh in CREATE else args.wall.parent / case.mesh
        scale = case.scale
    wall, quality = open_wall(source, comm, size=args.size, folder=folder, scale=scale)
    if case is None:
        angles = {name: angle for name, angle in ANGLES.items() if name in wall.layers}
        case = Case(
            mesh=args.mesh,
            layers={name: Tissue(3.0, 2.3632, 0.8393, angle) for name, angle in angles.items()},
            conditions={"lumen": (Pressure(),)} | {name: (Clamp(),) for name in openings(wall)},
            pressure=10.0,
        )
    case.check(wall)
    tissues = case.layers.items()
    c, k1, k2 = (
        by_layer(wall, {name: getattr(tissue, key) for name, tissue in tissues})
        for key in ("c", "k1", "k2")
    )
    frame, fibres = None, ()
    if any(tissue.k1 for _, tissue in tissues):
        frame = fibre_frame(wall, **case.fibres)
        fibres = fibre_families(wall, frame, {name: tissue.angle for name, tissue in tissues})
mesh = wall.mesh
target = args.pressure or case.pressure  # [mmHg]
say(f"{quality}")
# -

# ## The energy
#
# The matrix material resists shear, the fibres resist tension, and κ penalises a change of volume
# (Holzapfel, Gasser, Ogden 2000). With $F = I + \nabla u$, $C = F^\top F$, $J = \det F$,
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

F = kinematics.deformation_gradient(u)
C, J = kinematics.right_cauchy_green(F), kinematics.jacobian(F)
if fibres:
    psi = materials.holzapfel_gasser_ogden(C, *fibres, c=c, k1=k1, k2=k2, J=J)
else:
    psi = materials.neo_hookean(C, c=c, J=J)
psi += p * (J - 1) - p**2 / (2 * args.kappa)
energy = psi * ufl.dx
# -

# ## Load and boundary conditions
#
# The pressure follows the deformed lumen $\Gamma$: its virtual work is
# $\int_\Gamma p_\Gamma\,(J F^{-\top} N)\cdot v\, \mathrm d A$. Where the rims are clamped its
# tangent is symmetric in sum, but not subdomain by subdomain; taking the symmetric part changes
# nothing in the assembled matrix and keeps the local ones symmetric.

# +
with refusals(parser):
    boundary = apply_conditions(wall, u, case.conditions, axis=case.axis)
F_u = ufl.derivative(energy, u, v) + boundary.residual
F_p = ufl.derivative(energy, p, q)
K = ufl.derivative(ufl.derivative(energy, u, v), u, du) + boundary.tangent
# -

# ## Tearing and gluing
#
# Up to here everything is a dolfinx user's own. The problem cuts the cells of each process into
# subdomains $\Omega_i$, each with its own copy of the dofs on its boundary. With the map $R_i$ from
# all displacements to those of a subdomain, a Newton step is
#
# $$ A\, \Delta u = -r, \qquad A = \sum_i R_i^\top K_i R_i . $$
#
# As a pressure is condensed here, the solver takes the *primal* form of the method: conjugate
# gradients on the dofs of the interfaces, which neighbours share. Its preconditioner solves on each
# subdomain and averages the copies of a dof; a coarse space covers what is costly to average. The
# clamped dofs are left out, and no multipliers are needed. With `-feti_formulation dual` it is the
# method of the paper: multipliers λ glue the subdomains and, as all of them float, impose the
# displacement of the clamped rims as well,
#
# $$ K_i\, u_i + B_i^\top \lambda = f_i, \qquad \sum_i B_i u_i = 0 . $$

# +
with refusals(parser):
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
    )
parts = problem.decomposition
subdomains = comm.allreduce(parts.count)
dofs = V.dofmap.index_map.size_global * V.dofmap.index_map_bs
say(f"{dofs} dofs, {subdomains} subdomains, {comm.size} process(es)")
# -

# ## What is written
#
# The Cauchy stress of the energy above is $\sigma = J^{-1}\,\partial_F(\bar\Psi + p J)\,F^\top$;
# its magnitude is $\sigma_\mathrm{mag} = \sqrt{\sigma:\sigma}$. It jumps from cell to cell, as p
# does, and is written so, for ParaView. What each Newton step cost goes to `history.csv`.

# +
stress = kinematics.cauchy_stress(psi, F)
layer = by_layer(wall, {name: float(i) for i, name in enumerate(case.layers)})
subdomain = dolfinx.fem.Function(Q, name="subdomain")
subdomain.x.array[Q.dofmap.list[: len(parts.subdomain), 0]] = parts.first + parts.subdomain
layer.name = "layer"
magnitude = {"stress_magnitude": kinematics.stress_magnitude(stress), "J": J}
writer = FieldWriter(folder / "wall", [u, layer, subdomain, *fibres], magnitude)
writer.write(0.0)
history: list[LoadStep] = []


def report(step: LoadStep) -> None:
    """Write the fields and the history."""
    history.append(step)
    writer.write(step.load)
    write_history(folder / "history.csv", history, comm)


# -

# ## Inflation
#
# The wall is soft in bending and stiffens in tension. A load step begins with the tangent of the
# last equilibrium $u_n$ and the new load $t_{n+1}$, a prediction along the path,
#
# $$ K'(u_n; t_n)\, \Delta u = -r(u_n; t_{n+1}), $$
#
# later ones with a parabola through three equilibria. The pressure's increment grows after quick
# steps and is halved where Newton's method fails. On the way equilibrium is met to 1e-3 of the
# residual that the new load leaves, and so are linear systems; at the wanted pressure both are met
# to 1e-8. Dashpots see the pressure grow at the file's rate. A prestretch comes first: it pulls
# apart the ends that are clamped or slide.


# +
def set_load(mmhg: float) -> None:
    """Set the pressure, and the time that it takes to get there."""
    boundary.pressure.value = loads.mmhg(mmhg)
    before = history[-1].load if history else 0.0
    if case.rate is not None and mmhg != before:
        boundary.time_step.value = abs(mmhg - before) / case.rate


if case.stretch != 1.0:
    first = abs(case.stretch - 1.0) / 4
    pull = Steps(first=first, least=first / 64, rtol=1e-3)
    follow_load(problem, boundary.set_stretch, [case.stretch], pull, state=[u, p], start=1.0)
first = target / args.steps
steps = follow_load(
    problem,
    set_load,
    [target],
    Steps(first=first, least=first / 64, growth=1.15, quick=4, rtol=1e-3, linear_rtol=1e-3),
    state=[u, p],
    on_step=report,
    unit="mmHg",
)
writer.close()
spent = [s for step in steps for s in step.all_steps]  # failed attempts included
# -

# ## Pictures
#
# They show the magnitude of the *recovered* stress, which is continuous in each layer
# (`docs/stresses.md`). The first process draws; were its disk full, `on_first` would let all of
# them know.

# +
normal = ufl.inv(F).T * frame.transmural if frame else None
recovered = recovered_field(stress, create_patches(mesh, wall.cell_tags), normal=normal)
values = {
    "stress": cell_values(kinematics.stress_magnitude(recovered), mesh),
    "subdomain": parts.first + parts.subdomain,
    "layer": layer.x.array[: len(parts.subdomain)],
}
values |= {a.name: a.x.array.reshape(-1, 3)[: len(parts.subdomain)] for a in fibres}
cells = gather_cells(u, values)


def draw() -> None:
    """Draw the wall, its fibres, and Newton's convergence."""
    pictures.draw_wall(folder / "wall.png", cells, pressure=target)
    if fibres:
        pictures.draw_fibres(folder / "fibres.png", cells, list(case.layers))
    pictures.draw_convergence(folder / "convergence.png", steps)


on_first(draw, comm)
# -

# ## Compared with a direct solver
#
# One more Newton step, towards one per cent more pressure: FETI gets the torn matrix, MUMPS the
# assembled one, and neither has anything set up. On the way FETI kept parts of its set-up from one
# tangent to the next; MUMPS is taken to need the same time for each tangent. Where Newton's method
# kept a tangent, both only solve.

# +
unbalanced = problem.residual_norm()
boundary.pressure.value = 0.0
load_alone = problem.residual_norm()  # what the stress balances
boundary.pressure.value = 1.01 * loads.mmhg(target)
comparison = compare(problem, ["feti", "mumps"])
boundary.pressure.value = loads.mmhg(target)
feti, mumps = comparison.records
solves, seconds = sum(s.solves for s in spent), sum(s.seconds_linear for s in spent)
tangents = solves - sum(s.tangent_lag > 0 for s in spent)
direct = tangents * mumps["seconds_setup"] + solves * mumps["seconds_solve"]
say(f"\nA Newton step at {target:g} mmHg: {comparison}\n")
say(
    f"{solves} linear solves with {tangents} tangents on the way: FETI {seconds:.0f} s, "
    f"MUMPS would take {direct:.0f} s"
)
# -

# ## Summary
#
# Every linear system was solved to its tolerance, as measured on the assembled one, and the last
# one agrees with MUMPS.

# +
ratios = [s.linear_residual / s.linear_rtol for step in steps for s in step.history]
furthest = np.linalg.norm(u.x.array.reshape(-1, 3), axis=1).max()
summary = {
    "mesh": str(source),
    "pressure_mmhg": steps[-1].load,
    "c_kpa": {name: tissue.c for name, tissue in tissues},
    "processes": comm.size,
    "subdomains": subdomains,
    "dofs": dofs,
    "load_steps": [step.load for step in steps],
    "newton_iterations": len(spent),
    "tangents": tangents,
    "linear_iterations": sum(s.linear_iterations for s in spent),
    "max_linear_ratio": max(ratios),
    "newton_residual": unbalanced / load_alone,
    "max_displacement_mm": comm.allreduce(furthest, op=MPI.MAX),
    "difference_to_mumps": feti["difference_to_direct"],
    "last_step": {"feti": feti, "mumps": mumps},
    "seconds_linear_feti": seconds,
    "seconds_linear_mumps": direct,
    "seconds": time.perf_counter() - started,
}
on_first(lambda: (folder / "summary.json").write_text(json.dumps(summary, indent=1) + "\n"), comm)
say(f"\n{summary['seconds']:.0f} s; the results are in {folder}/")

assert summary["max_linear_ratio"] <= 1.0
assert summary["difference_to_mumps"] <= 1e-6
