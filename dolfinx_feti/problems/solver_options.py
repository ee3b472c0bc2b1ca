# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Options of PETSc's solvers that have no effect here, or are refused.

A problem has a SNES and a KSP with contexts of this package. Options that choose another solver, or
belong to a solver that is not used, are logged once.
"""

from __future__ import annotations

from petsc4py import PETSc

#: Options that choose a solver, and the one value that changes nothing here.
SOLVER_CHOICES = {
    "ksp_type": "python",
    "ksp_python_type": "dolfinx_feti.FETI",
    "pc_type": "none",
    "snes_type": "python",
    "snes_python_type": "dolfinx_feti.problems.newton.Newton",
}

#: Prefix of the types of PETSc's solvers of variational inequalities.
VARIATIONAL_PREFIX = "vi"

#: End of the messages of options and functions that set bounds on the unknown.
BOUNDS_TEXT = (
    "asks for bounds on the unknown (a variational inequality), which this Newton's method does "
    "not keep. Write the bound into F as a penalty on the overlap, such as "
    "k*(u - low - abs(u - low))/2, or solve with dolfinx.fem.petsc.NonlinearProblem and "
    "snes_type vinewtonrsls."
)

#: Options that set the accuracy of linear solves. If one is given, all linear solves of Newton's
#: method have that accuracy, even if a step does not need it.
LINEAR_TOLERANCE_OPTIONS = ("ksp_rtol", "ksp_atol", "snes_ksp_ew")

#: Prefixes of options of solvers that are not used here.
FOREIGN_PREFIXES = ("pc_", "mat_", "mg_", "snes_linesearch_")

#: Prefixes of options that PETSc reads without effect here. Newton's method has its own tangent,
#: step length and divergence; each formulation of FETI has its own start, norm and side.
INEFFECTIVE_PREFIXES = (
    "snes_divergence_tolerance",
    "snes_fd",
    "snes_force_iteration",
    "snes_lag_",
    "snes_max_fail",
    "snes_max_funcs",
    "snes_max_linear_solve_fail",
    "snes_mf",
    "snes_norm_schedule",
    "snes_npc_",
    "snes_stol",
    "snes_trtol",
    "ksp_check_norm_iteration",
    "ksp_converged_",
    "ksp_diagonal_scale",
    "ksp_divtol",
    "ksp_gmres_",
    "ksp_guess_",
    "ksp_initial_guess_",
    "ksp_knoll",
    "ksp_lag_norm",
    "ksp_min_it",
    "ksp_norm_type",
    "ksp_pc_side",
    "ksp_reuse_preconditioner",
)

#: Prefixes of options that have an effect although they begin with one of the prefixes above.
EFFECTIVE_PREFIXES = ("ksp_converged_reason", "ksp_converged_rate")

#: Values of ``-ksp_view`` that select the screen and no other format.
PLAIN_VIEWS = ("", "ascii", "true", "1")


def options_without_effect(prefix: str) -> dict[str, str]:
    """Return the options under a prefix that belong to another solver, with their values.

    The prefix is not part of the keys. A flag has the value "".
    """
    ineffective = {}
    for key, value in PETSc.Options().getAll().items():
        if not key.startswith(prefix):
            continue
        name = key.removeprefix(prefix)
        if not _has_effect(name, value):
            ineffective[name] = value or ""  # PETSc returns None for a flag
    return ineffective


def _has_effect(name: str, value: str | None) -> bool:
    """Return True if an option without prefix has an effect on the solvers of a problem."""
    if name in SOLVER_CHOICES:
        return value == SOLVER_CHOICES[name]
    if name.startswith(EFFECTIVE_PREFIXES):
        return True
    return not name.startswith((*FOREIGN_PREFIXES, *INEFFECTIVE_PREFIXES))


def require_no_bounds(prefix: str) -> None:
    """Check that no option selects a solver of variational inequalities.

    Raises:
        ValueError: ``snes_type`` begins with ``vi``.
    """
    kind = PETSc.Options(prefix).getString("snes_type", "")
    if kind.startswith(VARIATIONAL_PREFIX):
        raise ValueError(f"Option -{prefix}snes_type {kind} {BOUNDS_TEXT}")
