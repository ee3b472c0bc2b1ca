# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The solvers that the study compares FETI with, by their options of PETSc; MKL's PARDISO."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from petsc4py import PETSc

import scipy.sparse

from dolfinx_feti.comparison import SOLVERS

#: Kinds of matrices: symmetric positive definite, symmetric, and any other.
DEFINITE = 2
SYMMETRIC = -2
GENERAL = 11

#: Options of PETSc by the name of the solver.
OPPONENTS: dict[str, Mapping[str, object]] = {
    **SOLVERS,
    "feti-dual": {"feti_formulation": "dual"},
    "mumps-blr": {
        "pc_type": "cholesky",
        "pc_factor_mat_solver_type": "mumps",
        "mat_mumps_icntl_14": 50,
        "mat_mumps_icntl_35": 2,
        "mat_mumps_cntl_7": 1e-6,
    },
    "cholmod": {
        "ksp_type": "preonly",
        "pc_type": "cholesky",
        "pc_factor_mat_solver_type": "cholmod",
    },
    "pardiso": {
        "ksp_type": "preonly",
        "pc_type": "python",
        "pc_python_type": "benchmarks.common.compare.opponents.Pardiso",
    },
    "gamg-elasticity": {"pc_type": "gamg", "mg_levels_pc_type": "sor", "mg_levels_ksp_max_it": 2},
    "hypre-elasticity": {
        "pc_type": "hypre",
        "pc_hypre_boomeramg_strong_threshold": 0.7,
        "pc_hypre_boomeramg_coarsen_type": "HMIS",
        "pc_hypre_boomeramg_interp_type": "ext+i",
        "pc_hypre_boomeramg_P_max": 4,
    },
}

#: Those that factor the assembled matrix.
DIRECT = ("mumps", "mumps-blr", "cholmod", "pardiso")


class Pardiso:
    """Context of a PC whose application is A⁻¹; one process."""

    def __init__(self) -> None:
        """Find MKL."""
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
