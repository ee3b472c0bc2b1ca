# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The Dirichlet conditions of a problem (eq. 7 of the paper)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import dolfinx

from dolfinx_feti.fem.torn_matrix import dirichlet_mask
from dolfinx_feti.problems.unknowns.mixed_of_one import MixedOfOne
from dolfinx_feti.runtime.arrays import Array, Mask


class DirichletConditions:
    """Conditions u = g on a set of dofs that does not change; their values g may.

    Attributes:
        bcs: The conditions.
        mask: True on the owned dofs of u that have one, (owned,).
    """

    def __init__(
        self,
        bcs: Sequence[dolfinx.fem.DirichletBC],
        u: dolfinx.fem.Function,
        mixed: MixedOfOne | None,
    ) -> None:
        """Mark the dofs.

        Args:
            bcs: The conditions, on the space of u, or of ``mixed.w``.
            u: The unknown that is torn.
            mixed: The user's unknown with a mixed element of one, if u is its only part.
        """
        self.bcs = tuple(bcs)
        self._u = u
        self._mixed = mixed
        if mixed is None:
            self.mask: Mask = dirichlet_mask(u.function_space, bcs)
        else:
            mask = dirichlet_mask(mixed.w.function_space, bcs)
            self.mask = mixed.of_part(mask)

    def gap(self) -> Array:
        """Return u − g at the present u on the Dirichlet dofs, zero on the free ones, (owned,)."""
        if self._mixed is not None:
            return self._mixed.gap(self.bcs)
        gap = np.zeros(len(self.mask))
        for bc in self.bcs:
            bc.set(gap, self._u.x.array, -1.0)  # −1 · (g − u)
        return gap

    def free(self, r: Array) -> Array:
        """Return a copy of a vector, (owned,), with zeros on the Dirichlet dofs."""
        return np.where(self.mask, 0.0, r)
