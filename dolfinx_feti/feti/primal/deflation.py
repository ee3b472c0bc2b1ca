# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Deflation of the primal form: small eigenvalues that one Newton step leaves to the next.

.. math:: Π = (I - W H^{-1} W^⊤ A)(I - V A_0^{-1} V^⊤ A), \qquad H = W^⊤ A W, \quad V^⊤ A W = 0

(Saad et al. 2000; docs/theory.md). W are Ritz vectors in the span of the last W and of the
iterations' :math:`A Z = R H`. A first solve has the softest fields of V where stress softens the
body, corrected: :math:`W = M A V c, A_0\, c = μ\, V^⊤ V c`. Of an unsymmetric A the symmetric parts
are taken. Gram matrices are formed in full, as rounding spoils the orthogonality of residuals.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from mpi4py import MPI

import numpy as np
import scipy.linalg

from dolfinx_feti.feti.coarse.space import MARGIN, AveragedSpace, estimated_norms
from dolfinx_feti.feti.gluing.copies import Copies
from dolfinx_feti.feti.solution import RitzVectors
from dolfinx_feti.feti.subdomain.blocks import on_subdomains
from dolfinx_feti.feti.subdomain.orthonormal import diagonalising, symmetric_part
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_all, total, total_of
from dolfinx_feti.runtime.events import event
from dolfinx_feti.torn.rounding import EPS

Solve = Callable[[int, Array], Array]

#: Applies S_i to columns, ``multiply(i, X)``, (n_i, c) → (n_i, c), or its transpose.
Multiply = Callable[..., Array]

#: Ritz value below which a vector is worth its place: what V leaves begins at about one.
DEFLATED = 0.8

#: Steps of inverse iteration in the coarse space: one more finds nothing more.
INVERSE = 2

#: Share of the largest squared size below which what is outside of V of a combination of W is none.
INSIDE = 1e-10

#: Energy below which a combination of fields of unit energy repeats others: their products have
#: lost ten digits to the iterations.
LOST_ENERGY = 1e-6


@dataclass(frozen=True, slots=True)
class Trace:
    """The first k iterations of a solve, A Z = R H; vectors are rows, by their copies.

    Attributes:
        R: Residuals r in any scale, (k + 1, n).
        Z: Preconditioned residuals z, (k, n).
        H: Their relation, (k + 1, k).
    """

    R: Array
    Z: Array
    H: Array


class DeflatedSpace:
    """The coarse space of conjugate gradients: V and Ritz vectors W, if there are any.

    Attributes:
        indefinite: Whether A₀ or H proves that A has negative eigenvalues.
    """

    def __init__(
        self,
        space: AveragedSpace,
        copies: Copies,
        multiply: Multiply,
        vectors: RitzVectors | None,
        *,
        symmetric: bool = True,
    ) -> None:
        """Balance the vectors and multiply them with the present matrix. Collective.

        ``multiply(i, X)`` applies S_i to columns, (n_i, c) → (n_i, c), and S_iᵀ with
        ``transpose=True``.
        """
        self._space, self._copies, self._multiply = space, copies, multiply
        self.indefinite = bool(space.negative())
        with event("FETIRecycling"):
            vectors = vectors or RitzVectors(np.zeros((copies.n, 0)), np.zeros((copies.n, 0)))
            W = vectors.W.copy(order="F")
            SW = on_subdomains(lambda: _images(copies, multiply, W), copies.comm)
            for j in range(W.shape[1]):
                AW = copies.sum(SW[:, j])
                W[:, j] -= space.initial_guess(AW)  # W ← W − V A₀⁻¹ Vᵀ A W
            sizes = self._product(vectors.W, copies.delta[:, None] * vectors.W).diagonal()
            gram = self._product(W, copies.delta[:, None] * W)
            squares, Y = on_all(lambda: np.linalg.eigh(gram), copies.comm)
            Y = Y[:, squares > INSIDE * sizes.max(initial=0.0)]
            self._W, self._Q = W @ Y, vectors.Q @ Y
            transposed = partial(multiply, transpose=not symmetric)
            self._SW = on_subdomains(lambda: _images(copies, transposed, self._W), copies.comm)
            self._H = self._product(self._SW, self._W)  # H = Wᵀ A W
            values, Y, self._inverse = on_all(self._inverted, copies.comm)
            if values.min(initial=0.0) < 0.0:
                v = self._W @ Y[:, 0]  # vᵀ A v = values[0]
                self.indefinite |= bool(values[0] < -MARGIN * self.rounding(v))

    def _inverted(self) -> tuple[Array, Array, Array]:
        """Return the values and combinations that diagonalise H, and H⁻¹."""
        values, Y = diagonalising(self._H, LOST_ENERGY)
        return values, Y, Y @ np.linalg.solve(Y.T @ self._H @ Y, Y.T)

    @property
    def count(self) -> int:
        """Number of vectors W."""
        return self._W.shape[1]

    def initial_guess(self, r: Array) -> Array:
        """Return the x of V and W that leaves r − A x orthogonal to both, (n,). Collective."""
        x = self._space.initial_guess(r)
        if not self.count:
            return x
        own = self._W.T @ (self._copies.delta * r) - self._SW.T @ x
        return np.asarray(x + self._W @ (self._inverse @ total_of(own, self._copies.comm)))

    def correct_with_product(self, z: Array, r: Array) -> tuple[Array, float]:
        """Return z ← z + V A₀⁻¹ Vᵀ (r − A z), then z + W H⁻¹ Wᵀ (r − A z), (n,), and rᵀ of it.

        All by copies; both products of W and that with r take one reduction. Collective.
        """
        z, r = self._space.correct(z, r), self._copies.delta * r
        own = np.concatenate([[r @ z], self._W.T @ r, self._SW.T @ z])
        product, of_r, of_z = np.split(total_of(own, self._copies.comm), [1, 1 + self.count])
        c = self._inverse @ (of_r - of_z)
        return np.asarray(z + self._W @ c), float(product[0] + of_r @ c)

    def ritz_vectors(self, trace: Trace, *, most: int) -> RitzVectors:
        """Choose at most ``most`` vectors that the iterations leave to later solves. Collective."""
        k = len(trace.Z)
        if k < 1:
            return RitzVectors(self._W, self._Q)
        Z, R, δ = trace.Z.T, trace.R.T, self._copies.delta[:, None]
        G = self._product(Z, δ * R)  # Zᵀ R, (k, k + 1)
        N = self._product(δ * self._Q, Z)  # N = Qᵀ Z
        if not (np.isfinite(G).all() and np.isfinite(N).all()):
            return RitzVectors(self._W, self._Q)
        T_W, T_Z = on_all(lambda: self._softest(G, N, trace.H, most), self._copies.comm)
        return RitzVectors(
            np.asfortranarray(self._W @ T_W + Z @ T_Z),
            np.asfortranarray(self._Q @ (T_W + N @ T_Z) + R[:, :k] @ T_Z),  # M⁻¹ Z = R + Q N
        )

    def _softest(self, G: Array, N: Array, H: Array, most: int) -> tuple[Array, Array]:
        """Return the combinations of W and Z that are Ritz vectors of small values."""
        k, r = N.shape[1], self.count
        A = scipy.linalg.block_diag(self._H, G @ H)  # Zᵀ A Z = Zᵀ R H
        S = np.block([[np.eye(r), N], [N.T, symmetric_part(G[:, :k]) + N.T @ N]])
        values, T = diagonalising(S, LOST_ENERGY)
        T /= np.sqrt(np.abs(values))  # Tᵀ S T = I
        θ, Y = np.linalg.eigh(symmetric_part(T.T @ A @ T))
        T_W, T_Z = np.split(T @ Y[:, : min(most, np.count_nonzero(θ < DEFLATED))], [r])
        return T_W, T_Z

    def memory(self) -> float:
        """Return the memory of the vectors of this process in MiB."""
        return (self._W.nbytes + self._SW.nbytes + self._Q.nbytes) / 2**20

    def rounding(self, v: Array) -> float:
        """Return a bound of the rounding errors of vᵀ A v, by copies, (n,). Collective."""
        copies = self._copies
        norms = on_subdomains(lambda: estimated_norms(copies, self._multiply), copies.comm)
        squares = [float(v[rows] @ v[rows]) for rows in copies.blocks]
        return EPS * total(float(np.dot(norms, squares)), copies.comm)

    def _product(self, X: Array, Y: Array) -> Array:
        """Return Xᵀ Y over all processes."""
        return total_of(X.T @ Y, self._copies.comm)


def _images(copies: Copies, multiply: Callable[[int, Array], Array], W: Array) -> Array:
    """Return S W, (n, k)."""
    SW = np.empty_like(W)
    for i, rows in enumerate(copies.blocks):
        SW[rows] = multiply(i, W[rows])
    return SW


def soft_fields(
    space: AveragedSpace, copies: Copies, multiply: Solve, solve: Solve, *, count: int
) -> RitzVectors:
    """Return ``count`` softest fields of V at most, corrected, W = M A V c. Collective.

    ``multiply(i, X)`` applies S_i to columns, (n_i, k) → (n_i, k), and ``solve`` S_ρ⁻¹.
    """
    V, δ, comm = space.V, copies.delta[:, None], copies.comm
    e = np.random.default_rng(comm.rank).standard_normal((V.size, min(count, V.total)))
    for step in range(INVERSE):
        c = _each(space.solve, e, V.size)  # c = A₀⁻¹ e
        X = _each(V.prolong, c, copies.n)  # V c
        X = X @ _unit_energy(total_of(X.T @ (δ * X), comm), comm)
        if step < INVERSE - 1:
            e = _each(V.restrict, X, V.size)  # e ← Vᵀ V c
    SX = on_subdomains(lambda: _images(copies, multiply, X), comm)
    Q = _each(copies.sum, SX, copies.n)  # Q = A V c
    Y = on_subdomains(lambda: _images(copies, solve, δ * Q), comm)
    W = _each(copies.average, Y, copies.n)  # W = M Q
    B = _unit_energy(total_of(W.T @ (δ * Q), comm), comm)  # Wᵀ Q = I
    return RitzVectors(np.asfortranarray(W @ B), np.asfortranarray(Q @ B))


def _unit_energy(H: Array, comm: MPI.Comm) -> Array:
    """Return combinations B with Bᵀ H B = I, (k, k) → (k, up to k). Collective."""
    θ, B = on_all(lambda: diagonalising(H, INSIDE), comm)
    return np.asarray(B[:, θ > 0.0] / np.sqrt(θ[θ > 0.0]))


def _each(apply: Callable[[Array], Array], X: Array, n: int) -> Array:
    """Apply a collective function to each column, (m, k) → (n, k)."""
    return np.array([apply(x) for x in X.T]).reshape(X.shape[1], n).T
