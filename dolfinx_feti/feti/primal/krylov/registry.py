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
            formulation takes over if the matrix turns out to be indefinite. This flag has no effect
            on which method is used.
    """

    solve: KrylovMethod
    needs_symmetric: bool
    solves_indefinite: bool


#: The methods by PETSc's names for them, if it has them. The first one that serves a matrix solves,
#: so that the order matters: no option chooses among them.
KRYLOV_METHODS: dict[str, RegisteredMethod] = {
    "cg": RegisteredMethod(conjugate_gradients, needs_symmetric=True, solves_indefinite=False),
    "gmres": RegisteredMethod(gmres, needs_symmetric=False, solves_indefinite=True),
}


def select_method(*, is_symmetric: bool) -> str:
    """Return the name of the method for a matrix."""
    names = [
        name
        for name, method in KRYLOV_METHODS.items()
        if is_symmetric or not method.needs_symmetric
    ]
    return names[0]
