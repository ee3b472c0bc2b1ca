# # Linear elasticity: two lines change
#
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
#
# A beam, clamped at one end, bends under its weight. The script is an ordinary DOLFINx one; the
# import and the constructor of the linear problem are all that changes.
#
#     python3 demos/demo_linear_elasticity.py

# +
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

import dolfinx
import ufl

from dolfinx_feti import LinearProblem, compare
from dolfinx_feti.output import writable_folder

# -

# The displacement u solves $-\operatorname{div} σ(u) = f$ with
# $σ = 2 μ\, ε + λ \operatorname{tr}(ε)\, I$ and $ε = \operatorname{sym} \operatorname{grad} u$.
# Lengths are in mm, stresses in MPa.

# +
comm = MPI.COMM_WORLD
mesh = dolfinx.mesh.create_box(comm, [[0.0, 0.0, 0.0], [8.0, 1.0, 1.0]], [32, 4, 4])
V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (3,)))
u, v = ufl.TrialFunction(V), ufl.TestFunction(V)

E, nu = 210.0, 0.3
mu, lmbda = E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))


def sigma(w: ufl.core.expr.Expr) -> ufl.core.expr.Expr:
    """Return the stress of a displacement [MPa]."""
    return 2 * mu * ufl.sym(ufl.grad(w)) + lmbda * ufl.div(w) * ufl.Identity(3)


weight = dolfinx.fem.Constant(mesh, (0.0, 0.0, -1e-2))
a = ufl.inner(sigma(u), ufl.sym(ufl.grad(v))) * ufl.dx
L = ufl.inner(weight, v) * ufl.dx

clamped = dolfinx.mesh.locate_entities_boundary(mesh, 2, lambda x: np.isclose(x[0], 0.0))
bc = dolfinx.fem.dirichletbc(np.zeros(3), dolfinx.fem.locate_dofs_topological(V, 2, clamped), V)
# -

# The torn mesh has 16 subdomains over all processes. `feti_…` options choose the method.

problem = LinearProblem(a, L, bcs=[bc], subdomains=16, petsc_options_prefix="beam_")
uh = problem.solve()

# ## Beside a direct solver
#
# `compare` assembles the torn matrix for MUMPS, and measures both.

# +
comparison = compare(problem, ["feti", "mumps"])
difference = comparison.records[0]["difference_to_direct"]

feti = problem.solver.getPythonContext()
if comm.rank == 0:
    print(comparison)
    print(
        f"{feti.iterations} iterations, condition number {feti.condition_number:.1f}, "
        f"difference to MUMPS {difference:.1e}"
    )
assert difference < 1e-7
# -

# ## The beam, bent and torn
#
# Each process gives the triangles of its part of the surface; the first one draws them.

# +
folder = writable_folder(Path("output/beam"), comm)
mesh.topology.create_connectivity(2, 3)
facets = dolfinx.mesh.exterior_facet_indices(mesh.topology)
facet_cells = mesh.topology.connectivity(2, 3)
cells = facet_cells.array[facet_cells.offsets[facets]]
corners = mesh.geometry.x[dolfinx.mesh.entities_to_geometry(mesh, 2, facets)]
shift = uh.eval(corners.reshape(-1, 3), np.repeat(cells, 3)).reshape(corners.shape)
parts = problem.decomposition
gathered = comm.gather((corners + 10 * shift, parts.first + parts.subdomain[cells]))
if comm.rank == 0:
    triangles, subdomain = (np.concatenate(part) for part in zip(*gathered, strict=True))
    fig, ax = plt.subplots(figsize=(9, 5), subplot_kw={"projection": "3d"})
    colours = plt.get_cmap("tab20")(subdomain % 20)
    ax.add_collection3d(
        Poly3DCollection(triangles, facecolors=colours, edgecolor="k", lw=0.2, clip_on=False)
    )
    for y, z in ((0, 0), (0, 1), (1, 0), (1, 1)):  # at rest
        ax.plot([0, 8], [y, y], [z, z], "k--", lw=0.8, clip_on=False)
    low, high = triangles.min(axis=(0, 1)), np.array([8.0, 1.0, 1.0])
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    ax.set_box_aspect(high - low, zoom=1.1)
    ax.view_init(elev=15, azim=-65)
    ax.set_axis_off()
    ax.set_title("16 subdomains; 8 mm × 1 mm × 1 mm at rest (dashed), displacement × 10")
    fig.savefig(folder / "beam.png", dpi=150, bbox_inches="tight")
