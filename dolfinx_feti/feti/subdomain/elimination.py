# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Elimination of the interior: the Schur complement and the factor of K_II of every subdomain.

Cholesky's factorisation by fronts that stops at the interface gives both (eq. 51). Where
:math:`K_{II}` is not positive definite, or the options name a solver, a factor with pivots solves
for the columns of :math:`K_{IΓ}`.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dolfinx_feti.feti.gluing.dofs import Dofs
from dolfinx_feti.feti.subdomain.analysis import Analysis
from dolfinx_feti.feti.subdomain.blocks import named, sparse_block
from dolfinx_feti.feti.subdomain.factors.dense import pack
from dolfinx_feti.feti.subdomain.factors.multifrontal import FrontFactor
from dolfinx_feti.feti.subdomain.factors.pivoted import factor_with_pivots
from dolfinx_feti.feti.subdomain.factors.protocol import Factor
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.petsc_library import rows_of
from dolfinx_feti.torn.matrix import Torn

__all__ = ["eliminate", "factor_interior"]


def eliminate(torn: Torn, dofs: Dofs, analysis: Analysis) -> Iterator[tuple[Array, Factor]]:
    """Yield S, in packed format, and the factor of K_II of each subdomain; K is symmetric."""
    for i, (factor, S) in enumerate(_factors(torn, dofs, analysis)):
        Γ, I = dofs.interface[i], dofs.interior[i]  # noqa: E741
        with named(torn.first + i):
            if S is None:
                X = factor.solve(sparse_block(torn.K, I, Γ).toarray(order="F"))  # K_II⁻¹ K_IΓ
                K_ΓΓ = sparse_block(torn.K, Γ, Γ).toarray(order="F")
                S = pack(K_ΓΓ - sparse_block(torn.K, Γ, I) @ X)  # K_ΓΓ − K_ΓI X
        yield S, factor


def factor_interior(torn: Torn, dofs: Dofs, analysis: Analysis) -> list[Factor]:
    """Factor every K_II, by fronts where it is positive definite."""
    return [factor for factor, _ in _factors(torn, dofs, analysis)]


def _factors(torn: Torn, dofs: Dofs, analysis: Analysis) -> Iterator[tuple[Factor, Array | None]]:
    """Yield the factor of each K_II, and what its fronts leave: S, packed; None with pivots."""
    assert analysis.interior is not None
    fronts = analysis.interior_fronts
    work = np.empty(max((front.work for front in fronts or []), default=0))
    for i, I in enumerate(dofs.interior):  # noqa: E741
        with named(torn.first + i):
            factored: tuple[FrontFactor, Array] | None = None
            if fronts is not None:
                with rows_of(torn.K) as K:
                    factored = fronts[i].factor(K, work)
            pair = factored or (factor_with_pivots(torn.K, I, analysis.interior), None)
        yield pair
