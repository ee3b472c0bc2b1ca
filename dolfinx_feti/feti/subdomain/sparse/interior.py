# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Factors of the interior of every subdomain, and S with them.

Those of :math:`K_{II}` come from its fronts (``fronts``), together with S. Where it is not positive
definite, as inside a wall that buckles, :math:`L Δ L^⊤` with pivots takes their place
(``factors``), and tells the inertia.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dolfinx_feti.feti.subdomain.sparse.fronts import FrontCode
from dolfinx_feti.feti.subdomain.sparse.fronts_or_pivots import FrontsOrPivots
from dolfinx_feti.petsc_library import Rows

__all__ = ["InteriorFactors"]

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int32]


class InteriorFactors(FrontsOrPivots):
    """Factors of every K_II; the dofs of the fronts are all free ones of the subdomain."""

    def schur_complement(
        self, i: int, K: Rows, interface: Indices, code: FrontCode, work: Array
    ) -> tuple[Array | None, Array]:
        """Factor K_II of subdomain i by fronts, and form S.

        Args:
            i: Number of the subdomain.
            K: The torn matrix, row by row.
            interface: Which of its free dofs are Γ, ascending.
            code: What ``load_fronts`` returns.
            work: Work space of an earlier call, (any,).

        Returns:
            S in packed format, None if K_II is not positive definite; the work space.
        """
        fronts = self._analysed(i, K, interface, code)
        if len(work) < fronts.work:
            work = np.empty(fronts.work)
        S = fronts.factor(K, work)
        if S is not None:
            self._pivoted.release_block(i)
        return S, work
