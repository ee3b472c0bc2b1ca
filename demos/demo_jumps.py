# # Stiffness that jumps: why the scaling matters
#
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
#
# A checkerboard of a soft and a stiff material, up to a million times as stiff. What such a jump
# does to the iterations depends on two choices: the weights by which a jump of the displacement is
# shared out between the two sides (*scaling*), and the weight Q of the projection.
#
#     python3 demos/demo_jumps.py

# +
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np

import dolfinx
import ufl

from dolfinx_feti import LinearProblem
from dolfinx_feti.output import writable_folder

comm = MPI.COMM_WORLD
SQUARES, CELLS = 4, 6  # along an edge: squares of the board, cells of a square
# -

# ## The board
#
# Plane strain on the unit square, held at its left side and pulled down. Young's modulus is one on
# the white squares and E on the black ones. The subdomains follow the squares: `subdomains` may be
# an array with a number for each cell that a process owns.

# +
mesh = dolfinx.mesh.create_unit_square(comm, SQUARES * CELLS, SQUARES * CELLS)
owned = mesh.topology.index_map(2).size_local
middle = mesh.geometry.x[mesh.geometry.dofmap[:owned]].mean(axis=1)
column, row = np.floor(SQUARES * middle[:, :2]).astype(np.int32).T
square = row * SQUARES + column

stiffness = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)))


def set_stiffness(jump: float) -> None:
    """Give the black squares a Young's modulus."""

    def modulus(x: np.ndarray) -> np.ndarray:
        black = (np.floor(SQUARES * x[0]) + np.floor(SQUARES * x[1])) % 2 == 1
        return np.where(black, jump, 1.0)

    stiffness.interpolate(modulus)


V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (2,)))
u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
nu = 0.3
mu, lmbda = stiffness / (2 * (1 + nu)), stiffness * nu / ((1 + nu) * (1 - 2 * nu))
sigma = 2 * mu * ufl.sym(ufl.grad(u)) + lmbda * ufl.div(u) * ufl.Identity(2)
a = ufl.inner(sigma, ufl.sym(ufl.grad(v))) * ufl.dx
L = ufl.inner(dolfinx.fem.Constant(mesh, (0.0, -1.0)), v) * ufl.dx
left = dolfinx.mesh.locate_entities_boundary(mesh, 1, lambda x: np.isclose(x[0], 0.0))
bc = dolfinx.fem.dirichletbc(np.zeros(2), dolfinx.fem.locate_dofs_topological(V, 1, left), V)
# -

# ## Four choices
#
# *Multiplicity* scaling averages the two sides; it moves the stiff side by half of the gap, at a
# cost in energy that grows with the jump. *Stiffness* scaling moves the soft side. The projection
# measures the jumps of the rigid body modes by Q: with the identity, a jump between two stiff
# squares counts as much as one between soft ones; with the preconditioner it counts by its energy.
#
# Both are choices of the dual form. The soft modes that its coarse space may take up are left out,
# so that these two stand alone. Iterations are those until the *residual of the assembled system*
# has fallen by 1e-8.

# +
CHOICES = [
    ("stiffness", "preconditioner"),
    ("stiffness", "identity"),
    ("multiplicity", "preconditioner"),
    ("multiplicity", "identity"),
]
jumps = [1.0, 1e1, 1e2, 1e3, 1e4]
condition: dict[tuple[str, str], list[float]] = {choice: [] for choice in CHOICES}
iterations: dict[tuple[str, str], list[int]] = {choice: [] for choice in CHOICES}
for scaling, q in CHOICES:
    options = {"feti_formulation": "dual", "feti_coarse_modes": 0}
    options |= {"feti_scaling": scaling, "feti_coarse_q": q}
    problem = LinearProblem(a, L, bcs=[bc], subdomains=square, petsc_options=options)
    for jump in jumps:
        set_stiffness(jump)
        problem.solve()
        feti = problem.solver.getPythonContext()
        condition[scaling, q].append(feti.condition_number)
        iterations[scaling, q].append(feti.iterations)

if comm.rank == 0:
    print(f"{'scaling':<14}{'Q':<16}" + "".join(f"{jump:>14.0e}" for jump in jumps))
    for choice in CHOICES:
        cells = zip(iterations[choice], condition[choice], strict=True)
        row_of = "".join(f"{k:>5d} ({kappa:7.2g})" for k, kappa in cells)
        print(f"{choice[0]:<14}{choice[1]:<16}{row_of}")
# -

# Only both together, the defaults, are insensitive to the jump. Theory says the same: the bound of
# the condition number is free of the coefficients if the weights and Q follow them.

# +
folder = writable_folder(Path("output/jumps"), comm)
if comm.rank == 0:
    fig, (board, ax) = plt.subplots(1, 2, figsize=(9, 3.8), width_ratios=(1, 1.7))
    black_squares = np.indices((SQUARES, SQUARES)).sum(axis=0) % 2
    board.imshow(black_squares, cmap="Greys", extent=(0, 1, 0, 1), vmax=1.4)
    board.set_title("E on the dark squares")
    for choice, line in zip(CHOICES, ("-", "--", "-.", ":"), strict=True):
        ax.loglog(jumps, condition[choice], line, marker="o", ms=4, label=", Q = ".join(choice))
    ax.set_xlabel("jump E")
    ax.set_ylabel("condition number")
    ax.grid(color="0.92")
    ax.legend(frameon=False)
    fig.savefig(folder / "jumps.png", dpi=150, bbox_inches="tight")

good, bad = condition[CHOICES[0]], condition[CHOICES[3]]
assert max(good) < 3 * good[0]
assert bad[-1] > 100 * bad[0]
