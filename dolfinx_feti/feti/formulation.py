# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Dual or primal: which form of the method a matrix is solved in.

Both share the factored subdomains. The dual form is the paper's; under load its system is
indefinite as soon as a subdomain would buckle alone, and GMRES has to solve it. The primal form
stays positive definite as long as the matrix is, and where a pressure is condensed its adaptive
columns halve the iterations. ``auto`` takes the primal form in these two cases, if the matrix is
symmetric, all K_ρ are positive definite, the preconditioner is that with Schur complements, and
nothing is asked for that only the dual form has: a Krylov method of its own, or recycled
directions.
"""

from __future__ import annotations

from petsc4py import PETSc

from dolfinx_feti.errors import SetUpError
from dolfinx_feti.feti.dual_form import DualForm, create_dual_form
from dolfinx_feti.feti.krylov.deflation import RitzVectors
from dolfinx_feti.feti.preconditioner.dirichlet import Dirichlet
from dolfinx_feti.feti.primal_form import PrimalForm, create_lagged_form, create_primal_form
from dolfinx_feti.feti.setup import Factored, Pattern, factor

__all__ = ["Form", "set_up", "set_up_lagged"]

Form = DualForm | PrimalForm


def set_up(
    pattern: Pattern,
    vectors: RitzVectors | None = None,
    *,
    most: int = 0,
    single: bool = False,
) -> Form:
    """Factor the present matrix and build a form of the method.

    Args:
        pattern: What depends on the pattern of the matrix.
        vectors: Ritz vectors that solves in the primal form with earlier matrices have left.
        most: Ritz vectors that a solve in that form leaves to later ones, at most.
        single: Whether that form stores the factors of K_ρ in single precision, where that does.

    Returns:
        The form; the caller destroys it before the pattern.

    Raises:
        SetUpError: A factorisation failed, a kernel is larger than its candidates, the assembled
            problem is singular, or the options do not fit the matrix.

    Note:
        Collective.
    """
    factored = factor(pattern, single=single and pattern.options.formulation != "dual")
    if _takes_primal(pattern, factored):
        return create_primal_form(pattern, factored, vectors, most=most)
    return create_dual_form(pattern, factored)


def set_up_lagged(
    pattern: Pattern, earlier: PrimalForm, vectors: RitzVectors | None = None
) -> PrimalForm:
    """Take the present matrix into the primal form, with the preconditioner of an earlier one.

    Args:
        pattern: What depends on the pattern of both matrices.
        earlier: The form of the matrix before, which is used up.
        vectors: Ritz vectors that solves with earlier matrices have left.

    Raises:
        SetUpError: A factorisation failed, or the assembled problem is singular.

    Note:
        Collective.
    """
    try:
        factored = factor(pattern, earlier.modes)
    except SetUpError:
        earlier.destroy()
        raise
    return create_lagged_form(pattern, factored, earlier, vectors)


def _takes_primal(pattern: Pattern, factored: Factored) -> bool:
    """Choose the form."""
    choice = pattern.options.formulation
    if choice != "auto":
        return choice == "primal"
    inertia = factored.inertia
    if inertia.local != 0 or not pattern.symmetric or pattern.options.recycle:
        return False
    if inertia.definite and pattern.torn.pressures is None:
        return False
    asked = any(PETSc.Options(pattern.prefix + "dual_").hasName(f"ksp_{key}") for key in ASKED)
    return isinstance(pattern.preconditioner, Dirichlet) and not asked


#: Options of the dual form's Krylov method that ask for the dual form.
ASKED = ("type", "rtol", "atol")
