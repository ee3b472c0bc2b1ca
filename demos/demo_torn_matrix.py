# # A torn matrix of your own, compared with PCBDDC
#
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
#
# The solver does not need dolfinx. It reads a *torn* matrix: a PETSc MATIS whose local matrix has
# one block per subdomain. Here numpy and scipy assemble one, for heat conduction in a plate; FETI
# and PETSc's PCBDDC solve with it.
#
#     python3 demos/demo_torn_matrix.py
#     mpirun -n 4 python3 demos/demo_torn_matrix.py

# +
from mpi4py import MPI
from petsc4py import PETSc

import matplotlib.pyplot as plt
import numpy as np
import scipy.sparse

import dolfinx_feti

comm = MPI.COMM_WORLD
# -

# ## The torn matrix
#
# The plate is p × p squares of n × n bilinear elements. The matrix of one square is
# $K_i = S ⊗ M + M ⊗ S$ with stiffness S and mass M in one dimension; none is fixed anywhere. The
# local matrix of a process holds the blocks of its squares, $K = \operatorname{diag}(K_1, …, K_p)$,
# and `to_global` is T in $A = T^⊤ K\, T$: the global dof of each torn one. That pair is a MATIS.


# +
def local_matrix(K):
    """Return a PETSc matrix of this process alone."""
    pattern = (K.indptr.astype(PETSc.IntType), K.indices.astype(PETSc.IntType))
    return PETSc.Mat().createAIJ(K.shape, csr=(*pattern, K.data), comm=PETSc.COMM_SELF)


p = 4
n = 16
side = p * n + 1

ends = np.array([1.0, *[2.0] * (n - 1), 1.0])
beside = np.ones(n)
mass = scipy.sparse.diags_array([beside, 2 * ends, beside], offsets=[-1, 0, 1]) / (6 * n * p)
stiff = scipy.sparse.diags_array([-beside, ends, -beside], offsets=[-1, 0, 1]) * (n * p)
K_i = scipy.sparse.kron(stiff, mass) + scipy.sparse.kron(mass, stiff)

nodes = np.arange(side**2).reshape(side, side)  # global dofs
blocks = []
dofs = []
for k in range(comm.rank, p * p, comm.size):  # squares of this process
    row, column = divmod(k, p)
    of_square = nodes[row * n : (row + 1) * n + 1, column * n : (column + 1) * n + 1]
    blocks.append(K_i)
    dofs.append(of_square.ravel())
K = scipy.sparse.csr_array(scipy.sparse.block_diag(blocks))
to_global = np.concatenate(dofs)
# -

# ## What else the solver has to know
#
# The temperature is zero on the lower side. Assemble without the conditions: those dofs stay
# **free** in the matrix, and are named in `dirichlet`. All-floating FETI imposes their values by
# multipliers, classical FETI fixes them itself. With one dof per node the near kernel is the
# constant; `set_near_kernel` attaches rigid body modes.

# +
owned = (side**2 + comm.rank) // comm.size
bottom = nodes[0]
A = dolfinx_feti.create_torn_matrix(
    local_matrix(K), to_global, (owned, side**2), comm=comm, dirichlet=bottom
)
x, b = A.createVecs()
start, end = b.getOwnershipRange()
heat = np.zeros((side, side))
heat[1:-1, 1:-1] = 1 / (n * p) ** 2  # one per area, but for the rim
b.array[:] = heat.ravel()[start:end]  # on the Dirichlet dofs, their values: zero

ksp = PETSc.KSP().create(comm)
ksp.setOptionsPrefix("feti_")
ksp.setOperators(A)
ksp.setType("python")
ksp.setPythonContext(dolfinx_feti.FETI())
ksp.setTolerances(rtol=1e-8)
ksp.setFromOptions()
ksp.solve(b, x)
feti = ksp.getPythonContext()
# -

# ## PCBDDC on the same squares
#
# PETSc's balancing method also takes a MATIS, but with one subdomain per process and with the
# conditions built in. The program therefore assembles the matrix again, with the squares of each
# process as one subdomain.

# +
rows, local = np.unique(to_global, return_inverse=True)
T = scipy.sparse.csr_array((np.ones(len(local)), (np.arange(len(local)), local)))
K_union = scipy.sparse.csr_array(T.T @ K @ T)
B = PETSc.Mat().create(comm)
B.setSizes(((owned, side**2), (owned, side**2)))
B.setType(PETSc.Mat.Type.IS)
lgmap = PETSc.LGMap().create(rows.astype(PETSc.IntType), comm=comm)
B.setLGMap(lgmap, lgmap)
B.setISLocalMat(local_matrix(K_union))
B.assemble()
here = bottom[(bottom >= start) & (bottom < end)].astype(PETSc.IntType)
B.zeroRowsColumns(here, diag=1.0)

balancing = PETSc.KSP().create(comm)
balancing.setOptionsPrefix("bddc_")
balancing.setOperators(B)
balancing.setType("cg")
balancing.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
balancing.getPC().setType("bddc")
balancing.setTolerances(rtol=1e-8)
balancing.setFromOptions()
y = x.duplicate()
balancing.solve(b, y)

difference = (y - x).norm() / y.norm()
if comm.rank == 0:
    print(f"FETI, {p * p} subdomains: {feti.iterations} iterations")
    print(f"PCBDDC, {comm.size} subdomain(s): {balancing.getIterationNumber()} iterations")
    print(f"relative difference {difference:.1e}")
assert ksp.getConvergedReason() > 0 and balancing.getConvergedReason() > 0
assert difference < 1e-6
# -

# On one process PCBDDC factors this single subdomain. Run it on several to compare.
#
# ## The temperature

# +
parts = comm.gather(x.array_r.copy())
if comm.rank == 0:
    fig, ax = plt.subplots(figsize=(5.2, 4), layout="constrained")
    field = np.concatenate(parts).reshape(side, side)
    shown = ax.imshow(field, origin="lower", extent=(0, 1, 0, 1))
    ax.set_xticks(np.linspace(0, 1, p + 1))
    ax.set_yticks(np.linspace(0, 1, p + 1))
    ax.grid(color="w")
    ax.set_title("the squares and the temperature")
    ax.set_xlabel("x / length")
    ax.set_ylabel("y / length")
    fig.colorbar(shown, label="temperature / (heat length² / conductivity)")
    fig.savefig("temperature.png", dpi=150)
