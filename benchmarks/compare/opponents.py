# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The solvers that the study compares FETI with, by their options of PETSc."""

from __future__ import annotations

from collections.abc import Mapping

from dolfinx_feti.comparison import SOLVERS

__all__ = ["DIRECT", "OPPONENTS"]

#: Options of PETSc by the name of the solver. ``fieldsplit-augmented`` solves the system before the
#: pressure was condensed: one V-cycle for K_uu, the blocks of the cells for p.
OPPONENTS: dict[str, Mapping[str, object]] = {
    **SOLVERS,
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
        "pc_python_type": "benchmarks.compare.pardiso.Pardiso",
    },
    "gamg-elasticity": {
        "pc_type": "gamg",
        "mg_levels_pc_type": "sor",
        "mg_levels_ksp_max_it": 2,
    },
    "hypre-elasticity": {
        "pc_type": "hypre",
        "pc_hypre_boomeramg_strong_threshold": 0.7,
        "pc_hypre_boomeramg_coarsen_type": "HMIS",
        "pc_hypre_boomeramg_interp_type": "ext+i",
        "pc_hypre_boomeramg_P_max": 4,
    },
    "fieldsplit-augmented": {
        "ksp_type": "python",
        "ksp_python_type": "benchmarks.compare.split.Uncondensed",
        "pc_type": "none",
        "inner_pc_fieldsplit_schur_fact_type": "lower",
        "inner_fieldsplit_0_ksp_type": "preonly",
        "inner_fieldsplit_0_pc_type": "gamg",
        "inner_fieldsplit_0_mg_levels_pc_type": "sor",
        "inner_fieldsplit_1_ksp_type": "preonly",
        "inner_fieldsplit_1_pc_type": "pbjacobi",
    },
}

#: Those that factor the assembled matrix.
DIRECT = ("mumps", "mumps-blr", "cholmod", "pardiso")
