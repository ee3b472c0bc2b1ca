# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: light
# ---

# # Materials of your own
#
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
#
# A material is an energy in UFL, and nothing else. Two are written out here, checked in the
# package's workshop before they meet a mesh, and inflated in the same tube: fibres with a dispersed
# direction (Gasser, Ogden, Holzapfel, *J. R. Soc. Interface* 3, 2006; the package has it as
# `materials.gasser_ogden_holzapfel`), and rubber with a plaque that is a hundred times stiffer.
#
#     python3 demos/demo_own_material.py
#     mpirun -n 2 python3 demos/demo_own_material.py --size 0.2 --output output/materials
#
# Units: mm, kPa, and hence mN; loads are in mmHg.

# +
import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path

from mpi4py import MPI

import numpy as np
from common import pictures
from common.render import gather_cells

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, compare, kinematics, loads
from dolfinx_feti.loading import Steps, follow_load
from dolfinx_feti.output import cell_values, writable_folder
from dolfinx_feti.runtime.collective import on_first
from dolfinx_feti.wall import facets, openings, surface_measure
from dolfinx_feti.wall.fibres import fibre_families, fibre_frame
from dolfinx_feti.workshop import check, compile_material
from meshes.arguments import positive
from meshes.walls import open_wall

Expr = ufl.core.expr.Expr

parser = argparse.ArgumentParser(description="Inflate a tube of two materials of one's own.")
parser.add_argument("--size", type=positive, default=0.3, help="length of the elements' edges [mm]")
parser.add_argument("--pressure", type=positive, default=30.0, help="[mmHg], 30")
parser.add_argument("--output", type=Path, default=Path("output/materials"), metavar="FOLDER")
args = parser.parse_args()

comm = MPI.COMM_WORLD
folder = writable_folder(args.output, comm)
wall, _ = open_wall("tube", comm, size=args.size, folder=folder)
mesh = wall.mesh
lumen = surface_measure(wall)(wall.surfaces["lumen"])
rims = np.concatenate([facets(wall, name) for name in openings(wall)])
# -

# ## Fibres with a dispersed direction
#
# A share $ϰ ∈ [0, 1/3]$ of each family points anywhere: $ϰ = 0$ is the model of
# `materials.holzapfel_gasser_ogden`, $ϰ = 1/3$ is isotropic. With
# $E_i = ϰ(\bar I_1 - 3) + (1 - 3ϰ)(\bar I_i - 1)$,
#
# $$ \bar\Psi = \frac c2(\bar I_1 - 3)
#    + \frac{k_1}{2k_2}\sum_{i=4,6}\left(e^{k_2\langle E_i\rangle^2} - 1\right). $$

# +
dispersion = 0.226


def dispersed_fibres(C: Expr, J: Expr, a1: Expr, a2: Expr) -> Expr:
    """Return the energy of Gasser, Ogden and Holzapfel [kPa]."""
    c, k1, k2 = 3.0, 2.3632, 0.8393
    I1 = kinematics.isochoric_invariant_1(C, J)
    psi = c / 2 * (I1 - 3)
    for a in (a1, a2):
        I4 = kinematics.isochoric_invariant_4(C, a, J)
        E = dispersion * (I1 - 3) + (1 - 3 * dispersion) * (I4 - 1)
        stretched = k1 / (2 * k2) * (ufl.exp(k2 * E**2) - 1)
        psi += ufl.conditional(ufl.gt(E, 0.0), stretched, 0.0)
    return psi


# -

# ## Rubber with a plaque
#
# Yeoh's polynomial in $\bar I_1 - 3$, and a factor that is 100 in a patch of the wall. Stiffness
# scaling copes with that.


# +
def yeoh(C: Expr, J: Expr) -> Expr:
    """Return the energy of rubber [kPa]."""
    y = kinematics.isochoric_invariant_1(C, J) - 3
    return 4.0 * y + 1.0 * y**2 + 0.2 * y**3


stiffness = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)), name="stiffness")
stiffness.interpolate(lambda x: np.where((x[0] > 0.3) & (np.abs(x[2] - 1.5) < 0.6), 100.0, 1.0))


def plaque(C: Expr, J: Expr) -> Expr:
    """Return Yeoh's energy [kPa], a hundredfold in the plaque."""
    return stiffness * yeoh(C, J)


# -

# ## Checked before they meet a mesh
#
# A wrong sign, a stress at rest, a tangent that is not the stress's derivative, a state where the
# energy is not a number: each would show up as a Newton iteration that does not converge. The
# workshop finds them in seconds, at one point, with fibres in two fixed directions. The one warning
# is due: fibres that do not push make the tangent jump at rest.

# +
one, other = (ufl.as_vector([np.cos(a), np.sin(a), 0.0]) for a in np.radians([29.0, -29.0]))
for psi in (partial(dispersed_fibres, a1=one, a2=other), yeoh):
    report = check(compile_material(psi), stretches=(0.7, 1.5))
    if comm.rank == 0:
        print(report, end="\n\n", flush=True)
    assert report.ok
# -

# ## Inflation
#
# What is left is the same for every material: the volume constraint with a pressure p that is
# condensed cell by cell, and the potential of the pressure in the lumen. One energy
# $Π(u, p)$ is all that the problem is given. Newton's method makes sure to go downhill in it.

# +
KAPPA, INCREMENT = 1000.0, 5.0


def inflate(name: str, material: Callable[[Expr, Expr], Expr]) -> dict[str, float]:
    """Inflate the tube; draw it; compare FETI with MUMPS in the last load step."""
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (3,)))
    u = dolfinx.fem.Function(V, name="displacement")
    p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)), name="p")
    load = dolfinx.fem.Constant(mesh, 0.0)
    F = kinematics.deformation_gradient(u)
    C, J = kinematics.right_cauchy_green(F), kinematics.jacobian(F)
    psi = material(C, J) + p * (J - 1) - p**2 / (2 * KAPPA)
    dofs = dolfinx.fem.locate_dofs_topological(V, 2, rims)
    problem = NonlinearProblem(
        psi * ufl.dx + loads.pressure_potential(load, u, lumen),
        u,
        bcs=[dolfinx.fem.dirichletbc(np.zeros(3), dofs, V)],
        condense=p,
        subdomains=12,
        petsc_options_prefix=f"{name}_",
        quadrature_degree=4,
    )

    def follow(start: float, end: float) -> list:
        def set_load(mmhg: float) -> None:
            load.value = loads.mmhg(mmhg)

        step = Steps(first=INCREMENT, least=0.1, growth=1.5, quick=5)
        return follow_load(problem, set_load, [end], step, state=[u, p], start=start, unit="mmHg")

    before = max(args.pressure - INCREMENT, args.pressure / 2)
    steps = follow(0.0, before)
    steps += follow(before, args.pressure)
    load.value = loads.mmhg(args.pressure + 1.0)
    feti, _ = compare(problem, ["feti", "mumps"]).solved

    sigma = kinematics.stress_magnitude(kinematics.cauchy_stress(psi, F))
    parts = problem.decomposition
    values = {"stress": cell_values(sigma, mesh), "subdomain": parts.first + parts.subdomain}
    cells = gather_cells(u, values)
    picture = folder / f"{name}.png"
    on_first(lambda: pictures.draw_wall(picture, cells, pressure=args.pressure), comm)
    newton = [s for step in steps for s in step.history]
    furthest = np.linalg.norm(u.x.array.reshape(-1, 3), axis=1).max()
    return {
        "load_steps": len(steps),
        "newton_steps": len(newton),
        "feti_iterations": sum(s.linear_iterations for s in newton),
        "max_linear_ratio": max(s.linear_residual / s.linear_rtol for s in newton),
        "difference_to_mumps": feti.difference_to_direct,
        "max_displacement_mm": comm.allreduce(furthest, op=MPI.MAX),
    }


a1, a2 = fibre_families(wall, fibre_frame(wall))
fibres = partial(dispersed_fibres, a1=a1, a2=a2)
results = {"fibres": inflate("fibres", fibres), "plaque": inflate("plaque", plaque)}
# -

# ## What it cost
#
# Every linear system was solved to its tolerance, and the first step towards 1 mmHg more is that of
# MUMPS.

# +
if comm.rank == 0:
    print(f"{'':<22}" + "".join(f"{name:>12}" for name in results))
    for figure in results["fibres"]:
        row = "".join(f"{result[figure]:>12.4g}" for result in results.values())
        print(f"{figure.replace('_', ' '):<22}{row}", flush=True)
for result in results.values():
    assert result["max_linear_ratio"] <= 1.0
    assert result["difference_to_mumps"] <= 1e-6
assert results["plaque"]["max_displacement_mm"] > 0.1
