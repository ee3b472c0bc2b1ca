# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Factors of the dense :math:`K_ρ = K + ρ\, R R^⊤` by those of a sparse matrix :math:`K_Q`.

.. math:: K_Q = K + ρ\, Q Q^⊤, \qquad
          K_ρ^{-1} y = z - Z C V^⊤ z, \qquad z = K_Q^{-1} y, \qquad C = (Λ^{-1} + V^⊤ Z)^{-1}

with V = (R, Q), :math:`Z = K_Q^{-1} V`, :math:`Λ = \operatorname{diag}(ρ I, -ρ I)` (Sherman,
Morrison and Woodbury; docs/theory.md). K itself may be singular, as it is for a floating subdomain,
and :math:`K_Q` is not. Q is an orthonormal basis of R on the dofs that are eliminated last, and
zero elsewhere. These dofs are one dense block of the factor, to which :math:`ρ\, Q Q^⊤` adds no
entries.

The bordered matrix :math:`\begin{pmatrix} K_Q & V \\ V^⊤ & -Λ^{-1} \end{pmatrix}` has the Schur
complements :math:`-C^{-1}` and :math:`K_Q + V Λ V^⊤ = K_ρ`. Counting its inertia both ways gives
(Haynsworth 1968)

.. math:: n_-(K_ρ) = n_-(K_Q) + n_+(C^{-1}) - k, \qquad n_-(K_Q) = 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_feti.feti.subdomain.factors.protocol import (
    Factor,
    FactorInertia,
    SymbolicFactor,
    destroyed_error,
)
from dolfinx_feti.feti.subdomain.factors.work_space import WorkSpace
from dolfinx_feti.feti.subdomain.orthonormal import symmetric_part
from dolfinx_feti.runtime.arrays import Array, Numbers
from dolfinx_feti.runtime.petsc_library import CSRMatrix

#: K_Q is factored if the smallest singular value of R on the last dofs is above this multiple of
#: the largest one. The condition number of K_Q is that of K_ρ times the inverse square of the
#: ratio: at this bound four of sixteen digits are lost. Separators of 64 dofs or more have ratios
#: of 0.1 to 1.
MIN_SINGULAR_VALUE = 1e-2


@dataclass(frozen=True, slots=True)
class Correction:
    """The correction of rank 2 k that turns K_Q⁻¹ y into K_ρ⁻¹ y.

    Attributes:
        R: Modes, (n_i, k).
        last_dofs: Dofs that are eliminated last, (p,).
        Q: Orthonormal basis of R on them, (p, k).
        Z: K_Q⁻¹ (R, Q), (n_i, 2 k).
        C: (Λ⁻¹ + Vᵀ Z)⁻¹, (2 k, 2 k).
    """

    R: Array
    last_dofs: Numbers
    Q: Array
    Z: Array
    C: Array

    def apply(self, z: Array) -> Array:
        """Return K_ρ⁻¹ y = z − Z C Vᵀ z for z = K_Q⁻¹ y, (n_i,) or (n_i, r)."""
        overlap = np.concatenate([self.R.T @ z, self.Q.T @ z[self.last_dofs]])  # Vᵀ z
        return np.asarray(z - self.Z @ (self.C @ overlap))

    def memory(self) -> float:
        """Return the memory of Q, Z and C in MiB; R belongs to the modes of the subdomain."""
        return (self.Q.nbytes + self.Z.nbytes + self.C.nbytes) / 2**20


class WoodburyFactor:
    """The factor of K_ρ by that of K_Q, (n_i, n_i); methods are those of ``Factor``.

    Attributes:
        inertia: Number of negative eigenvalues of K_ρ; no zero pivots.
        is_single_precision: False.
        last_dofs: Dofs that are eliminated last, (p,). Only tests read them.
    """

    is_single_precision = False

    def __init__(
        self,
        factor: Factor,
        last_dofs: Numbers,
        correction: Correction | None,
        inertia: FactorInertia,
    ) -> None:
        """Store the factor of K_Q. Without modes K_ρ = K_Q = K, and the correction is None."""
        self.inertia = inertia
        self.last_dofs = last_dofs
        self._factor: Factor | None = factor
        self._correction = correction

    def solve(self, Y: Array, *, transpose: bool = False) -> Array:
        """Return K_ρ⁻¹ Y, (n_i,) or (n_i, r)."""
        if self._factor is None:
            raise destroyed_error()
        z = self._factor.solve(Y)  # K_Q⁻¹ y
        return z if self._correction is None else self._correction.apply(z)

    def memory(self) -> float:
        """Return the memory of the factor in MiB."""
        if self._factor is None:
            return 0.0
        of_correction = 0.0 if self._correction is None else self._correction.memory()
        return self._factor.memory() + of_correction

    def destroy(self) -> None:
        """Free the factor."""
        if self._factor is not None:
            self._factor.destroy()
        self._factor = None
        self._correction = None


def factor_by_woodbury(
    symbolic: SymbolicFactor, K: CSRMatrix, R: Array, rho: float, work: WorkSpace
) -> WoodburyFactor | None:
    """Factor K + ρ R Rᵀ of a subdomain.

    Args:
        symbolic: Symbolic factor of its block of K, without an interface: all dofs are eliminated.
        K: Matrix of all subdomains of the process, (n, n).
        R: Orthonormal columns, (n_i, k), of a similar size on all dofs: the condition number of K_Q
            grows with the ratio of the sizes.
        rho: Stiffness ρ.
        work: Work space.

    Returns:
        The factor; None if K_Q is not positive definite, if the last dofs do not determine all
        modes, or if K_ρ is singular.

    Raises:
        FactorError: K has an entry outside of the pattern.
        MemoryError: Memory ran out.
    """
    last_dofs = symbolic.last_dofs
    k = R.shape[1]
    if k == 0:
        eliminated = symbolic.factor(K, work)
        if eliminated is None:
            return None
        return WoodburyFactor(eliminated.factor, last_dofs, None, eliminated.factor.inertia)
    Q = _basis_on_last(R[last_dofs])
    if Q is None:
        return None
    eliminated = symbolic.factor_sum(K, rho * Q @ Q.T, work)  # K_Q
    if eliminated is None:
        return None
    factor = eliminated.factor
    V = np.zeros((len(R), 2 * k), order="F")
    V[:, :k] = R
    V[last_dofs, k:] = Q
    Z = factor.solve(V)  # K_Q⁻¹ V
    if not np.isfinite(Z).all():
        return None
    C_inverse = symmetric_part(np.diag(np.repeat([1.0, -1.0], k) / rho) + V.T @ Z)  # Λ⁻¹ + Vᵀ Z
    try:
        C = np.linalg.inv(C_inverse)
    except np.linalg.LinAlgError:
        return None
    positive = np.count_nonzero(np.linalg.eigvalsh(C_inverse) > 0.0)  # n₊(C⁻¹)
    inertia = FactorInertia(int(positive) - k, 0)  # n₋(K_ρ) = n₊(C⁻¹) − k
    return WoodburyFactor(factor, last_dofs, Correction(R, last_dofs, Q, Z, np.asarray(C)), inertia)


def _basis_on_last(R: Array) -> Array | None:
    """Return an orthonormal basis of the columns of R on the last dofs, (p, k) → (p, k).

    Returns:
        The basis; None if these rows do not determine all modes.
    """
    p, k = R.shape
    if p < k:
        return None
    Q, singular_values, _ = np.linalg.svd(R, full_matrices=False)
    return Q if singular_values[-1] > MIN_SINGULAR_VALUE * singular_values[0] else None
