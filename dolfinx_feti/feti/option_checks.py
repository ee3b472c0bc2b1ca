# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Checks of options in PETSc's database: types of numbers, and options that PETSc itself reads.

PETSc reports a wrong value of its own options by an error number. They are checked here before
PETSc reads them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from petsc4py import PETSc

from dolfinx_feti.feti.subsolver_options import COARSE_PREFIX, DUAL_PREFIX

#: Krylov methods of the dual form. PETSc's other ones need transposed products, do not give access
#: to the iterate in each iteration, or were not tested against a direct solver. ``dual.krylov``
#: runs them: its head says what a new one needs.
DUAL_METHODS = ("cg", "fcg", "groppcg", "pipecg", "cr", "minres", "gmres", "fgmres")


@dataclass(frozen=True, slots=True)
class NumberKind:
    """A kind of numbers ≥ 0 that an option may take.

    Attributes:
        description: What it is, for the error message.
        is_count: Whether it is a whole number.
        upper_bound: Largest number.
        includes_bound: Whether the upper bound itself is allowed.
    """

    description: str
    is_count: bool = False
    upper_bound: float = math.inf
    includes_bound: bool = True

    def contains(self, value: float) -> bool:
        """Return True if a number is of this kind."""
        if value == self.upper_bound:
            return self.includes_bound
        return 0 <= value < self.upper_bound


COUNT = NumberKind("a whole number ≥ 0", is_count=True)
SHARE = NumberKind("a number between 0 and 1", upper_bound=1.0)
BELOW_ONE = NumberKind("a number ≥ 0 and < 1", upper_bound=1.0, includes_bound=False)
NOT_NEGATIVE = NumberKind("a number ≥ 0")

#: Numbers that PETSc's KSP and SNES read, for the outer solvers and for sub-solvers.
PETSC_NUMBERS = {
    "ksp_rtol": BELOW_ONE,
    "snes_rtol": BELOW_ONE,
    "ksp_atol": NOT_NEGATIVE,
    "ksp_divtol": NOT_NEGATIVE,
    "snes_atol": NOT_NEGATIVE,
    "snes_stol": NOT_NEGATIVE,
    "ksp_max_it": COUNT,
    "snes_max_it": COUNT,
    "snes_max_funcs": COUNT,
    "ksp_gmres_restart": COUNT,
    "ksp_fcg_mmax": COUNT,
}


def check_petsc_options(prefix: str) -> None:
    """Check the numbers that PETSc's KSP and SNES are about to read, and the preconditioner.

    Args:
        prefix: Options prefix of the KSP.

    Raises:
        ValueError: A number is not of its kind, the dual form does not support the Krylov method,
            the method has no norm to test, or ``pc_type`` names a preconditioner of PETSc's.
    """
    for solver in (prefix, f"{prefix}feti_{DUAL_PREFIX}", f"{prefix}feti_{COARSE_PREFIX}"):
        for name, kind in PETSC_NUMBERS.items():
            is_unlimited = PETSc.Options(solver).getString(name, "") == "unlimited"
            if not (kind.is_count and is_unlimited):
                read_number(solver, name, kind, 0)  # raises the error; PETSc reads the value
    _check_dual_method(f"{prefix}feti_{DUAL_PREFIX}")
    pc_type = PETSc.Options(prefix).getString("pc_type", "none")
    if pc_type != "none":
        raise ValueError(
            f"Option -{prefix}pc_type is '{pc_type}', but no preconditioner of PETSc's fits a torn "
            f"matrix: leave it out. FETI has its own, -{prefix}feti_pc_type."
        )


def _check_dual_method(prefix: str) -> None:
    """Check that the dual form supports the Krylov method, and that the method computes a norm.

    Args:
        prefix: Options prefix of the method, ``…feti_dual_``.

    Raises:
        ValueError: The dual form does not support the method, or it computes no norm.
    """
    options = PETSc.Options(prefix)
    if options.getString("ksp_type", "cg") not in DUAL_METHODS:
        raise wrong_value(prefix, "ksp_type", f"one of: {', '.join(DUAL_METHODS)}")
    if options.getString("ksp_norm_type", "default") == "none":
        raise wrong_value(prefix, "ksp_norm_type", "a norm that can be tested")


def read_number(prefix: str, name: str, kind: NumberKind, default: float) -> float:
    """Read a number of a kind; an int for a count.

    Raises:
        ValueError: It is not of the kind.
    """
    options = PETSc.Options(prefix)
    read = options.getInt if kind.is_count else options.getReal
    try:
        value: float = read(name, default)
    except PETSc.Error:
        raise wrong_value(prefix, name, kind.description) from None
    if not kind.contains(value):
        raise wrong_value(prefix, name, kind.description)
    return value


def wrong_value(prefix: str, name: str, expected: str) -> ValueError:
    """Return the error for an option with a value other than expected."""
    value = PETSc.Options(prefix).getString(name)
    return ValueError(f"Option -{prefix}{name} is '{value}'; it takes {expected}.")
