# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The mixed problem in u and p, neither condensed nor torn: Newton's method with MUMPS.

Each process solves the whole problem by itself, without any code of the package.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
import scipy.sparse
from collective import lu_solve, norm
from hand_torn import aij
from problems import cube, dirichlet, left
from walls import Wall

import dolfinx
import dolfinx.fem.petsc
import ufl

Array = npt.NDArray[np.float64]

#: Elements by name: cell, degree of u, condensed fields (of three, the first is a dilation).
ELEMENTS = {
    "p1-p0": ("tetrahedron", 1, [("DG", 0)]),
    "p2-p0": ("tetrahedron", 2, [("DG", 0)]),
    "p2-p1d": ("tetrahedron", 2, [("DG", 1)]),
    "q1-p0": ("hexahedron", 1, [("DG", 0)]),
    "q2-p1d": ("hexahedron", 2, [("DPC", 1)]),
    "p2-p1d in 2D": ("triangle", 2, [("DG", 1)]),
    "q2-p1d in 2D": ("quadrilateral", 2, [("DPC", 1)]),
    "p2-p0-p0": ("tetrahedron", 2, [("DG", 0), ("DG", 0)]),
    "q2-p1d-p1d": ("hexahedron", 2, [("DPC", 1), ("DPC", 1)]),
}


@dataclass(frozen=True)
class Block:
    """A distorted block of rubber in its weight, clamped on the left.

    Its condensed fields are a pressure, or a dilation θ and a pressure.
    """

    u: dolfinx.fem.Function
    fields: tuple[dolfinx.fem.Function, ...]
    energy: ufl.Form
    bcs: list[dolfinx.fem.DirichletBC]

    @cached_property
    def F_u(self) -> ufl.Form:
        return ufl.derivative(self.energy, self.u, ufl.TestFunction(self.u.function_space))

    @cached_property
    def F_fields(self) -> tuple[ufl.Form, ...]:
        tests = [ufl.TestFunction(p.function_space) for p in self.fields]
        return tuple(map(ufl.derivative, [self.energy] * len(tests), self.fields, tests))

    @cached_property
    def J(self) -> ufl.Form:
        return ufl.derivative(self.F_u, self.u, ufl.TrialFunction(self.u.function_space))

    def deform(self) -> None:
        """Set u and the fields to a state that is no solution of any equation."""
        self.u.interpolate(
            lambda x: 0.05 * (np.sin(2 * np.roll(x, 1, 0)) + x[0] * x[1])[: len(self.u)]
        )
        for i, p in enumerate(self.fields, 1):
            p.interpolate(lambda x, i=i: 1.0 + 0.1 * np.cos(3 * x[0]) + 0.05 * i * x[1])


def block(comm: MPI.Comm, element: str, kappa: float, n: int = 3) -> Block:
    """Create a block with a key of ``ELEMENTS``, shear modulus 1, κ, and n cells an edge."""
    cell, degree, pressures = ELEMENTS[element]
    kind = getattr(dolfinx.mesh.CellType, cell)
    mesh = cube(3 if "hedron" in cell else 2, n, kind, comm)
    x = mesh.geometry.x
    d = mesh.geometry.dim
    x[:, :d] += 0.05 * np.sin(3 * np.roll(x[:, :d], 1, axis=1)) * x[:, :1]
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", degree, (d,)))
    u = dolfinx.fem.Function(V, name="u")
    fields = tuple(
        dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, Q), name=name)
        for Q, name in zip(pressures, ("θ", "p")[-len(pressures) :], strict=True)
    )
    F = ufl.Identity(d) + ufl.grad(u)
    J = ufl.det(F)
    psi = (J ** (-2 / 3) * (ufl.inner(F, F) + 3 - d) - 3) / 2
    if len(fields) == 1:
        psi += fields[0] * (J - 1) - fields[0] ** 2 / (2 * kappa)
    else:
        θ, p = fields
        psi += kappa / 2 * ((θ**2 - 1) / 2 - ufl.ln(θ)) + p * (J - θ)
    energy = (psi + 0.1 * u[d - 1]) * ufl.dx(metadata={"quadrature_degree": 2 * degree})
    return Block(u, fields, energy, [dirichlet(V, left)])


class Mixed:
    """Matrices, residuals and Newton steps of a body whose mesh is on this process alone.

    Attributes:
        body: A wall or a block.
    """

    def __init__(self, body: Wall | Block) -> None:
        self.body = body
        rows = (body.F_u, *body.F_fields)
        unknowns = (body.u, *body.fields)
        self._r = [compiled(F) for F in rows]
        blocks = [[ufl.derivative(F, f) for f in unknowns] for F in rows]
        blocks[0][0] = body.J
        self._K = [[compiled(K) for K in row] for row in blocks]

    def blocks(self) -> list[list[scipy.sparse.csr_array]]:
        """Assemble K_uu, K_up, … without boundary conditions; a row of blocks for each unknown."""
        return [[assembled(form) for form in row] for row in self._K]

    def residual(self) -> Array:
        """Assemble r_u, r_p without boundary conditions."""
        return np.concatenate([dolfinx.fem.assemble_vector(form).array.copy() for form in self._r])

    def increments(self) -> tuple[Array, Array]:
        """Return the increments of a Newton step, Δu, and Δp of all fields in a row."""
        n = len(self.body.u.x.array)
        r = self.residual()
        K = scipy.sparse.block_array(self.blocks(), format="csc")
        step = np.zeros(len(r))
        fixed = np.zeros(len(r), dtype=bool)
        for bc in self.body.bcs:
            gap = np.zeros(n)
            bc.set(gap, self.body.u.x.array, -1.0)  # u − g
            dofs = bc._cpp_object.dof_indices()[0]
            step[dofs] = -gap[dofs]
            fixed[dofs] = True
        free = ~fixed
        step[free] = solve_sparse(K[free][:, free], -(r + K @ step)[free])
        return step[:n], step[n:]

    def make_step(self) -> Array:
        """Add the increments of a Newton step to the state; return Δu."""
        du, dp = self.increments()
        self.body.u.x.array[:] += du
        ends = np.cumsum([len(p.x.array) for p in self.body.fields])
        for p, part in zip(self.body.fields, np.split(dp, ends[:-1]), strict=True):
            p.x.array[:] += part
        return du

    def solve(self, *, tolerance: float = 1e-12, steps: int = 12) -> None:
        """Make full Newton steps until they are small."""
        for _ in range(steps):
            du = self.make_step()
            if np.linalg.norm(du) <= tolerance * np.linalg.norm(self.body.u.x.array):
                return
        raise AssertionError(f"the reference did not converge: |du| = {np.linalg.norm(du)}")


def solve_sparse(K: scipy.sparse.csr_array, b: Array) -> Array:
    """Solve K x = b on this process alone."""
    A = aij(K.tocsr())
    rhs = PETSc.Vec().createWithArray(b, comm=PETSc.COMM_SELF)
    x = lu_solve(A, rhs)
    A.destroy()
    rhs.destroy()
    return x


def compiled(form: ufl.Form) -> dolfinx.fem.Form:
    """Compile a form of a mesh that each process has for itself. Collective.

    The first process compiles it; the others then find the code in the cache.
    """
    comm = MPI.COMM_WORLD
    if comm.rank == 0:
        form = dolfinx.fem.form(form)
    comm.Barrier()
    return form if comm.rank == 0 else dolfinx.fem.form(form)


def assembled(form: dolfinx.fem.Form) -> scipy.sparse.csr_array:
    """Assemble a block as a matrix of PETSc, whose rows and columns may have other block sizes."""
    M = dolfinx.fem.petsc.assemble_matrix(form)
    M.assemble()
    indptr, indices, values = M.getValuesCSR()
    K = scipy.sparse.csr_array((values, indices, indptr), shape=M.getSize())
    M.destroy()
    return K


def by_place(f: dolfinx.fem.Function) -> Array:
    """Return the values of all processes, sorted by the coordinates of the dofs, (nodes, bs)."""
    V = f.function_space
    n = V.dofmap.index_map.size_local
    bs = V.dofmap.index_map_bs
    comm = V.mesh.comm
    x = np.concatenate(comm.allgather(V.tabulate_dof_coordinates()[:n]))
    values = np.concatenate(comm.allgather(f.x.array[: n * bs].reshape(n, bs)))
    return values[np.lexsort(np.round(x, 6).T)]


def by_cell(f: dolfinx.fem.Function) -> Array:
    """Return the values of all processes on each cell, in the original order of cells."""
    V = f.function_space
    mesh = V.mesh
    comm = V.mesh.comm
    n = mesh.topology.index_map(mesh.topology.dim).size_local
    number = np.concatenate(comm.allgather(mesh.topology.original_cell_index[:n]))
    values = np.concatenate(comm.allgather(f.x.array[V.dofmap.list[:n]]))
    return values[np.argsort(number)]


def solve_assembled(A: PETSc.Mat, b: PETSc.Vec) -> Array:
    """Solve A x = b on the assembled matrix; return the owned values.

    On Dirichlet dofs b holds the value of x.
    """
    dirichlet = A.query("dirichlet")
    M = A.convert("aij", out=PETSc.Mat())
    rhs = b.copy()
    M.zeroRowsColumns(dirichlet, diag=1.0, x=b, b=rhs)
    x = lu_solve(M, rhs)
    M.destroy()
    rhs.destroy()
    return x


def errors_of_solves(problem: Any) -> list[float]:
    """Return a list, to which each later linear solve appends its relative error against MUMPS."""
    errors = []

    def compare(ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
        expected = solve_assembled(ksp.getOperators()[0], b)
        errors.append(norm(x.array_r - expected) / norm(expected))

    problem.solver.getKSP().setPostSolve(compare)
    return errors
