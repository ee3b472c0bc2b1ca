# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The mean in each cell of functions whose moments :math:`r_i = \int_τ q_i f` are assembled.

If the constant 1 has the dofs :math:`c_i` in a cell, :math:`1 = \sum_i c_i q_i`, the mean is

.. math:: \frac{1}{|τ|} \int_τ f = \frac{\sum_i c_i r_i}{\sum_i c_i \int_τ q_i} .
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import dolfinx
import ufl

from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.fem.condensation.cellwise_forms import CellwiseForms
from dolfinx_feti.fem.condensation.condensed_fields import CondensedFields
from dolfinx_feti.runtime.arrays import Array


class CellMeans:
    """Means in each cell, from moments with the test functions of each scalar field."""

    def __init__(self, fields: CondensedFields, compiler: Compiler) -> None:
        """Compute the weights c_i/|τ|. Collective.

        Args:
            fields: Scalar fields, whose spaces contain the constants.
            compiler: Compiler of the problem.
        """
        spaces = [p.function_space for p in fields.functions]
        ones = [dolfinx.fem.Function(Q) for Q in spaces]
        for one in ones:
            one.interpolate(_constant_one)
        forms = [ufl.TestFunction(Q) * ufl.dx for Q in spaces]
        integrals = CellwiseForms(forms, spaces[0].mesh, compiler).assemble()
        dofs_of_one = np.concatenate([one.x.array for one in ones])[fields.entries]
        self._fields = fields
        self._weights: list[Array] = []  # of each field, (cells, dofs of the field)
        for c, integral in zip(fields.split(dofs_of_one), integrals, strict=True):
            volume = (c * integral).sum(axis=1, keepdims=True)  # |τ| = Σ_i c_i ∫ q_i
            self._weights.append(c / volume)

    def of(self, moments: Array) -> Array:
        """Return the means in the owned cells, (cells, fields).

        Args:
            moments: Moments of a function for each field, (cells, n), field by field.
        """
        parts: Sequence[Array] = self._fields.split(moments)
        pairs = zip(self._weights, parts, strict=True)
        return np.column_stack([(weights * part).sum(axis=1) for weights, part in pairs])


def _constant_one(x: Array) -> Array:
    """Return the value 1 at points, (points,)."""
    return np.ones(x.shape[1])
