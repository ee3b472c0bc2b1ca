# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The mixed problem in (u, p), not condensed and not torn: Newton's method with a sparse LU.

Each process solves the whole of it by itself. It shares no line with the package.
"""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
import scipy.sparse
import scipy.sparse.linalg
from walls import Wall

import dolfinx
import dolfinx.fem.petsc
import ufl

Array = npt.NDArray[np.float64]


class Mixed:
    """The blocks of a wall whose mesh lives on this process alone.

    Attributes:
        wall: The wall.
    """

    def __init__(self, wall: Wall) -> None:
        self.wall = wall
        u, p = wall.u, wall.p
        du, dp = ufl.TrialFunction(u.function_space), ufl.TrialFunction(p.function_space)
        self._r = [compiled(form) for form in (wall.F_u, wall.F_p)]
        self._K = [
            [compiled(wall.J), compiled(ufl.derivative(wall.F_u, p, dp))],
            [
                compiled(form)
                for form in (ufl.derivative(wall.F_p, f, d) for f, d in ((u, du), (p, dp)))
            ],
        ]

    def blocks(self) -> list[list[scipy.sparse.csr_array]]:
        """Assemble K_uu, K_up and K_pu, K_pp without boundary conditions."""
        return [[block(form) for form in row] for row in self._K]

    def residual(self) -> Array:
        """Assemble r_u and r_p without boundary conditions."""
        return np.concatenate([dolfinx.fem.assemble_vector(form).array.copy() for form in self._r])

    def step(self) -> tuple[Array, Array]:
        """Return Newton's step Δu, Δp from the present state."""
        n = len(self.wall.u.x.array)
        r = self.residual()
        K = scipy.sparse.block_array(self.blocks(), format="csc")
        step = np.zeros(len(r))
        fixed = np.zeros(len(r), dtype=bool)
        for bc in self.wall.bcs:
            gap = np.zeros(n)
            bc.set(gap, self.wall.u.x.array, -1.0)  # u − g
            dofs = bc._cpp_object.dof_indices()[0]
            step[dofs], fixed[dofs] = -gap[dofs], True
        free = ~fixed
        rhs = -(r + K @ step)[free]
        lu = scipy.sparse.linalg.splu(K[free][:, free])
        step[free] = lu.solve(rhs)
        step[free] += lu.solve(rhs - K[free][:, free] @ step[free])
        return step[:n], step[n:]

    def solve(self, *, tolerance: float = 1e-12, steps: int = 12) -> None:
        """Take whole Newton steps until they are small."""
        for _ in range(steps):
            du, dp = self.step()
            self.wall.u.x.array[:] += du
            self.wall.p.x.array[:] += dp
            if np.linalg.norm(du) <= tolerance * np.linalg.norm(self.wall.u.x.array):
                return
        raise AssertionError(f"the reference did not converge: |du| = {np.linalg.norm(du)}")


def compiled(form: ufl.Form) -> dolfinx.fem.Form:
    """Compile a form of a mesh that each process has for itself, one process before the others."""
    comm = MPI.COMM_WORLD
    if comm.rank == 0:
        form = dolfinx.fem.form(form)
    comm.Barrier()
    return form if comm.rank == 0 else dolfinx.fem.form(form)


def block(form: dolfinx.fem.Form) -> scipy.sparse.csr_array:
    """Assemble a block; only PETSc's matrices take different numbers of components."""
    M = dolfinx.fem.petsc.assemble_matrix(form)
    M.assemble()
    indptr, indices, values = M.getValuesCSR()
    K = scipy.sparse.csr_array((values, indices, indptr), shape=M.getSize())
    M.destroy()
    return K


def by_place(f: dolfinx.fem.Function) -> Array:
    """Return the values of all processes, sorted by the dofs' places, (dofs, components)."""
    V = f.function_space
    n, bs = V.dofmap.index_map.size_local, V.dofmap.index_map_bs
    comm = V.mesh.comm
    x = np.concatenate(comm.allgather(V.tabulate_dof_coordinates()[:n]))
    values = np.concatenate(comm.allgather(f.x.array[: n * bs].reshape(n, bs)))
    return values[np.lexsort(np.round(x, 6).T)]


def solve_assembled(A: PETSc.Mat, b: PETSc.Vec) -> Array:
    """Solve A x = b with MUMPS on the assembled matrix; return the owned values.

    On Dirichlet dofs b holds the value of x.
    """
    dirichlet = A.query("dirichlet")
    M = A.convert("aij", out=PETSc.Mat())
    x, rhs = b.copy(), b.copy()
    M.zeroRowsColumns(dirichlet, diag=1.0, x=x, b=rhs)
    ksp = PETSc.KSP().create(M.comm)
    ksp.setOperators(M)
    ksp.setType(PETSc.KSP.Type.PREONLY)
    ksp.getPC().setType(PETSc.PC.Type.LU)
    ksp.getPC().setFactorSolverType(PETSc.Mat.SolverType.MUMPS)
    ksp.solve(rhs, x)
    r, correction = rhs.duplicate(), x.duplicate()
    M.mult(x, r)
    r.aypx(-1.0, rhs)
    ksp.solve(r, correction)
    x.axpy(1.0, correction)
    values = x.array_r.copy()
    for owned in (ksp, M, x, rhs, r, correction):
        owned.destroy()
    return values
