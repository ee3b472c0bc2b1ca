# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Pressures of incompressible bodies get a term in their own equation, which has none.

.. math:: F_p = c\, g(u)\, q \quad→\quad c\, g(u)\, q - γ\, p\, q

with the constraint g, such as J − 1 or div u, and the compliance γ = c/κ (``incompressible``). The
term is that of a slightly compressible material; multipliers remove its effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

import dolfinx
import ufl


@dataclass(frozen=True, slots=True)
class Compression:
    r"""The term :math:`-γ\, p\, q` that makes an incompressible field solvable.

    With γ = c/κ and F_p = c g q, the solution is p = κ g. Multipliers replace p in this term, so
    that g = 0.

    Attributes:
        compliance: γ; one until it is chosen.
        terms: −γ p q for each condensed field, (fields,); None for a field that needs none.
    """

    compliance: dolfinx.fem.Constant
    terms: tuple[ufl.Form | None, ...]

    @property
    def numbers(self) -> list[int]:
        """Numbers of the fields that have the term."""
        return [i for i, term in enumerate(self.terms) if term is not None]


def with_compression(
    u: dolfinx.fem.Function,
    fields: Sequence[dolfinx.fem.Function],
    F_u: ufl.Form,
    F_p: Sequence[ufl.Form],
    blocks: Sequence[Sequence[ufl.Form | None]] | None,
) -> tuple[list[ufl.Form], Sequence[Sequence[ufl.Form | None]] | None, Compression | None]:
    """Add terms to the equations of incompressible fields.

    A field counts as incompressible if it is a scalar, such as a pressure; if its equation contains
    u but none of the fields; and if F_u contains the field.

    Args:
        u: The unknown.
        fields: Condensed fields.
        F_u: Residual of u.
        F_p: Residual of each of them.
        blocks: Blocks of the tangent in u and the fields, each None if it is zero; None if all of
            them are to be derived.

    Returns:
        The residuals with the added terms, the blocks with their derivatives, and the terms; None
        instead of these if no field is incompressible.
    """
    are_incompressible = []
    for i, (F, p) in enumerate(zip(F_p, fields, strict=True)):
        if blocks is None:
            row = [ufl.derivative(F, other) for other in fields]
            constraint: ufl.Form | None = ufl.derivative(F, u)
            force: ufl.Form | None = ufl.derivative(F_u, p)
        else:
            constraint, *row = blocks[i + 1]
            force = blocks[0][i + 1]
        has_no_term = not p.ufl_shape and all(map(_is_zero, row))
        are_incompressible.append(has_no_term and not _is_zero(constraint) and not _is_zero(force))
    if not any(are_incompressible):
        return list(F_p), blocks, None
    mesh = u.function_space.mesh
    γ = dolfinx.fem.Constant(mesh, np.float64(1.0))
    dx = ufl.Measure("dx", mesh)
    terms: list[ufl.Form | None] = []
    for p, is_incompressible in zip(fields, are_incompressible, strict=True):
        q = ufl.TestFunction(p.function_space)
        terms.append(-γ * p * q * dx if is_incompressible else None)
    F_p = [F if term is None else F + term for F, term in zip(F_p, terms, strict=True)]
    if blocks is not None:
        rows = [list(row) for row in blocks]
        for i, (p, term) in enumerate(zip(fields, terms, strict=True), start=1):
            if term is not None:
                rows[i][i] = ufl.derivative(term, p, ufl.TrialFunction(p.function_space))
        blocks = rows
    return F_p, blocks, Compression(γ, tuple(terms))


def _is_zero(form: ufl.Form | None) -> bool:
    """Return True if a block is zero."""
    return form is None or ufl.algorithms.expand_derivatives(form).empty()


def potential_of(compression: Compression, fields: Sequence[dolfinx.fem.Function]) -> ufl.Form:
    """Return the potential of the added terms, −γ p²/2."""
    parts = [
        ufl.replace(term, {term.arguments()[0]: 0.5 * p})
        for term, p in zip(compression.terms, fields, strict=True)
        if term is not None
    ]
    return sum(parts[1:], parts[0])
