# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The solvers that FETI is compared with: what each is, and its settings, in one table.

A setting is an option of PETSc under the prefix of the solver, and stands back behind the user's
own. The table of ``docs/comparing.md`` is this one.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.util import find_spec

from petsc4py import PETSc

from dolfinx_feti.runtime.petsc_options import inserted

__all__ = ["SETTINGS", "SOLVERS", "USUAL", "Settings", "in_force", "missing", "prefix_of"]

#: Of the solvers on displacement and pressure: one V-cycle for K_uu, the blocks of the cells for p.
SPLIT: dict[str, object] = {
    "pc_fieldsplit_schur_fact_type": "lower",
    "fieldsplit_0_ksp_type": "preonly",
    "fieldsplit_0_pc_type": "gamg",
    "fieldsplit_0_mg_levels_pc_type": "sor",
    "fieldsplit_1_ksp_type": "preonly",
    "fieldsplit_1_pc_type": "pbjacobi",
}


@dataclass(frozen=True, slots=True)
class Settings:
    """A solver of a comparison.

    Attributes:
        family: What it solves with: ``torn`` matrix, ``direct`` factors of the assembled one,
            ``krylov`` method on the assembled one, ``split`` displacement and pressure.
        method: What it is, in a few words.
        options: Options of PETSc, without prefix.
        package: Package that PETSc has to be built with.
        module: Module of Python that has to be there.
        serial: Whether it runs on one process only.
    """

    family: str
    method: str
    options: Mapping[str, object] = field(default_factory=dict)
    package: str = ""
    module: str = ""
    serial: bool = False


SETTINGS = {
    "feti": Settings("torn", "the problem's own options"),
    "mumps": Settings(
        "direct", "Cholesky, LDLᵀ or LU", {"mat_mumps_icntl_14": 50}, package="mumps"
    ),
    "mumps-blr": Settings(
        "direct",
        "the same with low-rank blocks, a preconditioner of CG",
        {"mat_mumps_icntl_14": 50, "mat_mumps_icntl_35": 2, "mat_mumps_cntl_7": 1e-6},
        package="mumps",
    ),
    "cholmod": Settings(
        "direct", "Cholesky, positive definite matrices only", package="cholmod", serial=True
    ),
    "pardiso": Settings("direct", "MKL PARDISO, ordered by METIS", module="pypardiso", serial=True),
    "gamg": Settings("krylov", "CG, smoothed aggregation, near kernel"),
    "gamg-elasticity": Settings(
        "krylov",
        "the same with settings for elasticity",
        {"mg_levels_pc_type": "sor", "mg_levels_ksp_max_it": 2},
    ),
    "hypre": Settings("krylov", "CG, BoomerAMG", package="hypre"),
    "hypre-elasticity": Settings(
        "krylov",
        "the same with settings for elasticity",
        {
            "pc_hypre_boomeramg_strong_threshold": 0.7,
            "pc_hypre_boomeramg_coarsen_type": "HMIS",
            "pc_hypre_boomeramg_interp_type": "ext+i",
            "pc_hypre_boomeramg_P_max": 4,
        },
        package="hypre",
    ),
    "fieldsplit": Settings("split", "FGMRES on u and p, Schur complement, GAMG on K_uu", SPLIT),
    "fieldsplit-augmented": Settings(
        "split", "the same with GAMG on K_uu + θ (K − K_uu)", SPLIT | {"augmentation": 2.5}
    ),
    "bddc": Settings(
        "torn",
        "CG, PETSc's PCBDDC on the same subdomains",
        {
            "pc_bddc_neumann_pc_factor_mat_solver_type": "mumps",
            "pc_bddc_dirichlet_pc_factor_mat_solver_type": "mumps",
        },
    ),
    "bddc-deluxe": Settings(
        "torn",
        "the same with deluxe scaling and adaptive constraints",
        {"pc_bddc_use_deluxe_scaling": True, "pc_bddc_adaptive_threshold": 5},
    ),
}

#: Names of all solvers, and of those that a comparison takes if it is not told.
SOLVERS = tuple(SETTINGS)
USUAL = ("feti", "mumps", "gamg", "bddc")


def prefix_of(solver: str) -> str:
    """Return the prefix of a solver's options, ``gamg_elasticity_`` of ``gamg-elasticity``."""
    return solver.replace("-", "_") + "_"


def missing(solver: str, processes: int) -> str:
    """Say why a solver cannot be had on so many processes, or nothing if it can.

    Args:
        solver: A name out of :data:`SOLVERS`.
        processes: Their number.
    """
    needs = SETTINGS[solver]
    if needs.package and not PETSc.Sys.hasExternalPackage(needs.package):
        return f"this PETSc was built without {needs.package}"
    if needs.module and find_spec(needs.module) is None:
        return f"there is no module {needs.module}: pip install {needs.module}"
    if needs.serial and processes > 1:
        return "it runs on one process only"
    return ""


@contextmanager
def in_force(solver: str, **more: object) -> Iterator[None]:
    """Put the settings of a solver, and more, into PETSc's database for a while, behind the user's.

    PETSc reads options of a multigrid's levels, or of a factor, when the solver is set up.
    """
    prefix = prefix_of(solver)
    users = PETSc.Options(prefix)
    options = {**SETTINGS[solver].options, **more}
    with inserted(prefix, {k: v for k, v in options.items() if not users.hasName(k)}):
        yield
