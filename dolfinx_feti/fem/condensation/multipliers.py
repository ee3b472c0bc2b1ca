# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The residual of multipliers λ in the equations of condensed fields, and its largest change."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.fem.condensation.cell_means import CellMeans
from dolfinx_feti.fem.condensation.condensed_fields import CondensedFields
from dolfinx_feti.runtime.arrays import Array, Mask


class Multipliers:
    """The residual r_p(0, λ) of multipliers λ, one for each condensed dof; λ = 0 at first.

    Attributes:
        residual: r_p(0, λ), (cells, n, 1).
    """

    def __init__(
        self,
        numbering: CondensedFields,
        compiler: Compiler,
        *,
        is_constraint: Mask,
        constraint_sizes: Sequence[float] | None,
    ) -> None:
        """Compile the means by which changes are measured. Collective.

        Args:
            numbering: Numbering of the fields, which are scalars.
            compiler: Compiler of the forms.
            is_constraint: Whether the equation of each field contains u, (fields,).
            constraint_sizes: Size |c| of the constraint in each field's equation c g(u), such as 2
                for 2 (J − 1); 1 for all if not given.
        """
        self.residual: Array = np.zeros((*numbering.entries.shape, 1))
        self._means = CellMeans(numbering, compiler)
        self._is_constraint = is_constraint
        self._constraint_sizes: Array = np.ones(len(is_constraint))
        if constraint_sizes is not None:
            self._constraint_sizes = np.asarray(constraint_sizes, dtype=np.float64)

    def change_residual(self, residual: Array) -> float:
        """Set r_p(0, λ), and return by how much it changes. Not collective.

        Args:
            residual: The new r_p(0, λ), (cells, n, 1).

        Returns:
            The largest change of its mean in a cell of this process, over all fields whose
            equations contain u, each relative to its constraint size.
        """
        change = (residual - self.residual)[:, :, 0]
        self.residual = residual
        mean_change = np.abs(self._means.of(change)) * self._is_constraint  # (cells, fields)
        largest = mean_change.max(axis=0, initial=0.0)  # (fields,)
        return float((largest / self._constraint_sizes).max(initial=0.0))
