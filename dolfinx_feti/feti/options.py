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
``-feti_dual_recycle``         0                                        directions left to later
                                                                        solves, at most
``-feti_local_…``              ``pc_factor_mat_solver_type …``          factors of K_ρ
``-feti_dirichlet_…``          ``pc_factor_mat_solver_type …``          factors of K_II
``-feti_coarse_…``             ``ksp_type``, ``pc_type``, …             solver of N
============================== ======================================== ============================

The first value is the default.
"""

from __future__ import annotations

import difflib
from dataclasses import dataclass

from petsc4py import PETSc

__all__ = ["FETIOptions", "read_options", "reject_other_solvers"]

CHOICES = {
    "type": ("all_floating", "classical"),
    "pc_type": ("dirichlet", "lumped", "identity", "none"),
    "scaling": ("stiffness", "multiplicity"),
    "coarse_q": ("preconditioner", "diagonal", "identity"),
    "gluing": ("full", "nonred"),
    "interior": ("auto", "keep", "eliminate"),
    "indefinite": ("enrich", "gmres", "error"),
}
NUMBERS = {"coarse_modes": 12, "stagnation": 200, "refine": 10, "dual_recycle": 0}
SHARES = {"coarse_threshold": 0.01}
SUBSOLVERS = {
    "dual_": ("ksp_",),
    "local_": ("pc_", "mat_"),
    "dirichlet_": ("pc_", "mat_"),
    "coarse_": ("ksp_", "pc_", "mat_"),
}


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
    coarse_modes: int = 12
    coarse_threshold: float = 0.01
    stagnation: int = 200
    refine: int = 10
    dual_recycle: int = 0

    @property
    def all_floating(self) -> bool:
        """Whether Dirichlet dofs are rows of B."""
        return self.type == "all_floating"


def read_options(prefix: str) -> FETIOptions:
    """Read the options ``-<prefix>feti_…``.

    Args:
        prefix: Prefix of the KSP, possibly empty.

    Raises:
        ValueError: A value is not among the choices, or an option does not exist.
    """
    options = PETSc.Options(prefix + "feti_")
    values: dict[str, str | int | float] = {}
    for name, choices in CHOICES.items():
        value = options.getString(name, choices[0])
        if value not in choices:
            raise ValueError(
                f"Option -{prefix}feti_{name} is '{value}'; it takes one of: {', '.join(choices)}."
            )
        values[name] = value
    for name, default in NUMBERS.items():
        number = options.getInt(name, default)
        if number < 0:
            raise ValueError(f"Option -{prefix}feti_{name} is {number}; it takes a number ≥ 0.")
        values[name] = number
    for name, fraction in SHARES.items():
        share = options.getReal(name, fraction)
        if not 0.0 <= share <= 1.0:
            raise ValueError(
                f"Option -{prefix}feti_{name} is {share}; it takes a number between 0 and 1."
            )
        values[name] = share
    _reject_unknown(prefix)
    return FETIOptions(**values)  # type: ignore[arg-type]


def _reject_unknown(prefix: str) -> None:
    """Refuse an option that begins like ours and is none."""
    known = [*CHOICES, *NUMBERS, *SHARES]
    passed_on = tuple(solver + part for solver, parts in SUBSOLVERS.items() for part in parts)
    for key in PETSc.Options().getAll():
        name = key.removeprefix(prefix + "feti_")
        if name == key or name in known or name.startswith(passed_on):
            continue
        close = difflib.get_close_matches(name, [*known, *passed_on], n=1)
        hint = f"did you mean -{prefix}feti_{close[0]}" if close else "see docs/options.md"
        raise ValueError(f"Option -{key} does not exist; {hint}?")


def reject_other_solvers(prefix: str) -> None:
    """Refuse options that would put another solver in the place of FETI or of Newton's method.

    Args:
        prefix: Prefix of the solver.

    Raises:
        ValueError: ``ksp_type`` or ``snes_type`` is set, and not to ``python``.
    """
    for name in ("ksp_type", "snes_type"):
        value = PETSc.Options(prefix).getString(name, "python")
        if value != "python":
            raise ValueError(
                f"Option -{prefix}{name} is '{value}', but only FETI solves a torn system: leave "
                f"it out. -{prefix}feti_dual_ksp_type chooses the Krylov method of the dual system."
            )
