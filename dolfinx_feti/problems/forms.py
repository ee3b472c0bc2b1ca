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

from dolfinx_feti.fem.checks import check_condensed, check_nonlinear_forms
from dolfinx_feti.fem.quadrature import (
    estimated_quadrature_degree,
    limit_quadrature_degree,
    match_quadrature_degree,
)
from dolfinx_feti.problems.arguments import require_forms
from dolfinx_feti.runtime.collective import warn

__all__ = ["Forms", "condensed_fields", "default_volume_ratio", "derive", "warn_of_degree"]

#: How often twice the polynomial degree an estimated quadrature degree may be without a warning.
EXPLOSIVE = 3


@dataclass(frozen=True, slots=True)
class Forms:
    """The forms of a problem.

    Attributes:
        F_u: Residual tested with v.
        F_p: Residual of each field that is condensed, tested in its space.
        J: Tangent of F_u in u.
        energy: Their potential, if there is one.
        symmetric: True if J is the second derivative of an energy; None if nobody knows.
    """

    F_u: ufl.Form
    F_p: tuple[ufl.Form, ...]
    J: ufl.Form
    energy: ufl.Form | None
    symmetric: bool | None


def condensed_fields(
    condense: dolfinx.fem.Function | Sequence[dolfinx.fem.Function] | None,
) -> tuple[dolfinx.fem.Function, ...]:
    """Return the fields to be condensed: none, one, or several."""
    if condense is None:
        return ()
    return tuple(condense) if isinstance(condense, Sequence) else (condense,)


def derive(
    F: ufl.Form | Sequence[ufl.Form],
    u: dolfinx.fem.Function,
    *,
    J: ufl.Form | None,
    condense: Sequence[dolfinx.fem.Function],
    energy: ufl.Form | None,
    degree: int | None,
    work: Sequence[ufl.Form] = (),
) -> Forms:
    """Derive and check the forms.

    Args:
        F: Residual, residuals of u and of each condensed field, or energy.
        u: Unknown.
        J: Tangent, if given.
        condense: Fields to be condensed.
        energy: Potential in addition to residuals.
        degree: Highest quadrature degree of integrals that state none; None for no bound.
        work: What scalar unknowns add to the residual of u; an energy is no potential then.

    Raises:
        ValueError: The forms do not fit each other, or the unknowns.
        TypeError: A field cannot be condensed.
    """

    def limited(form: ufl.Form) -> ufl.Form:
        return form if degree is None else limit_quadrature_degree(form, degree)

    require_forms(**{} if isinstance(F, Sequence) else {"F": F})
    require_forms(**{n: f for n, f in {"J": J, "energy": energy}.items() if f is not None})
    check_condensed(condense, u)
    symmetric = True if J is None and isinstance(F, ufl.Form) and not F.arguments() else None
    energy = potential(F, energy)
    F_u, F_p = residuals(F, u, condense)
    if work:
        added = sum(work, ufl.Form([]))
        J = J if J is None else J + ufl.derivative(added, u, ufl.TrialFunction(u.function_space))
        F_u, energy, symmetric = F_u + added, None, None
    F_u, F_p = limited(F_u), tuple(map(limited, F_p))
    J = ufl.derivative(F_u, u, ufl.TrialFunction(u.function_space)) if J is None else J
    check_nonlinear_forms(F_u, J, u)
    if energy is not None:
        energy = match_quadrature_degree(limited(energy), F_u)
    return Forms(F_u, F_p, limited(J), energy, symmetric)


def warn_of_degree(forms: Forms, twice: int, comm: MPI.Comm) -> None:
    """Log a quadrature degree that UFL estimates far beyond use.

    Args:
        forms: The forms.
        twice: Twice the polynomial degree of the unknown.
        comm: Communicator of the problem.
    """
    degree = max(map(estimated_quadrature_degree, (forms.F_u, *forms.F_p)))
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
    F: ufl.Form | Sequence[ufl.Form],
    u: dolfinx.fem.Function,
    condense: Sequence[dolfinx.fem.Function],
) -> tuple[ufl.Form, tuple[ufl.Form, ...]]:
    """Return the residuals tested with v and, for each condensed field, with its q.

    Args:
        F: Residual, residuals, or energy.
        u: Unknown.
        condense: Fields to be condensed.

    Raises:
        ValueError: The forms do not fit ``condense``.
    """
    if not isinstance(F, ufl.Form):
        forms = list(F)
        wanted = [u.function_space, *(p.function_space for p in condense)]
        if not condense or len(forms) != len(wanted) or any(len(f.arguments()) != 1 for f in forms):
            raise ValueError(
                f"F is a sequence of {len(forms)} forms: give a residual tested with v and one for "
                "each condensed field, tested with its q, together with condense=p."
            )
        if [form.arguments()[0].ufl_function_space() for form in forms] != wanted:
            raise ValueError("F holds residuals on other spaces: test them with v in V and q in Q.")
        return forms[0], tuple(forms[1:])
    rank = len(F.arguments())
    if rank == 0 and u not in F.coefficients():
        raise ValueError(
            f"The unknown '{u.name}' does not occur in F: pass the Function that F is written in."
        )
    if rank > 1 or (rank == 1 and condense):
        raise ValueError(
            f"F has {rank} arguments: give a residual or an energy; with condense=p an energy "
            "Π(u, p) or the pair of its residuals."
        )
    if rank == 1:
        return F, ()
    F_u, *F_p = (ufl.derivative(F, f, ufl.TestFunction(f.function_space)) for f in (u, *condense))
    return F_u, tuple(F_p)


def default_volume_ratio(u: dolfinx.fem.Function) -> ufl.core.expr.Expr | None:
    """Return det(I + Grad u) of a displacement, None for another unknown."""
    gdim = u.function_space.mesh.geometry.dim
    if u.ufl_shape != (gdim,):
        return None
    return ufl.det(ufl.Identity(gdim) + ufl.grad(u))
