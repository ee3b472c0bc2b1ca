# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Flux columns: coarse fields that free the iterations from the bulk modulus.

With a pressure condensed cell by cell, :math:`K = K_{uu} + K_p^⊤ \operatorname{diag}(κ/|τ|) K_p`,
an average of copies changes the volume of a subdomain and pays for it with κ. A pressure pattern y
on its cells (the constant first) has the flux :math:`g^⊤ u_Γ` through its interface, with

.. math:: g = (K_p^⊤ y)_Γ - K_{ΓI} K_{II}^{-1} (K_p^⊤ y)_I

after displacements inside have relieved what they can. The energy of the subdomain bounds its own
share of the flux; what an average adds is :math:`c^⊤ w` for the local displacement w, and

.. math:: c = (1 - δ)\, g, \qquad U = K_ρ^{-1} c

as columns of the coarse space (``averaged``) make it vanish: the residual is orthogonal to
:math:`T^⊤ δ U`, so that :math:`c^⊤ w = U^⊤ δ\, T r = 0` for :math:`w = K_ρ^{-1} δ\, T r`. Each
column is one local solve. Those of a subdomain are combined to :math:`U^⊤ K_ρ U = I`: with a large
κ some of them are nearly parallel. A small subdomain takes the first few patterns only, as the
coarse matrix of many subdomains would cost more than the iterations that the others save.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from dolfinx_feti.feti.copies import Copies

__all__ = ["DOFS", "flux_columns"]

Array = npt.NDArray[np.float64]

#: Interface dofs of a subdomain that has all columns; one with fewer has that share of them.
DOFS = 640

#: Energy below which a combination of columns of unit energy is dropped.
DEPENDENT = 1e-8


def flux_columns(copies: Copies, g: Array, solve: Callable[[int, Array], Array]) -> list[Array]:
    """Return the flux columns of each subdomain, (n_i, up to the number of patterns).

    Args:
        copies: Copies of the interface dofs.
        g: Flux of each pattern, condensed to the interface, (n, patterns).
        solve: Applies :math:`K_ρ^{-1}` to forces on the interface of subdomain i,
            ``solve(i, c)``, (n_i, patterns) → (n_i, patterns).
    """
    c = (1.0 - copies.delta)[:, None] * g
    most = c.shape[1]
    few = [c[on, : max(1, most * (on.stop - on.start) // DOFS)] for on in copies.blocks]
    return [_orthonormal(solve(i, c_i), c_i) for i, c_i in enumerate(few)]


def _orthonormal(U: Array, c: Array) -> Array:
    """Combine the columns of U = K_ρ⁻¹ c to Uᵀ K_ρ U = I, without those that depend."""
    energy = U.T @ c
    size = np.sqrt(np.abs(energy.diagonal()))
    scale = np.divide(1.0, size, where=size > 0.0, out=np.zeros_like(size))
    values, Q = np.linalg.eigh(scale[:, None] * 0.5 * (energy + energy.T) * scale)
    kept = values > DEPENDENT
    return (U * scale) @ (Q[:, kept] / np.sqrt(values[kept]))
