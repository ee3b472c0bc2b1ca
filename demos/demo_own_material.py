# # Materials of your own
#
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
#
# A material is an energy in UFL, and nothing else. Two are written out here, checked in the
# package's workshop before they meet a mesh, and inflated in the same tube: fibres with a dispersed
# direction (Gasser, Ogden, Holzapfel 2006), and rubber with a plaque, a hundred times stiffer.
#
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
from common.drawing import draw_wall, gather_cells

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, compare, kinematics, loads, materials
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
# -

# ## Fibres with a dispersed direction
#
# A share $ϰ ∈ [0, 1/3]$ of each family points anywhere. With
# $E_i = ϰ(\bar I_1 - 3) + (1 - 3ϰ)(\bar I_i - 1)$,
#
# $$ \bar\Psi = \frac c2(\bar I_1 - 3)
#    + \frac{k_1}{2k_2}\sum_{i=4,6}\left(e^{k_2\langle E_i\rangle^2} - 1\right). $$


# +
def dispersed_fibres(C: Expr, J: Expr, a1: Expr, a2: Expr) -> Expr:
    """Return the energy of Gasser, Ogden and Holzapfel [kPa]."""
    c, k1, k2, dispersion = 3.0, 2.3632, 0.8393, 0.226
    I1 = kinematics.isochoric_invariant_1(C, J)
    psi = c / 2 * (I1 - 3)
    for a in (a1, a2):
        I4 = kinematics.isochoric_invariant_4(C, a, J)
        E = dispersion * (I1 - 3) + (1 - 3 * dispersion) * (I4 - 1)
        stretched = k1 / (2 * k2) * (ufl.exp(k2 * E**2) - 1)
        psi += ufl.conditional(ufl.gt(E, 0.0), stretched, 0.0)
    return psi


# -

# ## Rubber, of Yeoh, with a plaque


# +
def yeoh(C: Expr, J: Expr) -> Expr:
    """Return the energy of rubber [kPa]."""
    y = kinematics.isochoric_invariant_1(C, J) - 3
    return 4.0 * y + 1.0 * y**2 + 0.2 * y**3


stiffness = dolfinx.fem.Function(dolfinx.fem.functionspace(wall.mesh, ("DG", 0)))
stiffness.interpolate(lambda x: np.where((x[0] > 0.3) & (np.abs(x[2] - 1.5) < 0.6), 100.0, 1.0))
# -

# ## Checked before they meet a mesh
#
# The workshop tries an energy in seconds, at one point. One warning is due: fibres that do not push
# make the tangent jump.

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
# At the end MUMPS takes a step, too.


# +
def inflate(name: str, material: Callable[[Expr, Expr], Expr]) -> dict[str, float]:
    """Inflate the tube; draw it; compare FETI with MUMPS in the last load step."""
    V = dolfinx.fem.functionspace(wall.mesh, ("Lagrange", 2, (3,)))
    u = dolfinx.fem.Function(V, name="displacement")
    p = dolfinx.fem.Function(dolfinx.fem.functionspace(wall.mesh, ("DG", 0)), name="p")
    load = dolfinx.fem.Constant(wall.mesh, 0.0)
    F = kinematics.deformation_gradient(u)
    C, J = kinematics.right_cauchy_green(F), kinematics.jacobian(F)
    psi = material(C, J) + materials.perturbed_lagrangian(J, p, kappa=1000.0)
    lumen = surface_measure(wall)(wall.surfaces["lumen"])
    energy = psi * ufl.dx + loads.pressure_potential(load, u, lumen)
    rims = np.concatenate([facets(wall, name) for name in openings(wall)])
    dofs = dolfinx.fem.locate_dofs_topological(V, 2, rims)
    bcs = [dolfinx.fem.dirichletbc(np.zeros(3), dofs, V)]
    options = {"subdomains": 12, "petsc_options_prefix": f"{name}_", "quadrature_degree": 4}
    problem = NonlinearProblem(energy, u, bcs=bcs, condense=p, **options)

    def set_load(mmhg: float) -> None:
        load.value = loads.mmhg(mmhg)

    path = Steps(first=5.0, least=0.1, growth=1.5, quick=5)
    steps = follow_load(problem, set_load, [args.pressure], path, state=[u, p], unit="mmHg")
    set_load(args.pressure + 1.0)
    feti, _ = compare(problem, ["feti", "mumps"]).results
    sigma = kinematics.stress_magnitude(kinematics.cauchy_stress(psi, F))
    parts = problem.decomposition.first + problem.decomposition.subdomain
    cells = gather_cells(u, {"stress": cell_values(sigma, wall.mesh), "subdomain": parts})
    on_first(lambda: draw_wall(folder / f"{name}.png", cells, pressure=args.pressure), comm)
    furthest = comm.allreduce(np.linalg.norm(u.x.array.reshape(-1, 3), axis=1).max(), op=MPI.MAX)
    found = {"load_steps": len(steps), "difference_to_mumps": feti.difference_to_direct}
    return found | {"max_displacement_mm": furthest}


a1, a2 = fibre_families(wall, fibre_frame(wall))
fibres = partial(dispersed_fibres, a1=a1, a2=a2)
results = {"fibres": inflate("fibres", fibres)}
results["plaque"] = inflate("plaque", lambda C, J: stiffness * yeoh(C, J))
for name, result in results.items():
    if comm.rank == 0:
        print(name, ", ".join(f"{key} {value:.4g}" for key, value in result.items()), flush=True)
    assert result["difference_to_mumps"] <= 1e-6
assert results["plaque"]["max_displacement_mm"] > 0.1
