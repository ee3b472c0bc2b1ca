# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Options, read in one place from PETSc's database under the solver's prefix.

Every option ``-feti_…`` is a field of :class:`FETIOptions`, with its default; docs/options.md says
what each is for. Options of PETSc's own that take numbers are checked here, too: PETSc's answer to
a wrong one is the number of an error.
"""

from __future__ import annotations

import difflib
import math
from dataclasses import dataclass, fields
from typing import Any, Literal, get_args, get_type_hints

from petsc4py import PETSc

#: Prefixes of the Krylov method for (λ, s), the factors of K_ρ and K_II, and the solver of N or A₀.
SUBSOLVERS = {
    "dual_": ("ksp_",),
    "local_": ("pc_", "mat_"),
    "dirichlet_": ("pc_", "mat_"),
    "coarse_": ("ksp_", "pc_", "mat_"),
}

#: What a number has to be, and the largest one; counts are whole.
COUNT, SHARE = "a whole number ≥ 0", "a number between 0 and 1"
BELOW_ONE, REAL = "a number ≥ 0 and < 1", "a number ≥ 0"
MOST = {COUNT: math.inf, SHARE: 1.0, BELOW_ONE: math.nextafter(1.0, 0.0), REAL: math.inf}

#: Numbers that a KSP or SNES reads, and what they have to be.
OUTER = (
    dict.fromkeys(("ksp_rtol", "snes_rtol"), BELOW_ONE)
    | dict.fromkeys(("ksp_atol", "ksp_divtol", "snes_atol", "snes_stol"), REAL)
    | dict.fromkeys(("ksp_max_it", "ksp_gmres_restart", "snes_max_it", "snes_max_funcs"), COUNT)
)


@dataclass(frozen=True, slots=True)
class FETIOptions:
    """Choices of one FETI solver.

    Attributes:
        type: Dirichlet dofs as rows of B, or fixed in the local matrices.
        formulation: Form of the method.
        pc_type: Preconditioner M.
        scaling: Weights of the copies.
        interior: Sparse factors of K, or dense Schur complements.
        coarse_q: Weight Q of the projection (dual).
        coarse_modes: Soft modes of a subdomain, at most.
        coarse_threshold: Share of the interface stiffness below which a mode is soft.
        coarse_adaptive: Columns of a subdomain that bound what averages cost, at most (primal).
        lag: Later matrices that a preconditioner of Newton's method serves, at most (primal).
        deflation: Ritz vectors that serve the later matrices, at most (primal).
    """

    type: Literal["all_floating", "classical"] = "all_floating"
    formulation: Literal["auto", "dual", "primal"] = "auto"
    pc_type: Literal["dirichlet", "lumped", "identity"] = "dirichlet"
    scaling: Literal["stiffness", "multiplicity"] = "stiffness"
    interior: Literal["auto", "keep", "eliminate"] = "auto"
    coarse_q: Literal["preconditioner", "diagonal", "identity"] = "preconditioner"
    coarse_modes: int = 12
    coarse_threshold: float = 0.01
    coarse_adaptive: int = 108
    lag: int = 6
    deflation: int = 20

    @property
    def all_floating(self) -> bool:
        """Whether Dirichlet dofs are rows of B."""
        return self.type == "all_floating"


KINDS = get_type_hints(FETIOptions)

#: The words that an option may take, the default first.
CHOICES = {name: get_args(kind) for name, kind in KINDS.items() if get_args(kind)}


def read_options(prefix: str) -> FETIOptions:
    """Read the options ``-<prefix>feti_…``.

    Raises:
        ValueError: A value is not among the choices or no number, an option does not exist, or two
            of them exclude each other.
    """
    check_outer_options(prefix)
    prefix += "feti_"
    values: dict[str, Any] = {}
    for field in fields(FETIOptions):
        name, default = field.name, field.default
        if name in CHOICES:
            values[name] = PETSc.Options(prefix).getString(name, default)
            if values[name] not in CHOICES[name]:
                raise _wrong(prefix, name, f"one of: {', '.join(CHOICES[name])}")
        else:
            values[name] = _number(prefix, name, COUNT if KINDS[name] is int else SHARE, default)
    _reject_unknown(prefix)
    options = FETIOptions(**values)
    if options.formulation == "primal" and options.pc_type != "dirichlet":
        raise ValueError(
            f"Options -{prefix}formulation primal and -{prefix}pc_type {options.pc_type} exclude "
            "each other: the primal form takes the dirichlet preconditioner. Let the formulation "
            "be dual or auto."
        )
    return options


def asks_for_dual(options: FETIOptions, prefix: str) -> bool:
    """Tell whether the options ask for the dual form, or for what it alone has; see Pattern."""
    if options.formulation != "auto":
        return options.formulation == "dual"
    own = PETSc.Options(prefix + "dual_")
    asked = any(own.hasName(f"ksp_{key}") for key in ("type", "rtol", "atol"))
    return asked or options.pc_type != "dirichlet"


def check_outer_options(prefix: str) -> None:
    """Check what PETSc's own KSP and SNES are to read, before they do.

    Raises:
        ValueError: A tolerance or a count is no such number, or another preconditioner is asked
            for.
    """
    for solver in (prefix, prefix + "feti_dual_", prefix + "feti_coarse_"):
        for name, wanted in OUTER.items():
            if wanted != COUNT or PETSc.Options(solver).getString(name, "") != "unlimited":
                _number(solver, name, wanted)
    pc_type = PETSc.Options(prefix).getString("pc_type", "none")
    if pc_type != "none":
        raise ValueError(
            f"Option -{prefix}pc_type is '{pc_type}', but no preconditioner of PETSc's fits a torn "
            f"matrix: leave it out. FETI has its own, -{prefix}feti_pc_type."
        )


def _number(prefix: str, name: str, wanted: str, default: Any = 0) -> int | float:
    """Read a number that is not negative."""
    options = PETSc.Options(prefix)
    try:
        read = options.getInt if wanted == COUNT else options.getReal
        value: int | float = read(name, default)
    except PETSc.Error:
        raise _wrong(prefix, name, wanted) from None
    if not 0 <= value <= MOST[wanted]:
        raise _wrong(prefix, name, wanted)
    return value


def _wrong(prefix: str, name: str, wanted: str) -> ValueError:
    value = PETSc.Options(prefix).getString(name)
    return ValueError(f"Option -{prefix}{name} is '{value}'; it takes {wanted}.")


def _reject_unknown(prefix: str) -> None:
    """Refuse an option that begins like ours, with ``…feti_``, and is none."""
    known = [field.name for field in fields(FETIOptions)]
    passed_on = tuple(solver + part for solver, parts in SUBSOLVERS.items() for part in parts)
    for key in PETSc.Options().getAll():
        name = key.removeprefix(prefix)
        if name == key or name in known or name.startswith(passed_on):
            continue
        close = difflib.get_close_matches(name, [*known, *passed_on], n=1)
        hint = f"did you mean -{prefix}{close[0]}" if close else "see docs/options.md"
        raise ValueError(f"Option -{key} does not exist; {hint}?")
