# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The forms of a nonlinear problem: residuals, tangent and energy from what the user gives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mpi4py import MPI

import dolfinx
import ufl

from dolfinx_feti.fem.checks import check_nonlinear_forms, check_pressure_space
from dolfinx_feti.fem.quadrature import (
    estimated_quadrature_degree,
    limit_quadrature_degree,
    match_quadrature_degree,
)
from dolfinx_feti.problems.arguments import require_forms
from dolfinx_feti.runtime.collective import warn

__all__ = ["Forms", "default_volume_ratio", "derive", "warn_of_degree"]

#: How often twice the polynomial degree an estimated quadrature degree may be without a warning.
EXPLOSIVE = 3


@dataclass(frozen=True, slots=True)
class Forms:
    """The forms of a problem.

    Attributes:
        F_u: Residual tested with v.
        F_p: Residual tested with q, of a pressure that is condensed.
        J: Tangent of F_u in u.
        energy: Their potential, if there is one.
    """

    F_u: ufl.Form
    F_p: ufl.Form | None
    J: ufl.Form
    energy: ufl.Form | None


def derive(
    F: ufl.Form | Sequence[ufl.Form],
    u: dolfinx.fem.Function,
    *,
    J: ufl.Form | None,
    condense: dolfinx.fem.Function | None,
    energy: ufl.Form | None,
    degree: int | None,
) -> Forms:
    """Derive and check the forms.

    Args:
        F: Residual, pair of residuals, or energy.
        u: Unknown.
        J: Tangent, if given.
        condense: Pressure to be condensed.
        energy: Potential in addition to residuals.
        degree: Highest quadrature degree of integrals that state none; None for no bound.

    Raises:
        ValueError: The forms do not fit each other, or the unknowns.
        TypeError: The pressure is not piecewise constant.
    """

    def limited(form: ufl.Form) -> ufl.Form:
        return form if degree is None else limit_quadrature_degree(form, degree)

    require_forms(**{} if isinstance(F, Sequence) else {"F": F})
    require_forms(**{n: f for n, f in {"J": J, "energy": energy}.items() if f is not None})
    if condense is not None:
        check_pressure_space(condense.function_space)
    energy = potential(F, energy)
    F_u, F_p = residuals(F, u, condense)
    F_u, F_p = limited(F_u), None if F_p is None else limited(F_p)
    J = ufl.derivative(F_u, u, ufl.TrialFunction(u.function_space)) if J is None else J
    check_nonlinear_forms(F_u, J, u)
    if energy is not None:
        energy = match_quadrature_degree(limited(energy), F_u)
    return Forms(F_u, F_p, limited(J), energy)


def warn_of_degree(forms: Forms, twice: int, comm: MPI.Comm) -> None:
    """Log a quadrature degree that UFL estimates far beyond use.

    Args:
        forms: The forms.
        twice: Twice the polynomial degree of the unknown.
        comm: Communicator of the problem.
    """
    residuals = [form for form in (forms.F_u, forms.F_p) if form is not None]
    degree = max(map(estimated_quadrature_degree, residuals))
    if degree > EXPLOSIVE * twice:
        warn(
            f"UFL estimates a quadrature degree of {degree} for F, which is slow to compile and to "
            f"assemble: give quadrature_degree={twice}, twice the polynomial degree, or state a "
            "degree in the measures.",
            comm,
        )


def potential(F: ufl.Form | Sequence[ufl.Form], energy: ufl.Form | None) -> ufl.Form | None:
    """Return the potential of the problem: F itself if that is an energy, or ``energy``.

    Raises:
        ValueError: Both are given, and differ.
    """
    if not isinstance(F, ufl.Form) or F.arguments():
        return energy
    if energy is not None and not F.equals(energy):
        raise ValueError(
            "energy is not F, which is an energy itself and the one that is minimised: leave "
            "energy out, or give the residuals as F."
        )
    return F


def residuals(
    F: ufl.Form | Sequence[ufl.Form], u: dolfinx.fem.Function, p: dolfinx.fem.Function | None
) -> tuple[ufl.Form, ufl.Form | None]:
    """Return the residuals tested with v and, for a condensed pressure, with q.

    Args:
        F: Residual, pair of residuals, or energy.
        u: Unknown.
        p: Pressure to be condensed.

    Raises:
        ValueError: The forms do not fit ``condense``.
    """
    if not isinstance(F, ufl.Form):
        forms = list(F)
        if p is None or len(forms) != 2 or any(len(form.arguments()) != 1 for form in forms):
            raise ValueError(
                f"F is a sequence of {len(forms)} forms: give two residuals, tested with v and "
                "with q, together with condense=p."
            )
        spaces = [form.arguments()[0].ufl_function_space() for form in forms]
        if spaces != [u.function_space, p.function_space]:
            raise ValueError("F holds residuals on other spaces: test them with v in V and q in Q.")
        return forms[0], forms[1]
    rank = len(F.arguments())
    if rank == 0 and u not in F.coefficients():
        raise ValueError(
            f"The unknown '{u.name}' does not occur in F: pass the Function that F is written in."
        )
    if rank > 1 or (rank == 1 and p is not None):
        raise ValueError(
            f"F has {rank} arguments: give a residual or an energy; with condense=p an energy "
            "Π(u, p) or the pair of its residuals."
        )
    if rank == 1:
        return F, None
    F_u = ufl.derivative(F, u, ufl.TestFunction(u.function_space))
    if p is None:
        return F_u, None
    return F_u, ufl.derivative(F, p, ufl.TestFunction(p.function_space))


def default_volume_ratio(u: dolfinx.fem.Function) -> ufl.core.expr.Expr | None:
    """Return det(I + Grad u) of a displacement, None for another unknown."""
    gdim = u.function_space.mesh.geometry.dim
    if u.ufl_shape != (gdim,):
        return None
    return ufl.det(ufl.Identity(gdim) + ufl.grad(u))
