# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""MKL's PARDISO as a preconditioner of PETSc, by the module pypardiso, if that is there."""

from __future__ import annotations

from typing import Any

from petsc4py import PETSc

import scipy.sparse

__all__ = ["Pardiso"]

#: Kinds of matrices: symmetric positive definite, symmetric, and any other.
DEFINITE, SYMMETRIC, GENERAL = 2, -2, 11


class Pardiso:
    """Context of a PC whose application is A⁻¹; one process."""

    def __init__(self) -> None:
        """Find MKL.

        Raises:
            ImportError: The module finds none.
        """
        import pypardiso

        self._create = pypardiso.PyPardisoSolver
        self._solver: Any = None
        self._matrix = scipy.sparse.csr_matrix((0, 0))

    def setUp(self, pc: PETSc.PC) -> None:
        """Factor the matrix, of which PARDISO takes the upper half if it is symmetric."""
        A = pc.getOperators()[0]
        kind = GENERAL
        if all(A.isSymmetricKnown()):
            definite = PETSc.Options(pc.getOptionsPrefix()).getBool("definite", False)
            kind = DEFINITE if definite else SYMMETRIC
        if self._solver is None:
            self._solver = self._create(mtype=kind)
        rows, columns, values = A.getValuesCSR()
        K = scipy.sparse.csr_matrix((values, columns, rows), shape=A.getSize())
        self._matrix = K if kind == GENERAL else scipy.sparse.triu(K, format="csr")
        self._solver.factorize(self._matrix)

    def apply(self, _pc: PETSc.PC, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """Solve."""
        x.array[:] = self._solver.solve(self._matrix, b.array_r.copy())

    def destroy(self, _pc: PETSc.PC) -> None:
        """Free the factors."""
        if self._solver is not None:
            self._solver.free_memory(everything=True)
