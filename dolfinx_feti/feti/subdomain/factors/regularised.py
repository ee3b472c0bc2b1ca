# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The factor of a sparse regularised block by fronts, where that will do (docs/theory.md).

.. math:: K_Q = K + ρ\, Q Q^⊤ = U^⊤ U, \qquad
          K_ρ^{-1} y = z - Z C V^⊤ z, \qquad z = K_Q^{-1} y, \qquad C = (Λ^{-1} + V^⊤ Z)^{-1}

with V = (R, Q), :math:`Z = K_Q^{-1} V`, :math:`Λ = \operatorname{diag}(ρ I, -ρ I)`, and an
orthonormal basis Q of R on the last front. :math:`K_ρ` has as many negative eigenvalues as
:math:`C^{-1}` has positive ones beyond the k columns of R (Haynsworth 1968).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_feti.feti.subdomain.factors.multifrontal import FrontFactor, Fronts
from dolfinx_feti.feti.subdomain.factors.protocol import Pivots
from dolfinx_feti.feti.subdomain.orthonormal import symmetric_part
from dolfinx_feti.runtime.arrays import Array, Numbers
from dolfinx_feti.runtime.petsc_library import Rows

#: Share of the largest singular value of R on the last front that the smallest one has to have.
FIXED = 1e-2


@dataclass(frozen=True, slots=True)
class RegularisedFactor:
    """K_Q, factored, and what leads from it to K_ρ: see ``protocol``.

    Attributes:
        front: The factor of K_Q.
        R: The modes, (n, k).
        last: Dofs of Q.
        Q: Orthonormal basis of R on them, (len(last), k).
        Z: K_Q⁻¹ (R, Q), (n, 2 k).
        C: (Λ⁻¹ + Vᵀ Z)⁻¹, (2 k, 2 k).
        pivots: Numbers of negative and zero eigenvalues of K_ρ.
    """

    front: FrontFactor
    R: Array
    last: Numbers
    Q: Array
    Z: Array
    C: Array
    pivots: Pivots

    def solve(self, Y: Array, *, transpose: bool = False) -> Array:
        """Return K_ρ⁻¹ Y, (n,) or (n, r)."""
        z = self.front.solve(Y)  # z = K_Q⁻¹ y
        if self.R.shape[1] == 0:
            return z
        overlap = np.concatenate([self.R.T @ z, self.Q.T @ z[self.last]])
        return np.asarray(z - self.Z @ (self.C @ overlap))  # z − Z C Vᵀ z

    def memory(self) -> float:
        """Return the memory of the factor in MiB."""
        return self.front.memory() + self.Z.nbytes / 2**20

    def destroy(self) -> None:
        """Do nothing: arrays are freed with the object."""


def factor_by_fronts(
    fronts: Fronts, K: Rows, work: Array, R: Array, rho: float
) -> RegularisedFactor | None:
    """Factor K_ρ for orthonormal R, (n, k), in a work space; None if K_Q is not definite."""
    k, last = R.shape[1], fronts.last
    Q = _basis_on_last_front(R[last])
    if Q is None:
        return None
    factored = fronts.factor(K, work, np.asfortranarray(rho * Q @ Q.T) if k else None)
    if factored is None:
        return None
    front = factored[0]
    V = np.zeros((len(R), 2 * k), order="F")
    V[:, :k] = R
    V[last, k:] = Q
    Z = front.solve(V) if k else V
    if not np.isfinite(Z).all():
        return None
    inverse = np.diag(np.repeat([1.0, -1.0], k) / rho) + V.T @ Z  # Λ⁻¹ + Vᵀ Z
    inverse = symmetric_part(inverse)
    try:
        C = np.linalg.inv(inverse)
    except np.linalg.LinAlgError:
        return None
    negative = int(np.count_nonzero(np.linalg.eigvalsh(inverse) > 0.0)) - k
    return RegularisedFactor(front, R, last, Q, Z, np.asarray(C), Pivots(negative, 0))


def _basis_on_last_front(R: Array) -> Array | None:
    """Return an orthonormal basis of R on the last front; None if that does not fix all modes."""
    if R.shape[1] == 0:
        return R
    if R.shape[0] < R.shape[1]:
        return None
    Q, share, _ = np.linalg.svd(R, full_matrices=False)
    return Q if share[-1] > FIXED * share[0] else None
