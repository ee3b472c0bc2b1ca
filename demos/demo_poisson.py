# # Poisson's equation: FETI compared with dolfinx
#
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
#
# The first problem of every course, solved twice: as in dolfinx, by a direct solver, and by FETI,
# where the import and the number of subdomains are all that changes. The meshes are refined twice,
# to see that the discrete problem is the same one.
#
#     python3 demos/demo_poisson.py
#     mpirun -n 2 python3 demos/demo_poisson.py
#
# FETI is not the fastest way to solve Poisson's equation in the plane; it is the shortest way to
# see what the method does.

# +
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.tri import Triangulation

import dolfinx
import dolfinx.fem.petsc
import ufl

import dolfinx_feti
from dolfinx_feti.output import writable_folder

comm = MPI.COMM_WORLD
# -

# ## The problem
#
# On the unit square
#
# $$ -Δu = f, \qquad u = u_D \text{ on the boundary}, $$
#
# where $f$ and $u_D$ are those of $u = \sin(πx)\cos(2πy)$. Nothing of this knows about subdomains.


# +
def exact(x: np.ndarray) -> np.ndarray:
    """Return the solution at points, (3, points)."""
    return np.sin(np.pi * x[0]) * np.cos(2 * np.pi * x[1])


def poisson(n: int) -> tuple:
    """Return the two forms and the boundary condition on n × n squares."""
    mesh = dolfinx.mesh.create_unit_square(comm, n, n)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    x, y = ufl.SpatialCoordinate(mesh)
    f = 5 * ufl.pi**2 * ufl.sin(ufl.pi * x) * ufl.cos(2 * ufl.pi * y)
    mesh.topology.create_connectivity(1, 2)
    facets = dolfinx.mesh.exterior_facet_indices(mesh.topology)
    u_D = dolfinx.fem.Function(V)
    u_D.interpolate(exact)
    bc = dolfinx.fem.dirichletbc(u_D, dolfinx.fem.locate_dofs_topological(V, 1, facets))
    return ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx, ufl.inner(f, v) * ufl.dx, bc


def l2_error(uh: dolfinx.fem.Function) -> float:
    """Return ‖u − u_h‖ in L₂."""
    x, y = ufl.SpatialCoordinate(uh.function_space.mesh)
    error = ufl.sin(ufl.pi * x) * ufl.cos(2 * ufl.pi * y) - uh
    square = dolfinx.fem.form(error**2 * ufl.dx(metadata={"quadrature_degree": 4}))
    return float(np.sqrt(comm.allreduce(dolfinx.fem.assemble_scalar(square))))


# -

# ## Two solvers
#
# dolfinx 0.9 needs no prefix for the options of its `LinearProblem`, later versions do; the class
# of this package takes one in every version, and does without. Sixteen subdomains are shared out
# among the processes. In *all-floating* FETI, the default, all of them float: the values on the
# boundary are imposed by multipliers, like the continuity between neighbours.

# +
DIRECT = {"ksp_type": "preonly", "pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}
old = dolfinx.__version__.startswith("0.9")
prefix = {} if old else {"petsc_options_prefix": "direct_"}

errors, difference = [], 0.0
for n in (16, 32, 64):
    a, L, bc = poisson(n)
    direct = dolfinx.fem.petsc.LinearProblem(a, L, bcs=[bc], petsc_options=DIRECT, **prefix)
    u_direct = direct.solve()

    problem = dolfinx_feti.LinearProblem(a, L, bcs=[bc], subdomains=16)
    uh = problem.solve()

    feti = problem.solver.getPythonContext()
    errors.append(l2_error(uh))
    largest = np.abs(uh.x.array - u_direct.x.array).max(initial=0.0)
    difference = max(difference, comm.allreduce(largest, op=MPI.MAX))
    if comm.rank == 0:
        print(
            f"{n:3d} × {n:<3d} {feti.iterations:3d} iterations, condition number "
            f"{feti.condition_number:.2f}, L2 error {errors[-1]:.2e}, difference {difference:.0e}"
        )
# -

# The condition number grows slowly, with the square of the logarithm of the cells along the edge of
# a subdomain. Halving the mesh size divides the error by four, as it should be for linear elements,
# and the two solutions are the same to the solver's tolerance of 1e-8.

order = np.log2(errors[-2] / errors[-1])
if comm.rank == 0:
    print(f"order of convergence {order:.3f}")
assert abs(order - 2.0) < 0.05
assert difference < 1e-6

# ## The solution and its subdomains
#
# `problem.decomposition` tells the subdomain of each cell that a process owns, and the number of
# its first one over all processes. Each process hands its triangles to the first, which draws them.

# +
folder = writable_folder(Path("output/poisson"), comm)
mesh, parts = uh.function_space.mesh, problem.decomposition
corners = mesh.geometry.x[mesh.geometry.dofmap[: len(parts.subdomain)]]
cells = np.repeat(np.arange(len(corners), dtype=np.int32), 3)
values = uh.eval(corners.reshape(-1, 3), cells).ravel()
gathered = comm.gather((corners.reshape(-1, 3), values, parts.first + parts.subdomain))
if comm.rank == 0:
    points, values, subdomain = (np.concatenate(part) for part in zip(*gathered, strict=True))
    triangles = Triangulation(*points[:, :2].T, np.arange(len(points)).reshape(-1, 3))
    fig, (left, right) = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
    left.tripcolor(triangles, facecolors=subdomain % 20, cmap="tab20", edgecolor="face", lw=0.2)
    left.set_title("16 subdomains")
    shown = right.tripcolor(triangles, values, shading="gouraud", cmap="viridis")
    right.set_title("solution")
    fig.colorbar(shown, ax=right, label="u", shrink=0.8)
    for ax in (left, right):
        ax.set_aspect("equal")
        ax.set_axis_off()
    fig.savefig(folder / "poisson.png", dpi=150)
