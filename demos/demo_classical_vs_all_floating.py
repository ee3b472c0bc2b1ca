# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: light
# ---

# # Classical and all-floating FETI on a cube
#
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
#
# A cube is torn into 4 × 4 × 4 subcubes and glued together again, by both variants of the method
# and with three preconditioners. It is the linear study of Augustin, Holzapfel, Steinbach (IJNME
# 99, 2014) with an eighth of its subdomains; `benchmarks/cube.py` is the whole of it.
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
from common.render import gather_cells, paint, shrunk, skin, surface
from matplotlib.colors import to_rgba_array

import dolfinx
import ufl

from dolfinx_feti import LinearProblem
from dolfinx_feti.output import writable_folder
from dolfinx_feti.runtime.collective import on_first
from meshes.cube import create_cube

comm = MPI.COMM_WORLD
folder = writable_folder(Path(sys.argv[1] if len(sys.argv) > 1 else "output/cube"), comm)


def say(text: str) -> None:
    """Print on the first process."""
    if comm.rank == 0:
        print(text, flush=True)


# -

# ## A problem with a known solution
#
# The displacement of the whole space under a unit force at a point $x^*$ outside of the cube,
# Kelvin's fundamental solution
#
# $$
# u = \frac{1}{8π} \frac{1}{E} \frac{1 + ν}{1 - ν} \left[ (3 - 4ν) \frac{e_1}{|d|} +
#   \frac{d_1 d}{|d|^3} \right], \qquad d = x - x^*,
# $$
#
# is smooth in the cube and satisfies $\operatorname{div} σ(u) = 0$. Its values on the surface are
# prescribed; every subcube has $n^3$ cells of 24 tetrahedra.

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


def l2_error(u: dolfinx.fem.Function) -> float:
    """Return ‖u − u_h‖ in L₂, with the cubic interpolant of the fundamental solution as u."""
    exact = dolfinx.fem.Function(
        dolfinx.fem.functionspace(u.function_space.mesh, ("Lagrange", 3, (3,)))
    )
    exact.interpolate(kelvin)
    square = dolfinx.fem.form(ufl.inner(exact - u, exact - u) * ufl.dx)
    return float(np.sqrt(comm.allreduce(dolfinx.fem.assemble_scalar(square))))


# -

# ## Two ways to hold the surface
#
# *Classical* FETI fixes the prescribed values in the local matrices. Only the subcubes inside, 8 of
# 64, then float, with six rigid body motions each. *All-floating* FETI leaves every local matrix
# alone and imposes the values by multipliers like the continuity across the interface: all subcubes
# float and are equal, at the price of more multipliers and a larger coarse problem.
#
# The paper's choices are made below: weights of the jumps by multiplicity, projection with Q = I,
# the rigid body motions alone in the coarse space, and a reduction of the dual residual by 1e-8.

# +
TYPES, PRECONDITIONERS = ("all_floating", "classical"), ("identity", "lumped", "dirichlet")
CHOICES = {
    "feti_scaling": "multiplicity",
    "feti_coarse_q": "identity",
    "feti_coarse_modes": 0,
    "feti_dual_ksp_rtol": 1e-8,
}
sizes = (1, 2, 3)
solvers, errors, solutions = {}, {}, {}
for n in sizes:
    a, L, bc, subcube = problem(n)
    for kind, pc_type in itertools.product(TYPES, PRECONDITIONERS):
        options = CHOICES | {"feti_type": kind, "feti_pc_type": pc_type}
        linear = LinearProblem(
            a, L, bcs=[bc], subdomains=subcube, petsc_options_prefix="cube_", petsc_options=options
        )
        u = linear.solve()
        feti = linear.solver.getPythonContext()
        solvers[kind, pc_type, n] = (feti.iterations, *feti.eigenvalues, feti.report())
        solutions[kind, pc_type, n] = u
    errors[n] = l2_error(u)
# -

# ## What it costs
#
# The number of iterations follows the condition number of the preconditioned dual operator, which
# CG itself reveals: its coefficients are those of Lanczos' method.

# +
for kind in TYPES:
    report = solvers[kind, "dirichlet", 1][-1]
    say(
        f"\n{kind}: {report.multipliers} multipliers at n = 1, {report.coarse_size} coarse "
        f"unknowns, {report.kernels[-1]} of {report.subdomains} subdomains float"
    )
    say(f"{'n':>4}" + "".join(f"{pc_type:>20}" for pc_type in PRECONDITIONERS))
    for n in sizes:
        cells = [solvers[kind, pc_type, n] for pc_type in PRECONDITIONERS]
        say(f"{n:>4}" + "".join(f"{its:>9} it. {high / low:>6.1f}" for its, low, high, _ in cells))
condition = {key: high / low for key, (_, low, high, _) in solvers.items()}
# -

# With the Dirichlet preconditioner the condition number grows slowest, theory says no faster than
# $(1 + \log H/h)^2$, and with all subdomains floating it is better throughout. In the picture a
# corner of the torn cube is taken away, and what floats in the classical variant is coloured.

# +
inside = np.all(np.isin(np.unravel_index(subcube, (SUBCUBES,) * 3), (1, 2)), axis=0)
cells = gather_cells(u, {"subcube": subcube, "floating": inside.astype(int)})
FRONT = np.array([0.8, -1.0, 0.75]) / np.linalg.norm([0.8, -1.0, 0.75])  # towards the viewer
RIGHT = np.array([1.0, 0.8, 0.0]) / np.linalg.norm([1.0, 0.8])
GREY_AND_GOLD = to_rgba_array(["#c9ced6", "#c9962b"])
COLOURS = {"identity": "#b5443a", "lumped": "#c9962b", "dirichlet": "#1f5a8a"}


def draw() -> None:
    """Draw the torn cube without the subcubes of the nearest corner, and the condition numbers."""
    fig, (left, right) = plt.subplots(1, 2, figsize=(11, 5), width_ratios=(1, 1.1))
    part, view = cells.values["subcube"], np.array([RIGHT, np.cross(FRONT, RIGHT), FRONT])
    x, centre = shrunk(cells.X, part, 0.88), shrunk(cells.X, part, 0.0)[:, 0]
    cell, corner = skin(cells, part)
    kept = np.any((centre[cell[:, 0]] - 0.5) * (1, -1, 1) < 0, axis=1)
    cell, corner = cell[kept], corner[kept]
    floating = cells.values["floating"][cell[:, 0]]
    paint(left, surface(view, x[cell, corner], GREY_AND_GOLD[floating]))
    left.set_title("floating in classical FETI: 8 of 64")
    for (kind, line), pc_type in itertools.product(zip(TYPES, "-:", strict=True), PRECONDITIONERS):
        numbers = [condition[kind, pc_type, n] for n in sizes]
        label = f"{pc_type}, {kind.replace('_', '-')}"
        right.semilogy(sizes, numbers, line, c=COLOURS[pc_type], marker="o", ms=4, label=label)
    right.set_xticks(sizes)
    right.set_xlabel("cells along the edge of a subcube, H/h")
    right.set_ylabel("condition number κ")
    right.grid(axis="y", which="both", color="0.92")
    right.spines[["top", "right"]].set_visible(False)
    right.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2, frameon=False)
    fig.savefig(folder / "cube.png", dpi=150, bbox_inches="tight")


on_first(draw, comm)
# -

# ## What has to hold
#
# All six solvers find one solution for each n, of second order in 1/n, and the numbers of the
# paper's method do not depend on how many processes there are.

# +
for (kind, pc_type, n), u in solutions.items():
    reference = solutions["classical", "dirichlet", n].x.array
    squares = np.array([np.sum((u.x.array - reference) ** 2), np.sum(reference**2)])
    squares = comm.allreduce(squares)
    assert squares[0] <= 1e-12 * squares[1], (kind, pc_type, n)
order = np.log(errors[1] / errors[3]) / np.log(3.0)
say(f"\nL2 errors {', '.join(f'{error:.2e}' for error in errors.values())}, order {order:.2f}")
assert order > 1.9

for n, pc_type in itertools.product(sizes, PRECONDITIONERS):
    assert condition["all_floating", pc_type, n] < condition["classical", pc_type, n]
for n, kind in itertools.product(sizes, TYPES):
    identity, lumped, dirichlet = (condition[kind, pc_type, n] for pc_type in PRECONDITIONERS)
    assert dirichlet < lumped < identity
    assert solvers[kind, "dirichlet", n][1] > 1.0 - 1e-6  # theory: no eigenvalue below one
assert solvers["all_floating", "dirichlet", 1][-1].kernels == (0, 0, 0, 0, 0, 0, 64)
assert solvers["classical", "dirichlet", 1][-1].kernels == (56, 0, 0, 0, 0, 0, 8)
