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
#     mpirun -n 2 python3 demos/demo_classical_vs_all_floating.py

# +
import itertools

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np

import dolfinx
import ufl

from dolfinx_feti import LinearProblem
from dolfinx_feti.meshes.cube import create_cube
from dolfinx_feti.output import pictures

comm = MPI.COMM_WORLD
# -

# ## A problem with a known solution
#
# Kelvin's fundamental solution, the displacement of the whole space under a unit force at a point
# outside, is smooth in the cube. Its values on the surface are prescribed; every subcube has $n^3$
# cells of 24 tetrahedra.

# +
n_subcubes = 4  # along an edge of the cube
source = (2.0, 2.0, 2.0)
E = 210.0
nu = 0.45
mu = E / (2 * (1 + nu))
lmbda = E * nu / ((1 + nu) * (1 - 2 * nu))


def kelvin(x):
    """Return the fundamental solution at points, (3, points)."""
    d = x - np.array(source)[:, None]
    r = np.linalg.norm(d, axis=0)
    force = np.array([[1.0], [0.0], [0.0]])
    scale = (1 + nu) / (8 * np.pi * E * (1 - nu))
    return scale * ((3 - 4 * nu) * force / r + d[0] * d / r**3)


def cube_problem(n):
    """Return forms, boundary condition, and the subcube of each cell."""
    mesh, subcube = create_cube(comm, n_subcubes, n)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
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
# Formulation, scaling, projection and tolerance are the paper's.

# +
types = ("all_floating", "classical")
preconditioners = ("identity", "lumped", "dirichlet")
choices = {
    "feti_formulation": "dual",
    "feti_scaling": "multiplicity",
    "feti_coarse_q": "identity",
    "feti_coarse_modes": 0,
    "feti_dual_ksp_rtol": 1e-8,
}
sizes = (1, 2, 3)
iterations = {}
condition = {}
solutions = {}
for n in sizes:
    a, L, bc, subcube = cube_problem(n)
    for kind, pc_type in itertools.product(types, preconditioners):
        options = choices | {"feti_type": kind, "feti_pc_type": pc_type}
        problem = LinearProblem(a, L, bcs=[bc], subdomains=subcube, petsc_options=options)
        solutions[kind, pc_type, n] = problem.solve()
        feti = problem.solver.getPythonContext()
        iterations[kind, pc_type, n] = feti.iterations
        smallest, largest = feti.eigenvalues
        condition[kind, pc_type, n] = largest / smallest
        assert pc_type != "dirichlet" or smallest > 1.0 - 1e-6  # no eigenvalue below one
# -

# ## What it costs
#
# Iterations follow the condition number of the preconditioned dual operator, which CG reveals.

# +
if comm.rank == 0:
    for kind, pc_type in itertools.product(types, preconditioners):
        counts = [iterations[kind, pc_type, n] for n in sizes]
        print(f"{kind}, {pc_type}: {counts} iterations")
# -

# With the Dirichlet preconditioner the condition number grows slowest, theory says no faster than
# $(1 + \log H/h)^2$, and with all subdomains floating it is better throughout.

# +
if comm.rank == 0:
    fig, ax = plt.subplots(figsize=(8, 4.5), layout="constrained")
    for kind, line in zip(types, ("-", ":"), strict=True):
        for pc_type, colour in zip(preconditioners, ("C0", "C1", "C2"), strict=True):
            numbers = [condition[kind, pc_type, n] for n in sizes]
            label = f"{pc_type}, {kind.replace('_', '-')}"
            ax.semilogy(sizes, numbers, line, color=colour, marker="o", label=label)
    ax.set_xlabel("cells along a subcube, H/h")
    ax.set_ylabel("condition number κ")
    ax.set_xticks(sizes)
    fig.legend(loc="outside right")
    fig.savefig("condition.png", dpi=150)
# -

# All six solvers find one solution for each n, and all-floating FETI has the lower condition
# number.

# +
for (_, _, n), u in solutions.items():
    reference = solutions["classical", "dirichlet", n].x.array
    squares = np.array([np.sum((u.x.array - reference) ** 2), np.sum(reference**2)])
    squares = comm.allreduce(squares)
    assert squares[0] <= 1e-12 * squares[1]
for n, pc_type in itertools.product(sizes, preconditioners):
    assert condition["all_floating", pc_type, n] < condition["classical", pc_type, n]
# -

# ## The cube

u = solutions["classical", "dirichlet", 3]
pictures.draw(
    "cube.png",
    pictures.subdomains(problem, apart=0.25, title="64 subcubes"),
    pictures.field(u, "displacement |u|", title="solution"),
)
