# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What the forms of a problem hold: unknowns, coefficients, constants, and their signature."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import dolfinx
import ufl

#: UFL sorts Constants by the texts of their numbers: from here on all have as many digits.
LARGE = 10**9


@dataclass(frozen=True)
class Content:
    """What the forms of a problem hold."""

    unknowns: tuple[dolfinx.fem.Function, ...]  # u and the fields that are condensed
    coefficients: tuple[dolfinx.fem.Function, ...] = ()
    constants: tuple[dolfinx.fem.Constant, ...] = ()  # in the order of their creation
    forms: tuple[ufl.Form, ...] = ()

    @cached_property
    def signature(self) -> str:
        """A number of the forms, which no values and nothing that was made before them change."""
        numbered = {
            c: ufl.Constant(c.ufl_domain(), c.ufl_shape, count=LARGE + i)
            for i, c in enumerate(self.constants)
        }
        text = "".join(ufl.replace(form, numbered).signature() for form in self.forms)
        return hashlib.sha256(text.encode()).hexdigest()[:16]


def content_of(
    unknowns: Sequence[dolfinx.fem.Function], forms: Sequence[ufl.Form | None]
) -> Content:
    """Read the content off forms, of which some may be None."""
    given = tuple(form for form in forms if form is not None and not form.empty())
    coefficients = dict.fromkeys(f for form in given for f in form.coefficients())
    constants = sorted({c for form in given for c in form.constants()}, key=lambda c: c.count())
    return Content(tuple(unknowns), tuple(coefficients), tuple(constants), given)
