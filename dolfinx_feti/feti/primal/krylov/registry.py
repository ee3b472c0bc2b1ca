# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The Krylov methods of the primal formulation by name, and the choice among them."""

from __future__ import annotations

from dataclasses import dataclass

from dolfinx_feti.feti.primal.krylov.base import KrylovMethod
from dolfinx_feti.feti.primal.krylov.conjugate_gradients import conjugate_gradients
from dolfinx_feti.feti.primal.krylov.gmres import gmres


@dataclass(frozen=True, slots=True)
class RegisteredMethod:
    """A Krylov method, and the matrices that it solves with.

    Attributes:
        solve: The method.
        needs_symmetric: Whether it solves with symmetric matrices only.
        solves_indefinite: Whether it also solves with indefinite matrices. If not, the dual
            formulation takes over if the matrix turns out to be indefinite.
    """

    solve: KrylovMethod
    needs_symmetric: bool
    solves_indefinite: bool


#: The methods by PETSc's names for them, if it has them. The order matters: :func:`select_method`
#: chooses the first one that is suitable.
KRYLOV_METHODS: dict[str, RegisteredMethod] = {
    "cg": RegisteredMethod(conjugate_gradients, needs_symmetric=True, solves_indefinite=False),
    "gmres": RegisteredMethod(gmres, needs_symmetric=False, solves_indefinite=True),
}


def select_method(*, is_symmetric: bool, is_indefinite: bool) -> str:
    """Return the name of the method for a matrix.

    It is the first one that is made for the symmetry of the matrix, and for an indefinite matrix
    the first of them that solves with it, if there is one.

    Args:
        is_symmetric: Whether the matrix is symmetric.
        is_indefinite: Whether the coarse space proves that it has negative eigenvalues.
    """
    names = [
        name for name, method in KRYLOV_METHODS.items() if method.needs_symmetric == is_symmetric
    ]
    if is_indefinite:
        for name in names:
            if KRYLOV_METHODS[name].solves_indefinite:
                return name
    return names[0]
