# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Recycling: directions of earlier solves shorten later ones.

The dual systems of Newton's steps change little from one to the next. With pairs W from earlier
solves, :math:`𝒜` the dual system and C its constraint preconditioner (``dual``),

.. math:: x_0 = W H^{-1} W^⊤ b, \qquad z = (I - W H^{-1} (𝒜 W)^⊤)\, C r, \qquad H = W^⊤ 𝒜 W,

the residuals stay orthogonal to W and the directions :math:`𝒜`-orthogonal to it: the Krylov method
no longer sees that part of the spectrum (Saad et al. 2000). Large eigenvalues of :math:`C𝒜` are
what makes it slow, so W holds their Ritz vectors. They are taken from the span of the old W and the
preconditioned residuals Z = C R of a solve, V = (W, Z), with the directions P = (W, X) that it
multiplied and :math:`Q = C^{-1} V = (C^{-1} W, R)`,

.. math:: V^⊤ 𝒜 V = (V^⊤ 𝒜 P)(P^⊤ 𝒜 P)^{-1}(P^⊤ 𝒜 V), \qquad V^⊤ C^{-1} V = V^⊤ Q,

without a further product: V lies in the span of P, and what belongs to W in Q is carried along from
the solves that W came from (Gosselet et al. 2013 call it selective reuse).

The next matrix has other balanced pairs and another :math:`𝒜`. W is balanced and multiplied anew,
all columns at once, so that the factors are read from memory once: some forty columns cost about as
much as ten iterations.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dolfinx_feti.events import event
from dolfinx_feti.feti.krylov.dual import DualSystem

__all__ = ["DeflatedSystem", "Directions"]

Array = npt.NDArray[np.float64]

#: Share of the largest eigenvalue of a Gram matrix below which a direction counts as repeated.
REPEATED = 1e-10


@dataclass(frozen=True, slots=True)
class Directions:
    """What a solve leaves to later ones, as local parts.

    Attributes:
        lam: Multipliers of the directions W, (m, r).
        CW: C⁻¹ W, (m, r), as of the solves that W came from.
    """

    lam: Array
    CW: Array


class DeflatedSystem:
    """A dual system deflated by directions W; it records a solve, to choose the next ones.

    Attributes:
        comm: Communicator of the torn matrix.
        size: Multipliers and coarse unknowns of this process.
        exact: Whether D = 0.
        W: Balanced directions, (m + K, r).
        AW: Jumps of W, (m, r).
    """

    def __init__(self, system: DualSystem, directions: Directions | None, *, most: int) -> None:
        """Balance the directions and multiply them with the present matrix.

        Args:
            system: The dual system.
            directions: What earlier solves have left, if there were any.
            most: Most directions that are left to later solves.

        Note:
            Collective.
        """
        self._system, self._most = system, most
        self.comm, self.size, self.exact = system.comm, system.size, system.exact
        self._recording = True
        self._records: dict[str, list[Array]] = {name: [] for name in ("X", "AX", "R", "Z")}
        none = np.zeros((system.m, 0))
        self._CW = none if directions is None else directions.CW
        with event("FETIRecycling"):
            self.W = system.balance(none if directions is None else directions.lam)
            self.AW = system.jump(self.W) if self.count else none
            H = self._product(self.W[: system.m], self.AW)  # H = Wᵀ 𝒜 W
            if not np.isfinite(H).all():
                self.W, self.AW, self._CW, H = self.W[:, :0], none, none, H[:0, :0]
            self._inverse = _pseudo_inverse(H)  # H⁻¹

    @property
    def count(self) -> int:
        """Number of directions W."""
        return self.W.shape[1]

    def start(self, b: Array) -> tuple[Array, Array]:
        """Solve on W, x₀ = W H⁻¹ Wᵀ b; return x₀ and what is left, b − 𝒜 x₀, both (m + K,)."""
        m = self._system.m
        c = self._inverse @ self._product(self.W[:m], b[:m])
        rest = b.copy()
        rest[:m] -= self.AW @ c
        return self.W @ c, rest

    def multiply(self, x: Array) -> Array:
        """Apply the dual system, 𝒜 x, (m + K,)."""
        y = self._system.multiply(x)
        self._record(X=x, AX=y)
        return y

    def precondition(self, r: Array) -> tuple[Array, float]:
        """Apply the deflated preconditioner, z = (I − W H⁻¹ (𝒜 W)ᵀ) C r; see ``DualSystem``."""
        z, norm = self._system.precondition(r)
        self._record(R=r, Z=z)
        overlap = self._product(self.AW, z[: self._system.m])  # (𝒜 W)ᵀ C r
        return z - self.W @ (self._inverse @ overlap), norm

    def unbalanced(self, r: Array) -> float:
        """Return the residual of the assembled system that a residual leaves."""
        return self._system.unbalanced(r)

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Let products that are not the Krylov method's own go by unrecorded."""
        self._recording = False
        try:
            yield
        finally:
            self._recording = True

    def directions(self) -> Directions:
        """Choose what is left to later solves: Ritz vectors of the largest Ritz values of C 𝒜.

        Note:
            Collective.
        """
        m, n = self._system.m, min(map(len, self._records.values()))
        if n == 0:
            return Directions(self.W[:m], self._CW)
        X, AX, R, Z = (np.column_stack(self._records[name][:n]) for name in ("X", "AX", "R", "Z"))
        sizes = np.array([np.diag(self._product(R, Z)), np.diag(self._product(X, AX))])
        sound = np.all(np.isfinite(sizes) & (sizes != 0.0), axis=0)  # a solve may end in NaN
        X, AX, R, Z = (vectors[:, sound] for vectors in (X, AX, R, Z))
        P, AP = np.hstack([self.W[:m], X]), np.hstack([self.AW, AX])
        V, Q = np.hstack([self.W[:m], Z]), np.hstack([self._CW, R])
        scale = _to_one(np.diag(self._product(V, Q)))  # CG's residuals become small
        V, Q = V * scale, Q * scale
        cross = self._product(AP, V)
        H = cross.T @ _pseudo_inverse(self._product(P, AP)) @ cross  # Vᵀ 𝒜 V
        S = self._product(V, Q)  # Vᵀ C⁻¹ V
        values, vectors = np.linalg.eigh(0.5 * (S + S.T))
        there = values > REPEATED * np.abs(values).max(initial=0.0)
        T = vectors[:, there] / np.sqrt(values[there])
        θ, Y = np.linalg.eigh(T.T @ H @ T)
        T = T @ Y[:, np.argsort(-np.abs(θ))[: self._most]]
        return Directions(V @ T, Q @ T)

    def _record(self, **vectors: Array) -> None:
        """Keep the multipliers of some vectors, as long as there is room."""
        for name, vector in vectors.items():
            columns = self._records[name]
            if self._recording and len(columns) < self._most:
                columns.append(vector[: self._system.m].copy())

    def _product(self, X: Array, Y: Array) -> Array:
        """Return Xᵀ Y over all processes."""
        return np.asarray(self.comm.allreduce(X.T @ Y))


def _pseudo_inverse(H: Array) -> Array:
    """Invert a symmetric matrix, scaled to a unit diagonal, where it is not singular."""
    scale = _to_one(np.diag(H))
    values, vectors = np.linalg.eigh(scale[:, None] * (0.5 * (H + H.T)) * scale)
    there = np.abs(values) > REPEATED * np.abs(values).max(initial=0.0)
    Y = scale[:, None] * vectors[:, there]
    return np.asarray((Y / values[there]) @ Y.T)


def _to_one(d: Array) -> Array:
    """Return 1/√|d|, and zero for zero."""
    root = np.sqrt(np.abs(d))
    return np.divide(1.0, root, out=np.zeros_like(root), where=root > 0.0)
