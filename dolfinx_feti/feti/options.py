# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Options, read in one place from PETSc's database under the solver's prefix.

============================== ======================================== ============================
``-feti_type``                 ``all_floating``, ``classical``          Dirichlet dofs as rows of B
``-feti_pc_type``              ``dirichlet``, ``lumped``, ``identity``, preconditioner M
                               ``none``
``-feti_scaling``              ``stiffness``, ``multiplicity``          weights of B_D
``-feti_coarse_q``             ``preconditioner``, ``diagonal``,        weight Q of the projection
                               ``identity``
``-feti_gluing``               ``full``, ``nonred``                     redundancy of B
``-feti_interior``             ``auto``, ``keep``, ``eliminate``        sparse factors of K or dense
                                                                        Schur complements
``-feti_indefinite``           ``enrich``, ``gmres``, ``error``         subdomains with a negative
                                                                        eigenvalue: enrich R, leave
                                                                        it to GMRES, or refuse
``-feti_coarse_modes``         12                                       soft modes of a subdomain in
                                                                        the coarse space, at most
``-feti_coarse_threshold``     0.01                                     share of its interface
                                                                        stiffness that is soft
``-feti_stagnation``           200                                      iterations without gain
``-feti_refine``               10                                       restarts on the residual of
                                                                        the assembled system
``-feti_dual_…``               ``ksp_type cg|gmres|fgmres|…``           Krylov method for (λ, s)
``-feti_formulation``          ``auto``, ``dual``, ``primal``           form of the method
``-feti_coarse_adaptive``      36                                       columns of a subdomain that
                                                                        bound what averages cost, at
                                                                        most (primal)
``-feti_coarse_bound``         1.1                                      that bound
``-feti_lag``                  6                                        later matrices of Newton's
                                                                        method that K_ρ⁻¹ and the
                                                                        coarse columns serve, at
                                                                        most (primal)
``-feti_deflation``            20                                       Ritz vectors of small
                                                                        eigenvalues that serve the
                                                                        later matrices, at most
                                                                        (primal)
``-feti_precision``            ``double``, ``single``                   in which the factors of K_ρ
                                                                        are stored (primal)
``-feti_recycle``              0                                        directions left to later
                                                                        solves, at most
``-feti_local_…``              ``pc_factor_mat_solver_type …``          factors of K_ρ
``-feti_dirichlet_…``          ``pc_factor_mat_solver_type …``          factors of K_II
``-feti_coarse_…``             ``ksp_type``, ``pc_type``, …             solver of N
============================== ======================================== ============================

The first value is the default. Options of PETSc's own that take numbers are checked here, too:
PETSc's answer to a wrong one is the number of an error.
"""

from __future__ import annotations

import difflib
import math
from dataclasses import dataclass

from petsc4py import PETSc

__all__ = [
    "SOLVERS",
    "FETIOptions",
    "check_outer_options",
    "options_without_effect",
    "read_options",
]

CHOICES = {
    "type": ("all_floating", "classical"),
    "pc_type": ("dirichlet", "lumped", "identity", "none"),
    "scaling": ("stiffness", "multiplicity"),
    "coarse_q": ("preconditioner", "diagonal", "identity"),
    "gluing": ("full", "nonred"),
    "interior": ("auto", "keep", "eliminate"),
    "indefinite": ("enrich", "gmres", "error"),
    "formulation": ("auto", "dual", "primal"),
    "precision": ("double", "single"),
}
NUMBERS = {
    "coarse_modes": 12,
    "stagnation": 200,
    "refine": 10,
    "coarse_adaptive": 36,
    "lag": 6,
    "deflation": 20,
    "recycle": 0,
}
SHARES = {"coarse_threshold": 0.01}
BOUNDS = {"coarse_bound": 1.1}
SUBSOLVERS = {
    "dual_": ("ksp_",),
    "local_": ("pc_", "mat_"),
    "dirichlet_": ("pc_", "mat_"),
    "coarse_": ("ksp_", "pc_", "mat_"),
}

#: Numbers that a KSP or SNES reads: shares below one, other numbers, and counts.
RELATIVE = ("ksp_rtol", "snes_rtol")
NOT_NEGATIVE = ("ksp_atol", "ksp_divtol", "snes_atol", "snes_stol")
COUNTS = ("ksp_max_it", "ksp_gmres_restart", "snes_max_it", "snes_max_funcs")
BELOW_ONE = math.nextafter(1.0, 0.0)

#: Options that choose a solver, and the one value that changes nothing here.
SOLVERS = {
    "ksp_type": "python",
    "ksp_python_type": "dolfinx_feti.FETI",
    "pc_type": "none",
    "snes_type": "python",
    "snes_python_type": "dolfinx_feti.problems.newton.Newton",
}

#: How options of solvers begin that have no place here.
FOREIGN = ("pc_", "mat_", "mg_", "snes_linesearch_")


@dataclass(frozen=True, slots=True)
class FETIOptions:
    """Choices of one FETI solver; see the table of this module."""

    type: str = "all_floating"
    pc_type: str = "dirichlet"
    scaling: str = "stiffness"
    coarse_q: str = "preconditioner"
    gluing: str = "full"
    interior: str = "auto"
    indefinite: str = "enrich"
    formulation: str = "auto"
    precision: str = "double"
    coarse_modes: int = 12
    coarse_threshold: float = 0.01
    stagnation: int = 200
    refine: int = 10
    coarse_adaptive: int = 36
    coarse_bound: float = 1.1
    lag: int = 6
    deflation: int = 20
    recycle: int = 0

    @property
    def all_floating(self) -> bool:
        """Whether Dirichlet dofs are rows of B."""
        return self.type == "all_floating"


def read_options(prefix: str) -> FETIOptions:
    """Read the options ``-<prefix>feti_…``.

    Args:
        prefix: Prefix of the KSP, possibly empty.

    Raises:
        ValueError: A value is not among the choices or no number, or an option does not exist.
    """
    check_outer_options(prefix)
    prefix += "feti_"
    values: dict[str, str | int | float] = {}
    for name, choices in CHOICES.items():
        value = PETSc.Options(prefix).getString(name, choices[0])
        if value not in choices:
            raise ValueError(
                f"Option -{prefix}{name} is '{value}'; it takes one of: {', '.join(choices)}."
            )
        values[name] = value
    for name, count in NUMBERS.items():
        values[name] = _count(prefix, name, count)
    for name, share in SHARES.items():
        values[name] = _real(prefix, name, share, "a number between 0 and 1", 1.0)
    for name, bound in BOUNDS.items():
        values[name] = _real(prefix, name, bound, "a number ≥ 0", math.inf)
    _reject_unknown(prefix)
    return FETIOptions(**values)  # type: ignore[arg-type]


def check_outer_options(prefix: str) -> None:
    """Check what PETSc's own KSP and SNES are to read, before they do.

    Args:
        prefix: Prefix of the KSP, possibly empty.

    Raises:
        ValueError: A tolerance or a count is no such number, or another preconditioner is asked
            for.
    """
    for solver in (prefix, prefix + "feti_dual_", prefix + "feti_coarse_"):
        for name in RELATIVE:
            _real(solver, name, 0.0, "a number ≥ 0 and < 1", BELOW_ONE)
        for name in NOT_NEGATIVE:
            _real(solver, name, 0.0, "a number ≥ 0", math.inf)
        for name in COUNTS:
            _count(solver, name, 0)
    pc_type = PETSc.Options(prefix).getString("pc_type", "none")
    if pc_type != "none":
        raise ValueError(
            f"Option -{prefix}pc_type is '{pc_type}', but no preconditioner of PETSc's fits a torn "
            f"matrix: leave it out. FETI has its own, -{prefix}feti_pc_type."
        )


def options_without_effect(prefix: str) -> dict[str, str]:
    """Find options that belong to another solver than FETI and Newton's method.

    Args:
        prefix: Prefix of the solver, not empty.

    Returns:
        Their values, by their names without the prefix.
    """
    under = {
        key.removeprefix(prefix): value
        for key, value in PETSc.Options().getAll().items()
        if key.startswith(prefix)
    }
    return {
        name: value
        for name, value in under.items()
        if (name not in SOLVERS and name.startswith(FOREIGN)) or value != SOLVERS.get(name, value)
    }


def _count(prefix: str, name: str, default: int) -> int:
    """Read a number of things."""
    wanted = "a whole number ≥ 0"
    try:
        count = PETSc.Options(prefix).getInt(name, default)
    except PETSc.Error:
        raise _wrong(prefix, name, wanted) from None
    if count < 0:
        raise _wrong(prefix, name, wanted)
    return count


def _real(prefix: str, name: str, default: float, wanted: str, most: float) -> float:
    """Read a number between zero and another one."""
    try:
        value = PETSc.Options(prefix).getReal(name, default)
    except PETSc.Error:
        raise _wrong(prefix, name, wanted) from None
    if not 0.0 <= value <= most:
        raise _wrong(prefix, name, wanted)
    return value


def _wrong(prefix: str, name: str, wanted: str) -> ValueError:
    value = PETSc.Options(prefix).getString(name)
    return ValueError(f"Option -{prefix}{name} is '{value}'; it takes {wanted}.")


def _reject_unknown(prefix: str) -> None:
    """Refuse an option that begins like ours and is none.

    Args:
        prefix: That of the solver and ``feti_``.
    """
    known = [*CHOICES, *NUMBERS, *SHARES, *BOUNDS]
    passed_on = tuple(solver + part for solver, parts in SUBSOLVERS.items() for part in parts)
    for key in PETSc.Options().getAll():
        name = key.removeprefix(prefix)
        if name == key or name in known or name.startswith(passed_on):
            continue
        close = difflib.get_close_matches(name, [*known, *passed_on], n=1)
        hint = f"did you mean -{prefix}{close[0]}" if close else "see docs/options.md"
        raise ValueError(f"Option -{key} does not exist; {hint}?")
