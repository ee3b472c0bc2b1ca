# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Local dofs and their torn copies: :math:`t = T x` and :math:`x = T^⊤ t` on one process."""

from __future__ import annotations

import numpy as np

import dolfinx

from dolfinx_feti.fem.decomposition import TornSpace
from dolfinx_feti.runtime.arrays import Array, Indices


class TornDofs:
    """The map T from the dofs of a space to the torn dofs of this process.

    Attributes:
        local: Local dof of V (owned or ghost) of each torn dof, (n,).
    """

    def __init__(self, space: TornSpace) -> None:
        """Find the local dof of each torn dof of a space."""
        dofmap = space.V.dofmap
        bs = dofmap.index_map_bs
        self._V = space.V
        self._owned = dofmap.index_map.size_local * bs
        self.local: Indices = (
            space.local_block[:, None] * bs + np.arange(bs, dtype=np.int32)
        ).ravel()

    def tear(self, x: Array) -> Array:
        """Return T x, (n,), of owned entries, (owned,). Collective."""
        vector = dolfinx.fem.Function(self._V).x
        vector.array[: self._owned] = x
        vector.scatter_forward()
        return np.asarray(vector.array[self.local])

    def assemble(self, t: Array) -> Array:
        """Return Tᵀ t, the sums over the copies of each owned dof, (owned,). Collective."""
        vector = dolfinx.fem.Function(self._V).x
        vector.array[:] = np.bincount(self.local, t, minlength=len(vector.array))
        vector.scatter_reverse(dolfinx.la.InsertMode.add)
        return vector.array[: self._owned].copy()
