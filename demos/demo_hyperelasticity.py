# # A twisted block of rubber: NonlinearProblem swapped
#
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
#
# The hyperelastic block of the FEniCS demos: clamped at one face, turned at the other, pulled by a
# traction. Forms, functions and boundary conditions are those of a dolfinx script; the problem is
# the `NonlinearProblem` of this package, instead of the one in `dolfinx.fem.petsc`. In the
# end dolfinx is asked whether it finds the result in equilibrium.
#
#     python3 demos/demo_hyperelasticity.py

# +
from pathlib import Path

from mpi4py import MPI
from petsc4py import PETSc

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

import dolfinx
import dolfinx.fem.petsc
import ufl

from dolfinx_feti import NonlinearProblem
from dolfinx_feti.output import writable_folder

comm = MPI.COMM_WORLD
mesh = dolfinx.mesh.create_box(comm, [(0.0, 0.0, 0.0), (1.0, 1.0, 1.0)], (8, 8, 8))
V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (3,)))
u, v = dolfinx.fem.Function(V, name="u"), ufl.TestFunction(V)
# -

# ## The energy
#
# Neo-Hooke, compressible, with J = det F:
#
# $$ Ψ = \frac μ2 (\operatorname{tr} F^⊤F - 3) - μ \ln J + \frac λ2 (\ln J)^2, \qquad
#    Π(u) = \int_Ω Ψ - f·u \,\mathrm dX - \int_{∂Ω} t·u \,\mathrm dA . $$
#
# The energy is all that the problem is given: residual and tangent are its derivatives.

# +
E, nu = 10.0, 0.3
mu, lmbda = E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))
body_force = dolfinx.fem.Constant(mesh, (0.0, -0.5, 0.0))
traction = dolfinx.fem.Constant(mesh, (0.1, 0.0, 0.0))

F = ufl.Identity(3) + ufl.grad(u)
J = ufl.det(F)
psi = mu / 2 * (ufl.tr(F.T * F) - 3) - mu * ufl.ln(J) + lmbda / 2 * ufl.ln(J) ** 2
potential = psi * ufl.dx - ufl.inner(body_force, u) * ufl.dx - ufl.inner(traction, u) * ufl.ds
# -

# ## A face that turns
#
# The right face is turned by an angle, which grows in three steps. The boundary condition holds a
# Function whose values change; the problem is set up once.

# +
rotation = dolfinx.fem.Function(V)


def turn(angle: float) -> None:
    """Turn the right face about its centre."""

    def moved(x: np.ndarray) -> np.ndarray:
        y, z = x[1] - 0.5, x[2] - 0.5
        c, s = np.cos(angle), np.sin(angle)
        return np.stack([0 * y, c * y - s * z - y, s * y + c * z - z])

    rotation.interpolate(moved)


def dofs(at: float) -> np.ndarray:
    """Return the dofs of a face x = at."""
    facets = dolfinx.mesh.locate_entities_boundary(mesh, 2, lambda x: np.isclose(x[0], at))
    return dolfinx.fem.locate_dofs_topological(V, 2, facets)


bcs = [
    dolfinx.fem.dirichletbc(np.zeros(3), dofs(0.0), V),
    dolfinx.fem.dirichletbc(rotation, dofs(1.0)),
]
problem = NonlinearProblem(
    potential, u, bcs=bcs, subdomains=16, quadrature_degree=4, petsc_options={"snes_rtol": 1e-10}
)
for degrees in (20, 40, 60):
    turn(np.radians(degrees))
    problem.solve()
    if comm.rank == 0:
        newton = [f"{step.residual:.1e}" for step in problem.history]
        linear = [step.linear_iterations for step in problem.history]
        print(f"{degrees}°: residuals {', '.join(newton)}; FETI iterations {linear}", flush=True)
# -

# The residuals of the last steps fall quadratically.
#
# ## In dolfinx's eyes
#
# dolfinx assembles the residual of this displacement, without subdomains. On the free dofs it has
# to vanish; on the clamped ones it is the force that holds the block, and its size is what the rest
# is measured by.

# +
residual = dolfinx.fem.form(ufl.derivative(potential, u, v))
b = dolfinx.fem.petsc.assemble_vector(residual)
b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
held = np.unique(np.concatenate([dofs(0.0), dofs(1.0)]))
owned = V.dofmap.index_map.size_local
forces = b.array.reshape(-1, 3).copy()
support = forces[held[held < owned]]
forces[held[held < owned]] = 0.0
unbalanced = np.sqrt(comm.allreduce(np.sum(forces**2)))
holding = np.sqrt(comm.allreduce(np.sum(support**2)))
if comm.rank == 0:
    print(f"unbalanced force {unbalanced:.1e}, supports {holding:.2f}")
assert unbalanced < 1e-8 * holding
# -

# ## The block

# +
folder = writable_folder(Path("output/hyperelasticity"), comm)
mesh.topology.create_connectivity(2, 3)
facets = dolfinx.mesh.exterior_facet_indices(mesh.topology)
facet_cells = mesh.topology.connectivity(2, 3)
cells = facet_cells.array[facet_cells.offsets[facets]]
corners = mesh.geometry.x[dolfinx.mesh.entities_to_geometry(mesh, 2, facets)]
shift = u.eval(corners.reshape(-1, 3), np.repeat(cells, 3)).reshape(corners.shape)
gathered = comm.gather((corners + shift, np.linalg.norm(shift, axis=2).mean(axis=1)))
if comm.rank == 0:
    triangles, distance = (np.concatenate(part) for part in zip(*gathered, strict=True))
    fig, ax = plt.subplots(figsize=(7, 5), subplot_kw={"projection": "3d"})
    scale = Normalize(0.0, distance.max())
    colours = plt.get_cmap("viridis")(scale(distance))
    ax.add_collection3d(Poly3DCollection(triangles, facecolors=colours, edgecolor="k", lw=0.2))
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    ax.set_box_aspect(high - low)
    ax.view_init(elev=20, azim=-60)
    ax.set_axis_off()
    bar = fig.colorbar(ScalarMappable(scale, "viridis"), ax=ax, shrink=0.7)
    bar.set_label("displacement |u| / edge length")
    fig.savefig(folder / "block.png", dpi=150, bbox_inches="tight")
