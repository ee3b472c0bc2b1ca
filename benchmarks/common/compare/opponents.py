# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The solvers of the comparison by PETSc options, and MKL's PARDISO as a preconditioner.

A new solver is an entry of :data:`OPPONENTS`. It is then a choice of ``--solvers``, has rows on the
page, and counts among the best of the others, as the dual formulation of FETI does. The figures
show the solvers of ``tables.CURVES`` and ``tables.FORMULATIONS``. The test of all solvers skips
those of ``ALONE`` in ``tests/benchmarks/test_solvers.py``, which may be missing or take one process
only.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from petsc4py import PETSc

import scipy.sparse

from dolfinx_feti.comparison import SOLVERS

#: PARDISO's kinds of matrices (``mtype``): symmetric positive definite, symmetric, any other.
DEFINITE = 2
SYMMETRIC = -2
GENERAL = 11


@dataclass(frozen=True, slots=True, kw_only=True)
class Opponent:
    """A solver of the comparison, FETI included.

    Args:
        title: Name on the page.
        options: PETSc options, without prefix.
        is_direct: Whether it factors the assembled matrix.
        is_torn: Whether it solves with subdomains, whose number the page shows.
    """

    title: str
    options: Mapping[str, object]
    is_direct: bool = False
    is_torn: bool = False


#: Solvers by name, in the order of the tables. A record of another one is refused.
OPPONENTS = {
    "feti": Opponent(title="FETI", options=SOLVERS["feti"], is_torn=True),
    "feti-dual": Opponent(title="FETI, dual", options={"feti_formulation": "dual"}, is_torn=True),
    "mumps": Opponent(title="MUMPS", options=SOLVERS["mumps"], is_direct=True),
    "mumps-blr": Opponent(
        title="MUMPS, low rank",
        options={
            "pc_type": "cholesky",
            "pc_factor_mat_solver_type": "mumps",
            "mat_mumps_icntl_14": 50,
            "mat_mumps_icntl_35": 2,
            "mat_mumps_cntl_7": 1e-6,
        },
        is_direct=True,
    ),
    "cholmod": Opponent(
        title="CHOLMOD",
        options={
            "ksp_type": "preonly",
            "pc_type": "cholesky",
            "pc_factor_mat_solver_type": "cholmod",
        },
        is_direct=True,
    ),
    "pardiso": Opponent(
        title="PARDISO",
        options={
            "ksp_type": "preonly",
            "pc_type": "python",
            "pc_python_type": "benchmarks.common.compare.opponents.Pardiso",
        },
        is_direct=True,
    ),
    "gamg": Opponent(title="GAMG", options=SOLVERS["gamg"]),
    "gamg-elasticity": Opponent(
        title="GAMG, SOR",
        options={"pc_type": "gamg", "mg_levels_pc_type": "sor", "mg_levels_ksp_max_it": 2},
    ),
    "hypre-elasticity": Opponent(
        title="BoomerAMG, HMIS",
        options={
            "pc_type": "hypre",
            "pc_hypre_boomeramg_strong_threshold": 0.7,
            "pc_hypre_boomeramg_coarsen_type": "HMIS",
            "pc_hypre_boomeramg_interp_type": "ext+i",
            "pc_hypre_boomeramg_P_max": 4,
        },
    ),
    "bddc": Opponent(title="BDDC", options=SOLVERS["bddc"], is_torn=True),
}

#: Solvers that factor the assembled matrix.
DIRECT = tuple(name for name, opponent in OPPONENTS.items() if opponent.is_direct)


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
