# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Forms of a problem with the conditions on the surfaces of a wall.

.. math:: F_u = \frac{∂Π}{∂u} + F_Γ, \qquad F_p = \frac{∂Π}{∂p}, \qquad
          J = \frac{∂^2 Π}{∂u^2} + J_Γ, \qquad Π + Π_Γ,

with residual F_Γ, tangent J_Γ and, if there is one, potential Π_Γ of
:class:`~dolfinx_feti.wall.conditions.boundary.Boundary`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import dolfinx
import ufl

from dolfinx_feti.fem.user_forms.checks import check_trial_functions
from dolfinx_feti.problems.arguments import require_form
from dolfinx_feti.runtime.values import require_type
from dolfinx_feti.wall.conditions.boundary import Boundary


@dataclass(frozen=True, slots=True)
class FormsWithBoundary:
    """Arguments of ``NonlinearProblem`` that contain the conditions of a wall.

    Attributes:
        F: Residuals of u and of the condensed fields.
        J: Tangent, or its blocks.
        energy: Potential of the residuals; None if there is none.
        bcs: Dirichlet conditions.
    """

    F: list[ufl.Form]
    J: ufl.Form | list[list[ufl.Form | None]]
    energy: ufl.Form | None
    bcs: list[dolfinx.fem.DirichletBC]


def add_boundary(
    boundary: Boundary,
    F: ufl.Form | Sequence[ufl.Form],
    u: dolfinx.fem.Function | Sequence[dolfinx.fem.Function],
    bcs: Sequence[dolfinx.fem.DirichletBC] | None,
    J: ufl.Form | Sequence[Sequence[ufl.Form | None]] | None,
    *,
    condense: Sequence[dolfinx.fem.Function],
    energy: ufl.Form | None,
) -> FormsWithBoundary:
    """Return the arguments of a problem with the conditions of a wall added.

    Args:
        boundary: The conditions.
        F: Energy, residual, or residuals of u and of the condensed fields, without the conditions.
        u: The displacement that the conditions were applied to.
        bcs: Further Dirichlet conditions.
        J: Tangent of F in u, or its blocks; derived if None.
        condense: Condensed fields.
        energy: Potential of F, if F holds residuals that have one.

    Raises:
        TypeError: ``boundary`` is no Boundary.
        ValueError: The conditions were applied to another function than u.
    """
    require_type(Boundary, boundary=boundary)
    if not isinstance(u, dolfinx.fem.Function) or not _is_of(boundary, u):
        raise ValueError(
            "boundary holds conditions on another displacement: pass the same u to "
            "apply_conditions(wall, u, …) and to the problem, as its only unknown; a pressure goes "
            "into condense=."
        )
    residuals = list(F) if isinstance(F, Sequence) else [F]
    for form in residuals:
        require_form("F", form)
    check_trial_functions(F=residuals, energy=energy)
    if len(residuals) == 1 and not residuals[0].arguments():
        energy = residuals[0]
        fields = (u, *condense)
        residuals = [
            ufl.derivative(energy, field, ufl.TestFunction(field.function_space))
            for field in fields
        ]
    if J is None:
        J = ufl.derivative(residuals[0], u, ufl.TrialFunction(u.function_space))
    potential = None
    if energy is not None and boundary.energy is not None:
        potential = energy + boundary.energy
    return FormsWithBoundary(
        F=[residuals[0] + boundary.residual, *residuals[1:]],
        J=_added(J, boundary.tangent),
        energy=potential,
        bcs=[*boundary.bcs, *(bcs or ())],
    )


def _is_of(boundary: Boundary, u: dolfinx.fem.Function) -> bool:
    """Return True if conditions were applied to u."""
    if u.function_space != boundary.last.function_space:
        return False
    return boundary.residual.empty() or u in boundary.residual.coefficients()


def _added(
    J: ufl.Form | Sequence[Sequence[ufl.Form | None]], tangent: ufl.Form
) -> ufl.Form | list[list[ufl.Form | None]]:
    """Return a tangent, or its blocks, with a form added to that of u in u."""
    if isinstance(J, ufl.Form):
        return J + tangent
    blocks = [list(row) for row in J]
    blocks[0][0] = tangent if blocks[0][0] is None else blocks[0][0] + tangent
    return blocks
