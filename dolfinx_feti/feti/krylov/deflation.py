# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Deflation of the primal form: small eigenvalues that one Newton step leaves to the next.

Under pressure a handful of eigenvalues below one come up, soft directions of the whole wall, and
they stay from one matrix to the next. With fields W near their eigenvectors, A-orthogonal to V,

.. math:: x_0 = V A_0^{-1} V^⊤ b + W H^{-1} W^⊤ b, \qquad
          Π = I - V A_0^{-1} (A V)^⊤ - W H^{-1} (A W)^⊤, \qquad H = W^⊤ A W,

keep all residuals orthogonal to W, and conjugate gradients no longer see that part of the spectrum
(Saad et al. 2000). W holds Ritz vectors of the smallest Ritz values in the span of the W of the
last solve and its preconditioned residuals :math:`Z = Π M R`, :math:`M = T^⊤ δ K_ρ^{-1} δ T`. With
:math:`Q = M^{-1} W` and :math:`W^⊤ Q = I`, as an earlier choice has left them, :math:`M^{-1} Z =
R + Q N` and

.. math:: (W, Z)^⊤ A\, (W, Z) = \begin{pmatrix} H & 0 \\ 0 & Z^⊤ A Z \end{pmatrix}, \qquad
          (W, Z)^⊤ M^{-1} (W, Z) = \begin{pmatrix} I & N \\ N^⊤ & Z^⊤ R + N^⊤ N \end{pmatrix},
          \qquad N = Q^⊤ Z.

No product is needed: the coefficients α, β of the iterations and the directions p give, for r and
z with :math:`r^⊤ z = 1`,

.. math:: A p_j = (r_j - \sqrt{β_{j+1}}\, r_{j+1}) / α_j, \qquad z_j = p_j - \sqrt{β_j}\, p_{j-1}.

The Gram matrices are formed in full, since rounding spoils the orthogonality of the residuals. For
the next matrix W is balanced again and multiplied, all columns at once. Q stays: as long as K_ρ and
V last it is exact, and for others the matrix above still is a scalar product.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dolfinx_feti.collective import total, total_of
from dolfinx_feti.events import event
from dolfinx_feti.feti.coarse.averaged import BOUNDS, EPS, estimated_norm
from dolfinx_feti.feti.copies import Copies
from dolfinx_feti.feti.krylov.primal import CoarseSpace, Trace

__all__ = ["DeflatedSpace", "RitzVectors"]

Array = npt.NDArray[np.float64]

#: Ritz value below which a vector is worth its place: what V leaves begins at about one.
SMALL = 0.8

#: Share of the largest eigenvalue below which a direction counts as repeated: of a Gram matrix of
#: energies, where it has lost so much to rounding, and of one of squared displacements.
REPEATED, VANISHED = 1e-6, 1e-10


@dataclass(frozen=True, slots=True)
class RitzVectors:
    """What a solve leaves to later ones, by copies.

    Attributes:
        W: Ritz vectors, (n, k).
        Q: M⁻¹ W, with the M of the solves that W came from, (n, k).
    """

    W: Array
    Q: Array


class DeflatedSpace:
    """A coarse space V and Ritz vectors W beside it, for conjugate gradients."""

    def __init__(
        self,
        space: CoarseSpace,
        copies: Copies,
        multiply: Callable[[int, Array], Array],
        vectors: RitzVectors | None,
    ) -> None:
        """Balance the vectors and multiply them with the present matrix.

        Args:
            space: The coarse space V.
            copies: Copies of the interface dofs.
            multiply: Applies S_i to columns, ``multiply(i, X)``, (n_i, c) → (n_i, c).
            vectors: What earlier solves have left, if there were any.

        Note:
            Collective.
        """
        self._space, self._copies = space, copies
        self._direction: Array | None = None
        with event("FETIRecycling"):
            vectors = vectors or RitzVectors(np.zeros((copies.n, 0)), np.zeros((copies.n, 0)))
            W, none = np.empty_like(vectors.W), np.zeros(copies.n)
            for j in range(W.shape[1]):
                W[:, j] = space.correct(vectors.W[:, j], none)  # W ← W − V A₀⁻¹ (A V)ᵀ W
            Y = _independent(self._product(W, copies.delta[:, None] * W))
            self._W, self._Q = W @ Y, vectors.Q @ Y
            self._SW = np.empty_like(self._W)
            for i, rows in enumerate(copies.blocks):
                self._SW[rows] = multiply(i, self._W[rows])  # S W
            self._H = _symmetric(self._product(self._W, self._SW))  # H = Wᵀ A W
            values, Y = _scaled_eigenvectors(self._H)
            self._inverse = (Y / values) @ Y.T  # H⁻¹
            if values.min(initial=0.0) < 0.0:
                v = self._W @ Y[:, 0]  # vᵀ A v = values[0]
                if values[0] < -BOUNDS * self._rounding(multiply, v):
                    self._direction = v

    @property
    def count(self) -> int:
        """Number of vectors W."""
        return self._W.shape[1]

    def start(self, r: Array) -> Array:
        """Return (V A₀⁻¹ Vᵀ + W H⁻¹ Wᵀ) r of an assembled residual, by copies, (n,). Collective."""
        x = self._space.start(r)
        if not self.count:
            return x
        overlap = self._product(self._W, self._copies.delta * r)  # Wᵀ r
        return np.asarray(x + self._W @ (self._inverse @ overlap))

    def correct(self, z: Array, r: Array) -> Array:
        """Return z + V A₀⁻¹ (Vᵀ r − (A V)ᵀ z) + W H⁻¹ (Wᵀ r − (A W)ᵀ z), by copies, (n,).

        Collective.
        """
        return self.correct_with_product(z, r)[0]

    def correct_with_product(self, z: Array, r: Array) -> tuple[Array, float]:
        """Return what :meth:`correct` does, and its product with r. Collective."""
        z, r = self._space.correct(z, r), self._copies.delta * r
        own = np.concatenate([[r @ z], self._W.T @ r, self._SW.T @ z])
        product, of_r, of_z = np.split(total_of(own, self._copies.comm), [1, 1 + self.count])
        c = self._inverse @ (of_r - of_z)
        return np.asarray(z + self._W @ c), float(product[0] + of_r @ c)

    def negative_direction(self) -> Array | None:
        """Return a field v with vᵀ A v < 0, (n,), or None if none is known. Collective."""
        v = self._space.negative_direction()
        return self._direction if v is None else v

    def ritz_vectors(self, trace: Trace, *, most: int) -> RitzVectors:
        """Choose what is left to later solves.

        Args:
            trace: What the iterations of a solve in this space have shown.
            most: Most vectors.

        Note:
            Collective.
        """
        k, r = len(trace.Z) - 1, self.count  # A p takes the next residual
        if k < 1:
            return RitzVectors(self._W, self._Q)
        α, root = trace.steps, np.sqrt(trace.turns)
        Z, R, δ = trace.Z[:k].T, trace.R.T, self._copies.delta[:, None]
        G = self._product(Z, δ * R)  # Zᵀ R, (k, k + 1)
        N = self._product(δ * self._Q, Z)  # N = Qᵀ Z
        if not (np.isfinite(G).all() and np.isfinite(N).all()):
            return RitzVectors(self._W, self._Q)
        B = (G[:, :k] - root[1 : k + 1] * G[:, 1:]) / α[:k]  # B = Zᵀ A P
        C = B - root[:k] * np.pad(B, ((0, 0), (1, 0)))[:, :k]  # C = Zᵀ A Z
        A = np.block([[self._H, np.zeros((r, k))], [np.zeros((k, r)), _symmetric(C)]])
        S = np.block([[np.eye(r), N], [N.T, _symmetric(G[:, :k]) + N.T @ N]])
        values, T = _scaled_eigenvectors(S)
        T /= np.sqrt(np.abs(values))  # Tᵀ S T = I
        θ, Y = np.linalg.eigh(_symmetric(T.T @ A @ T))
        T_W, T_Z = np.split(T @ Y[:, : min(most, np.count_nonzero(θ < SMALL))], [r])
        return RitzVectors(
            np.asfortranarray(self._W @ T_W + Z @ T_Z),
            np.asfortranarray(self._Q @ (T_W + N @ T_Z) + R[:, :k] @ T_Z),  # M⁻¹ Z = R + Q N
        )

    def memory(self) -> float:
        """Return the memory of the vectors of this process in MiB."""
        return (self._W.nbytes + self._SW.nbytes + self._Q.nbytes) / 2**20

    def _rounding(self, multiply: Callable[[int, Array], Array], v: Array) -> float:
        """Return a bound of the rounding errors of vᵀ A v. Collective."""
        bound = 0.0
        for i, rows in enumerate(self._copies.blocks):
            bound += EPS * estimated_norm(multiply, i, len(v[rows])) * float(v[rows] @ v[rows])
        return total(bound, self._copies.comm)

    def _product(self, X: Array, Y: Array) -> Array:
        """Return Xᵀ Y over all processes."""
        return total_of(X.T @ Y, self._copies.comm)


def _symmetric(H: Array) -> Array:
    """Return the symmetric part."""
    return np.asarray(0.5 * (H + H.T))


def _independent(H: Array) -> Array:
    """Return the orthonormal eigenvectors of H ≥ 0, (k, up to k), without those of its kernel."""
    values, Y = np.linalg.eigh(H)
    return np.asarray(Y[:, values > VANISHED * values.max(initial=0.0)])


def _scaled_eigenvectors(H: Array) -> tuple[Array, Array]:
    """Return Y and values with Yᵀ H Y = diag(values), ascending, where H is not singular.

    They are the eigenvectors of H scaled to a unit diagonal.
    """
    root = np.sqrt(np.abs(np.diag(H)))
    scale = np.divide(1.0, root, out=np.zeros_like(root), where=root > 0.0)
    values, Y = np.linalg.eigh(scale[:, None] * H * scale)
    there = np.abs(values) > REPEATED * np.abs(values).max(initial=0.0)
    return values[there], scale[:, None] * Y[:, there]
