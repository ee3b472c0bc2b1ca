# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What the forms of a problem hold: unknowns, coefficients, constants, and their signature."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import dolfinx
import ufl

__all__ = ["Content", "content_of"]


@dataclass(frozen=True, slots=True)
class Content:
    """What the forms of a problem hold.

    Attributes:
        unknowns: u and the fields that are condensed.
        coefficients: All Functions in the forms.
        constants: All Constants in them, in the order of their creation.
        forms: The forms.
    """

    unknowns: tuple[dolfinx.fem.Function, ...]
    coefficients: tuple[dolfinx.fem.Function, ...] = ()
    constants: tuple[dolfinx.fem.Constant, ...] = ()
    forms: tuple[ufl.Form, ...] = ()

    def signature(self) -> str:
        """Return a number of the forms, which values of Functions and Constants do not change."""
        text = "".join(form.signature() for form in self.forms)
        return hashlib.sha256(text.encode()).hexdigest()[:16]


def content_of(
    unknowns: Sequence[dolfinx.fem.Function], forms: Sequence[ufl.Form | None]
) -> Content:
    """Read the content off forms, of which some may be None."""
    given = tuple(form for form in forms if form is not None and not form.empty())
    coefficients = {f: None for form in given for f in form.coefficients()}
    constants = {c: None for form in given for c in form.constants()}
    ordered = sorted(constants, key=lambda c: c.count())
    return Content(tuple(unknowns), tuple(coefficients), tuple(ordered), given)
