# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Which of the two forms of the method solves.

The system of the dual form is indefinite as soon as a subdomain would buckle alone. ``auto`` takes
the primal form then, and where a pressure is condensed, if all K_ρ are positive definite; and with
an unsymmetric matrix. The preconditioner has to be Dirichlet's, and no dual Krylov method asked
for.
"""

from __future__ import annotations

from petsc4py import PETSc

from dolfinx_feti.feti.dual.form import DualForm
from dolfinx_feti.feti.inertia import Inertia
from dolfinx_feti.feti.pattern import Pattern
from dolfinx_feti.feti.primal.form import PrimalForm

__all__ = ["Form", "may_take_primal", "prefers_primal", "takes_primal"]

#: Options of the dual form's Krylov method that ask for the dual form.
ASKED = ("type", "rtol", "atol")

#: The method, set up for one matrix.
Form = DualForm | PrimalForm


def may_take_primal(pattern: Pattern) -> bool:
    """Tell whether the options allow the primal form."""
    choice = pattern.options.formulation
    if choice != "auto":
        return choice == "primal"
    asked = any(PETSc.Options(pattern.prefix + "dual_").hasName(f"ksp_{key}") for key in ASKED)
    return pattern.options.pc_type == "dirichlet" and not asked


def prefers_primal(pattern: Pattern) -> bool:
    """Tell whether a symmetric matrix takes the primal form unless a K_ρ is indefinite."""
    condensed = pattern.torn.pressures is not None
    return may_take_primal(pattern) and (condensed or pattern.options.formulation == "primal")


def takes_primal(pattern: Pattern, inertia: Inertia) -> bool:
    """Tell whether a symmetric matrix is solved in the primal form."""
    if pattern.options.formulation != "auto":
        return may_take_primal(pattern)
    safe = inertia.local == 0 and may_take_primal(pattern)
    return safe and (not inertia.definite or prefers_primal(pattern))
