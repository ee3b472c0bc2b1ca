# # Classical and all-floating FETI on a cube
#
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
#
# A cube is torn into 4 × 4 × 4 subcubes and glued together again, by both variants of the method
# and with three preconditioners: the linear study of Augustin, Holzapfel, Steinbach (IJNME 99,
# 2014) with an eighth of its subdomains; `benchmarks/cube.py` is the whole of it.
#
#     python3 demos/demo_classical_vs_all_floating.py
#     mpirun -n 2 python3 demos/demo_classical_vs_all_floating.py FOLDER
#
# The picture goes to `FOLDER`, `output/cube` if none is named.

# +
import itertools
import sys
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np

import dolfinx
import ufl

from dolfinx_feti import LinearProblem
from dolfinx_feti.output import writable_folder
from meshes.cube import create_cube

comm = MPI.COMM_WORLD
folder = writable_folder(Path(sys.argv[1] if len(sys.argv) > 1 else "output/cube"), comm)
say = print if comm.rank == 0 else (lambda *_: None)
# -

# ## A problem with a known solution
#
# Kelvin's fundamental solution, the displacement of the whole space under a unit force at a point
# outside, is smooth in the cube. Its values on the surface are prescribed; every subcube has $n^3$
# cells of 24 tetrahedra.

# +
SUBCUBES, SOURCE = 4, (2.0, 2.0, 2.0)
E, nu = 210.0, 0.45
mu, lmbda = E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))


def kelvin(x: np.ndarray) -> np.ndarray:
    """Return the fundamental solution at points, (3, points)."""
    d = x - np.array(SOURCE)[:, None]
    r = np.linalg.norm(d, axis=0)
    force = np.array([[1.0], [0.0], [0.0]])
    scale = (1 + nu) / (8 * np.pi * E * (1 - nu))
    return scale * ((3 - 4 * nu) * force / r + d[0] * d / r**3)


def problem(n: int) -> tuple:
    """Return forms, boundary condition, and the subcube of each cell."""
    mesh, subcube = create_cube(comm, SUBCUBES, n)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    sigma = 2 * mu * ufl.sym(ufl.grad(u)) + lmbda * ufl.div(u) * ufl.Identity(3)
    a = ufl.inner(sigma, ufl.sym(ufl.grad(v))) * ufl.dx
    L = ufl.inner(dolfinx.fem.Constant(mesh, (0.0, 0.0, 0.0)), v) * ufl.dx
    prescribed = dolfinx.fem.Function(V)
    prescribed.interpolate(kelvin)
    mesh.topology.create_connectivity(2, 3)
    surface = dolfinx.mesh.exterior_facet_indices(mesh.topology)
    dofs = dolfinx.fem.locate_dofs_topological(V, 2, surface)
    return a, L, dolfinx.fem.dirichletbc(prescribed, dofs), subcube


# -

# ## Two ways to hold the surface
#
# *Classical* FETI fixes the prescribed values in the local matrices: only the subcubes inside, 8 of
# 64, then float. *All-floating* FETI imposes the values by multipliers like the continuity across
# the interface: all subcubes float, at the price of more multipliers and a larger coarse problem.
# Scaling, projection and tolerance are the paper's.

# +
TYPES, PRECONDITIONERS = ("all_floating", "classical"), ("identity", "lumped", "dirichlet")
CHOICES = {
    "feti_scaling": "multiplicity",
    "feti_coarse_q": "identity",
    "feti_coarse_modes": 0,
    "feti_dual_ksp_rtol": 1e-8,
}
sizes = (1, 2, 3)
solvers, solutions = {}, {}
for n in sizes:
    a, L, bc, subcube = problem(n)
    for kind, pc_type in itertools.product(TYPES, PRECONDITIONERS):
        options = CHOICES | {"feti_type": kind, "feti_pc_type": pc_type}
        linear = LinearProblem(a, L, bcs=[bc], subdomains=subcube, petsc_options=options)
        u = linear.solve()
        feti = linear.solver.getPythonContext()
        solvers[kind, pc_type, n] = (feti.iterations, *feti.eigenvalues, feti.report())
        solutions[kind, pc_type, n] = u
# -

# ## What it costs
#
# Iterations follow the condition number of the preconditioned dual operator, which CG reveals.

# +
for kind in TYPES:
    report = solvers[kind, "dirichlet", 1][-1]
    say(f"\n{kind}: {report.multipliers} multipliers, {report.kernels[-1]} subdomains float")
    say(f"{'n':>4}" + "".join(f"{pc_type:>20}" for pc_type in PRECONDITIONERS))
    for n in sizes:
        cells = [solvers[kind, pc_type, n] for pc_type in PRECONDITIONERS]
        say(f"{n:>4}" + "".join(f"{its:>9} it. {high / low:>6.1f}" for its, low, high, _ in cells))
condition = {key: high / low for key, (_, low, high, _) in solvers.items()}
# -

# With the Dirichlet preconditioner the condition number grows slowest, theory says no faster than
# $(1 + \log H/h)^2$, and with all subdomains floating it is better throughout.

# +
COLOURS = {"identity": "#b5443a", "lumped": "#c9962b", "dirichlet": "#1f5a8a"}
if comm.rank == 0:
    fig, ax = plt.subplots(figsize=(8, 5), layout="constrained")
    for (kind, line), pc_type in itertools.product(zip(TYPES, "-:", strict=True), PRECONDITIONERS):
        numbers = [condition[kind, pc_type, n] for n in sizes]
        label = f"{pc_type}, {kind.replace('_', '-')}"
        ax.semilogy(sizes, numbers, line, c=COLOURS[pc_type], marker="o", label=label)
    ax.set(xlabel="cells along a subcube, H/h", ylabel="condition number κ", xticks=sizes)
    ax.grid(axis="y", which="both", color="0.92")
    fig.legend(loc="outside right", frameon=False)
    fig.savefig(folder / "cube.png", dpi=120)
# -

# ## What has to hold
#
# All six solvers find one solution for each n.

# +
for (kind, pc_type, n), u in solutions.items():
    reference = solutions["classical", "dirichlet", n].x.array
    squares = [np.sum((u.x.array - reference) ** 2), np.sum(reference**2)]
    squares = comm.allreduce(np.array(squares))
    assert squares[0] <= 1e-12 * squares[1], (kind, pc_type, n)
for n, pc_type in itertools.product(sizes, PRECONDITIONERS):
    assert condition["all_floating", pc_type, n] < condition["classical", pc_type, n]
for n, kind in itertools.product(sizes, TYPES):
    assert solvers[kind, "dirichlet", n][1] > 1.0 - 1e-6  # theory: no eigenvalue below one
