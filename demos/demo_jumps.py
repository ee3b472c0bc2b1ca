# # Stiffness that jumps: why the scaling matters
#
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
#
# A checkerboard of a soft material and one that is up to a million times as stiff. The effect of
# such a jump on the iterations depends on two choices: the weights that distribute a gap in the
# displacement between the two sides (*scaling*), and the weight Q of the projection.
#
#     python3 demos/demo_jumps.py

# +
from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np

import dolfinx
import ufl

from dolfinx_feti import LinearProblem
from dolfinx_feti.output import pictures

comm = MPI.COMM_WORLD
n_squares = 4  # along an edge of the board
n_cells = 6  # along an edge of a square
# -

# ## The board
#
# Plane strain on the unit square, held at its left side and pulled down. Young's modulus is one on
# the white squares and E on the black ones. The subdomains follow the squares: `subdomains` may be
# an array with a number for each cell that a process owns.

# +
mesh = dolfinx.mesh.create_unit_square(comm, n_squares * n_cells, n_squares * n_cells)
owned = mesh.topology.index_map(2).size_local
middle = mesh.geometry.x[mesh.geometry.dofmap[:owned]].mean(axis=1)
column, row = np.floor(n_squares * middle[:, :2]).astype(np.int32).T
square = row * n_squares + column

stiffness = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)))


def set_stiffness(jump):
    """Set Young's modulus of the black squares."""

    def modulus(x):
        black = (np.floor(n_squares * x[0]) + np.floor(n_squares * x[1])) % 2 == 1
        return np.where(black, jump, 1.0)

    stiffness.interpolate(modulus)


V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (2,)))
u = ufl.TrialFunction(V)
v = ufl.TestFunction(V)
nu = 0.3
mu = stiffness / (2 * (1 + nu))
lmbda = stiffness * nu / ((1 + nu) * (1 - 2 * nu))
sigma = 2 * mu * ufl.sym(ufl.grad(u)) + lmbda * ufl.div(u) * ufl.Identity(2)
a = ufl.inner(sigma, ufl.sym(ufl.grad(v))) * ufl.dx
L = ufl.inner(dolfinx.fem.Constant(mesh, (0.0, -1.0)), v) * ufl.dx


def at_left(x):
    return np.isclose(x[0], 0.0)


left = dolfinx.mesh.locate_entities_boundary(mesh, 1, at_left)
bc = dolfinx.fem.dirichletbc(np.zeros(2), dolfinx.fem.locate_dofs_topological(V, 1, left), V)
# -

# ## Four choices
#
# *Multiplicity* scaling averages the two sides; it moves the stiff side by half of the gap, at a
# cost in energy that grows with the jump. *Stiffness* scaling moves the soft side. The projection
# measures the jumps of the rigid body modes by Q: with the identity, a jump between two stiff
# squares counts as much as one between soft ones; with the preconditioner it counts by its energy.
#
# Both choices belong to the dual form. Soft modes are omitted from its coarse space, to isolate
# their effect. The table counts the iterations until the *residual of the assembled system* has
# decreased by a factor of 1e-8.

# +
choices = [
    ("stiffness", "preconditioner"),
    ("stiffness", "identity"),
    ("multiplicity", "preconditioner"),
    ("multiplicity", "identity"),
]
jumps = [1.0, 1e1, 1e2, 1e3, 1e4]
condition = {choice: [] for choice in choices}
iterations = {choice: [] for choice in choices}
for scaling, q in choices:
    options = {
        "feti_formulation": "dual",
        "feti_coarse_modes": 0,
        "feti_scaling": scaling,
        "feti_coarse_q": q,
    }
    problem = LinearProblem(a, L, bcs=[bc], subdomains=square, petsc_options=options)
    for jump in jumps:
        set_stiffness(jump)
        problem.solve()
        feti = problem.solver.getPythonContext()
        condition[scaling, q].append(feti.condition_number)
        iterations[scaling, q].append(feti.iterations)

if comm.rank == 0:
    print("iterations for E =", ", ".join(f"{jump:.0e}" for jump in jumps))
    for scaling, q in choices:
        print(f"scaling {scaling}, Q = {q}: {iterations[scaling, q]}")
# -

# Only both together, the defaults, are insensitive to the jump. Theory says the same: the bound of
# the condition number is free of the coefficients if the weights and Q follow them.

# +
if comm.rank == 0:
    fig, ax = plt.subplots(figsize=(6, 4), layout="constrained")
    for (scaling, q), line in zip(choices, ("-", "--", "-.", ":"), strict=True):
        ax.loglog(jumps, condition[scaling, q], line, marker="o", label=f"{scaling}, Q = {q}")
    ax.set_xlabel("jump E")
    ax.set_ylabel("condition number")
    ax.legend()
    fig.savefig("jumps_condition.png", dpi=150)

both = condition["stiffness", "preconditioner"]
neither = condition["multiplicity", "identity"]
assert max(both) < 3 * both[0]
assert neither[-1] > 100 * neither[0]
# -

# ## The board
#
# The displacement with the largest jump: the stiff squares move as a chain of rigid bodies.

uh = problem.u
pictures.draw(
    "jumps.png",
    pictures.field(stiffness, "Young's modulus E", is_continuous=False, title="the board"),
    pictures.field(uh, "displacement |u|", title="solution"),
)
