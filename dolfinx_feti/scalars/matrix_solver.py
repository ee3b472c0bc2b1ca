# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Solves with a torn matrix by a FETI KSP, for arrays in place of PETSc's vectors."""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_feti.feti.solve_info import SolveInfo
from dolfinx_feti.feti.solver import FETI
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.lifetime import Lifetime

__all__ = ["MatrixSolveError", "MatrixSolver", "solve_ksp"]

#: Target of a solve relative to the tolerances that it has to meet: a margin, because rounding may
#: leave the KSP slightly above its target.
TARGET_FACTOR = 0.7


def solve_ksp(ksp: PETSc.KSP, A: PETSc.Mat, b: Array) -> Array:
    """Solve A x = b; return x, (N,), for b, (N,). Collective."""
    with Lifetime() as owned:
        rhs, x = map(owned.own, A.createVecs())
        rhs.array[:] = b
        ksp.setOperators(A)
        ksp.solve(rhs, x)
        return x.array_r.copy()


class MatrixSolveError(Exception):
    """A solve with A that has failed, on all processes.

    Attributes:
        info: How it has ended.
    """

    def __init__(self, info: SolveInfo) -> None:
        """Store how the solve has ended; its message is that of the exception."""
        super().__init__(info.message)
        self.info = info


class MatrixSolver:
    """Solves with A alone by the KSP, to its tolerances or to others.

    Attributes:
        A: Torn matrix, with the springs.
        comm: Communicator.
        rtol: Relative tolerance of the KSP.
        atol: Absolute tolerance of the KSP.
        iterations: Krylov iterations of all solves so far.
    """

    def __init__(self, ksp: PETSc.KSP, A: PETSc.Mat) -> None:
        """Store the parts of the solver; no iterations so far.

        Args:
            ksp: A KSP with a FETI context.
            A: Torn matrix.
        """
        self._ksp = ksp
        self.A = A
        self.comm: MPI.Comm = A.comm.tompi4py()
        rtol, atol, *_ = ksp.getTolerances()
        self.rtol: float = rtol
        self.atol: float = atol
        self.iterations = 0

    @property
    def feti(self) -> FETI:
        """The context of the KSP."""
        context: FETI = self._ksp.getPythonContext()
        return context

    def solve(self, b: Array) -> tuple[Array, SolveInfo]:
        """Solve A x = b to the tolerances of the KSP. Collective.

        Args:
            b: Right-hand side, with prescribed values on Dirichlet dofs, (N,).

        Returns:
            x, (N,), and how the solve has ended.
        """
        x = solve_ksp(self._ksp, self.A, b)
        info = self.feti.info
        self.iterations += info.iterations
        return x, info

    def solve_to(self, b: Array, *, rtol: float, atol: float) -> Array:
        """Solve A x = b to other tolerances, and set those of the KSP back. Collective.

        The target is :data:`TARGET_FACTOR` times the tolerances.

        Args:
            b: Right-hand side, (N,).
            rtol: Relative tolerance.
            atol: Absolute tolerance.

        Returns:
            x, (N,).

        Raises:
            MatrixSolveError: The solve has failed.
        """
        self._ksp.setTolerances(rtol=TARGET_FACTOR * rtol, atol=TARGET_FACTOR * atol)
        try:
            x, info = self.solve(b)
        finally:
            self._ksp.setTolerances(rtol=self.rtol, atol=self.atol)
        if info.reason < 0:
            raise MatrixSolveError(info)
        return x

    def precondition(self, r: Array) -> Array | None:
        """Return z ≈ A⁻¹ r, (N,), by one application of the preconditioner. Collective.

        Args:
            r: Residual, zero on Dirichlet dofs, (N,).

        Returns:
            z, (N,); None if nothing can be set up for the matrix.
        """
        return self.feti.correction(self._ksp, r)
