# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Functions, constants and a signature of the forms of a problem.

A checkpoint stores the values of the functions and compares signatures.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import dolfinx
import ufl

#: First of the numbers that Constants get for the signature. UFL sorts Constants by their numbers
#: as texts, in which "10" is before "9"; numbers with ten digits are sorted alike as texts.
FIRST_COUNT = 10**9


@dataclass(frozen=True)
class FormContent:
    """Functions and constants in the forms of a problem.

    Attributes:
        unknowns: u and the condensed fields.
        coefficients: All Functions in the forms, unknowns included.
        constants: Constants, in the order of their creation.
        forms: Forms that are not zero.
    """

    unknowns: tuple[dolfinx.fem.Function, ...]
    coefficients: tuple[dolfinx.fem.Function, ...] = ()
    constants: tuple[dolfinx.fem.Constant, ...] = ()
    forms: tuple[ufl.Form, ...] = ()

    @cached_property
    def signature(self) -> str:
        """Hash of the forms, 16 digits.

        It does not depend on values, nor on how many objects of UFL were created before.
        """
        numbered = {
            c: ufl.Constant(c.ufl_domain(), c.ufl_shape, count=FIRST_COUNT + i)
            for i, c in enumerate(self.constants)
        }
        text = "".join(ufl.replace(form, numbered).signature() for form in self.forms)
        return hashlib.sha256(text.encode()).hexdigest()[:16]


def content_of(
    unknowns: Sequence[dolfinx.fem.Function], forms: Sequence[ufl.Form | None]
) -> FormContent:
    """Return the content of forms.

    Args:
        unknowns: u and the condensed fields.
        forms: The forms, None or empty for zero.
    """
    nonzero = tuple(form for form in forms if form is not None and not form.empty())
    coefficients = dict.fromkeys(f for form in nonzero for f in form.coefficients())
    constants = sorted({c for form in nonzero for c in form.constants()}, key=lambda c: c.count())
    return FormContent(tuple(unknowns), tuple(coefficients), tuple(constants), nonzero)
