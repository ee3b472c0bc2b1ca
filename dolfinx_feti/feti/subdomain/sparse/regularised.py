# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Factors of sparse regularised blocks, by fronts where that will do.

Cholesky's factorisation by fronts (``fronts``) is three times as fast as one with pivots
(``factors``), but :math:`K_ρ = K + ρ R R^⊤` is dense. What is factored is K with the modes held in
the last front alone, the last separator of the nested dissection, which cuts the subdomain in two:
a stronger support than a few fixing dofs (Brzobohatý et al. 2011).
With an orthonormal basis Q of R on its dofs

.. math:: K_Q = K + ρ\, Q Q^⊤ = U^⊤ U,

and Sherman, Morrison and Woodbury lead to :math:`K_ρ`: with V = (R, Q), :math:`Z = K_Q^{-1} V` and
:math:`Λ = \operatorname{diag}(ρ I, -ρ I)`

.. math:: K_ρ^{-1} y = z - Z C V^⊤ z, \qquad z = K_Q^{-1} y, \qquad C = (Λ^{-1} + V^⊤ Z)^{-1}.

As :math:`K_Q` is positive definite, :math:`K_ρ` has as many negative eigenvalues as :math:`C^{-1}`
has positive ones beyond the k columns of R (Haynsworth 1968). A subdomain whose :math:`K_Q` is not
positive definite, or singular up to rounding, is factored with pivots.

What the modes do to the border is in ``factors``; here, as in ``dense`` and without cancellation,

.. math:: E = ρ\, K_ρ^{-1} R = R - K_ρ^{-1} W, \qquad D = E^⊤ W, \qquad W = K R.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dolfinx_feti.feti.subdomain.blocks import product_many
from dolfinx_feti.feti.subdomain.dense import border
from dolfinx_feti.feti.subdomain.direct import Pivots
from dolfinx_feti.feti.subdomain.sparse.factors import BlockFactors, Factors
from dolfinx_feti.feti.subdomain.sparse.fronts import FrontCode, Fronts, load_fronts_for
from dolfinx_feti.feti.subdomain.sparse.fronts_or_pivots import FrontsOrPivots
from dolfinx_feti.petsc_library import reads_in_place, rows_of
from dolfinx_feti.torn import Torn

__all__ = ["RegularisedFactors", "create_factors"]

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int32]

#: Share of the largest singular value of R on the last front that the smallest one has to have.
HELD = 1e-2

#: Bytes of work space that are kept from one factorisation to the next.
KEPT = 2**26


@dataclass(frozen=True, slots=True)
class _Correction:
    """What leads from K_Q to K_ρ.

    Attributes:
        R: The modes, (n, k).
        rho: The stiffness ρ.
        last: Dofs of Q.
        Q: Orthonormal basis of R on them, (len(last), k).
        Z: K_Q⁻¹ (R, Q), (n, 2 k).
        C: (Λ⁻¹ + Vᵀ Z)⁻¹, (2 k, 2 k).
        negative: Negative eigenvalues of K_ρ.
    """

    R: Array
    rho: float
    last: npt.NDArray[np.int64]
    Q: Array
    Z: Array
    C: Array
    negative: int

    def apply(self, z: Array) -> Array:
        """Return z − Z C Vᵀ z, (n,) or (n, r)."""
        return z - self.Z @ (self.C @ np.concatenate([self.R.T @ z, self.Q.T @ z[self.last]]))


class RegularisedFactors(FrontsOrPivots):
    """Factors of the blocks ``K[rows_i, rows_i] + ρ R Rᵀ``."""

    def __init__(
        self, torn: Torn, blocks: Sequence[Indices], pivoted: BlockFactors, code: FrontCode
    ) -> None:
        """Prepare factors; nothing is analysed yet.

        Args:
            torn: The torn matrix, symmetric.
            blocks: Rows of each block; no row is in two of them.
            pivoted: Prepared factors with pivots of the same blocks; destroyed with these.
            code: What ``load_fronts`` returns.
        """
        super().__init__(torn, blocks, pivoted)
        self._code = code
        self._corrections: list[_Correction | None] = [None] * len(blocks)
        self._work: Array = np.zeros(0)

    def update_block(
        self, i: int, R: Array | None = None, rho: float = 1.0, *, shift: Array | None = None
    ) -> None:
        """Factor block i of the present matrix; see ``Factors``."""
        R = np.zeros((len(self._dofs[i]), 0)) if R is None else R
        if shift is None and self._factor_by_fronts(i, R, rho):
            self._pivoted.release_block(i)
        else:
            super().update_block(i, R, rho, shift=shift)

    def _factor_by_fronts(self, i: int, R: Array, rho: float) -> bool:
        """Factor block i by fronts; return whether K_Q is positive definite, beyond rounding."""
        if len(R) == 0:
            return False
        with rows_of(self._torn.K) as K:
            fronts = self._analysed(i, K, np.zeros(0, dtype=np.int32), self._code)
            Q = _held(R[fronts.last])
            if Q is None:
                return False
            work = self._work if len(self._work) >= fronts.work else np.empty(fronts.work)
            self._work = work if work.nbytes <= KEPT else self._work
            held = np.asfortranarray(rho * Q @ Q.T) if Q.shape[1] else None
            if fronts.factor(K, work, held) is None:
                return False
        if Q.shape[1]:
            self._corrections[i] = _correction(fronts, R, Q, rho)
            return self._corrections[i] is not None
        self._corrections[i] = None
        return True

    def _solve(self, i: int, y: Array) -> Array:
        z, correction = super()._solve(i, y), self._corrections[i]
        return z if correction is None else correction.apply(z)

    def solve_border(self, i: int) -> tuple[Array, Array]:
        """Return E/ρ, (n_i, k), and −D/ρ², (k, k)."""
        correction, dofs = self._corrections[i], self._dofs[i]
        if correction is None:
            return super().solve_border(i)
        W = product_many(self._torn.K, dofs, dofs, correction.R)  # W = K R
        return border(correction.R, W, self._solve(i, W), correction.rho)

    def pivots(self, i: int) -> Pivots:
        """Count negative and zero eigenvalues of block i."""
        correction = self._corrections[i]
        return super().pivots(i) if correction is None else Pivots(correction.negative, 0)

    def memory(self) -> float:
        """Return the memory of all factors of this process in MiB."""
        kept = sum(correction.Z.nbytes for correction in self._corrections if correction)
        return super().memory() + kept / 2**20

    def _release(self, i: int) -> None:
        super()._release(i)
        self._corrections[i] = None


def create_factors(
    torn: Torn, blocks: Sequence[Indices], *, prefix: str, symmetric: bool
) -> Factors:
    """Choose how to factor sparse blocks.

    Fronts serve symmetric matrices, unless the options name a solver, or PETSc's indices have 64
    bits: rows would have to be copied for every block.

    Args:
        torn: The torn matrix.
        blocks: Rows of each block; no row is in two of them.
        prefix: Options prefix of the factorisations.
        symmetric: Whether K is symmetric.

    Note:
        Collective.
    """
    pivoted = BlockFactors(torn.K, blocks, prefix=prefix, symmetric=symmetric)
    if not symmetric or not reads_in_place():
        return pivoted
    code = load_fronts_for(prefix, torn.comm)
    return pivoted if code is None else RegularisedFactors(torn, blocks, pivoted, code)


def _held(R: Array) -> Array | None:
    """Return an orthonormal basis of R on the last front; None if that does not hold all modes."""
    if R.shape[1] == 0:
        return R
    if R.shape[0] < R.shape[1]:
        return None
    Q, share, _ = np.linalg.svd(R, full_matrices=False)
    return Q if share[-1] > HELD * share[0] else None


def _correction(fronts: Fronts, R: Array, Q: Array, rho: float) -> _Correction | None:
    """Lead from K_Q, factored, to K_ρ; None if K_Q is singular up to rounding."""
    k, last = R.shape[1], fronts.last
    V = np.zeros((len(R), 2 * k), order="F")
    V[:, :k] = R
    V[last, k:] = Q
    Z = fronts.solve(V)
    if not np.isfinite(Z).all():
        return None
    inverse = np.diag(np.repeat([1.0, -1.0], k) / rho) + V.T @ Z  # Λ⁻¹ + Vᵀ Z
    inverse = 0.5 * (inverse + inverse.T)
    try:
        C = np.linalg.inv(inverse)
    except np.linalg.LinAlgError:
        return None
    negative = int(np.count_nonzero(np.linalg.eigvalsh(inverse) > 0.0)) - k
    return _Correction(R, rho, last, Q, Z, np.asarray(C), negative)
