# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Flux columns: what keeps the iterations apart from the bulk modulus.

With a pressure condensed cell by cell, :math:`K = K_{uu} + K_p^⊤ \operatorname{diag}(κ/|τ|) K_p`,
an average of the copies changes the volume of a subdomain, and pays for it with κ. For a pressure
pattern y on the cells of subdomain i its flux through the interface is
:math:`g^⊤ u_Γ` with

.. math:: g = (K_p^⊤ y)_Γ - K_{ΓI} K_{II}^{-1} (K_p^⊤ y)_I,

the part of the pattern that displacements inside cannot relieve. The other copies contribute

.. math:: c = (1 - δ)\, g, \qquad U = K_ρ^{-1} c,

to the flux of an average, and with :math:`T^⊤ δ U` in the coarse space (``averaged``) the residual
is balanced against it: :math:`r ⟂ T^⊤ δ U` means :math:`c^⊤ w = 0` for the local solution
:math:`w = K_ρ^{-1} δ\, T r`. One, four or ten patterns, the monomials up to degree two, take the
growth with κ away where soft and rigid modes alone do not.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from dolfinx_feti.feti.copies import Copies

__all__ = ["flux_columns"]

Array = npt.NDArray[np.float64]


def flux_columns(
    copies: Copies, g: Array, solve: Callable[[int, Array], Array]
) -> list[Array]:
    """Return the columns :math:`K_ρ^{-1} (1 - δ)\\, g` of each subdomain.

    Args:
        copies: Copies of the interface dofs.
        g: Flux of each pattern, condensed to the interface, (n, patterns).
        solve: Applies :math:`K_ρ^{-1}` to columns on the interface of subdomain i,
            ``solve(i, c)``, (n_i, patterns) → (n_i, patterns).
    """
    c = (1.0 - copies.delta)[:, None] * g
    return [solve(i, c[rows]) for i, rows in enumerate(copies.blocks)]
