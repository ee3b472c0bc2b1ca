# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Recycling: what earlier solves found out shortens later ones.

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

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx_feti.events import event
from dolfinx_feti.feti.krylov.dual import ConstraintPreconditioner, DualOperator

__all__ = ["Recycling"]

Array = npt.NDArray[np.float64]

#: Share of the largest eigenvalue of a Gram matrix below which a direction counts as repeated.
REPEATED = 1e-10


class Recycling:
    """The dual system and its constraint preconditioner, deflated; contexts of a Mat and a PC.

    Attributes:
        most: Most directions that are kept.
    """

    def __init__(self, most: int) -> None:
        """Begin without directions.

        Args:
            most: Most directions that are kept; with 0 nothing is recorded.
        """
        self.most = most
        self._recording = True
        self._m = 0  # multipliers of this process
        self._operator: DualOperator
        self._constraint: ConstraintPreconditioner
        self._stale = False
        self._W: Array = np.zeros((0, 0))
        self._AW: Array = np.zeros((0, 0))
        self._CW: Array = np.zeros((0, 0))  # C⁻¹ W
        self._inverse: Array = np.zeros((0, 0))  # H⁻¹
        self._records: dict[str, list[Array]] = {}
        self._forget()

    @property
    def size(self) -> int:
        """Number of directions W."""
        return self._W.shape[1]

    def attach(self, operator: DualOperator, constraint: ConstraintPreconditioner) -> None:
        """Take over the dual system of a new matrix."""
        self._operator, self._constraint = operator, constraint
        self._m = operator.vector.lam.getLocalSize()
        self._stale = True

    def renew(self) -> None:
        """Choose W from what the last solve has left, and multiply it with the present matrix.

        Note:
            Collective.
        """
        with event("FETIRecycling"):
            lam = self._W[: self._m]
            if self._records["X"]:
                lam, self._stale = self._ritz_vectors(), True
            if self._stale:
                self._W = self._constraint.balance(lam)
            if self._stale and self.size:
                self._AW = self._operator.jumps(self._W)
                H = self._product(self._W[: self._m], self._AW)
                if np.isfinite(H).all():
                    self._inverse = _pseudo_inverse(H)
                else:
                    self._W = self._W[:, :0]
        self._stale = False
        self._forget()

    def start(self, b: PETSc.Vec) -> Array:
        """Solve on W, return x₀ = W H⁻¹ Wᵀ b, and leave the rest in b ← b − 𝒜 x₀."""
        if self.size == 0:
            return np.zeros(b.getLocalSize())
        m = self._m
        c = self._inverse @ self._product(self._W[:m], b.array_r[:m])
        b.array[:m] -= self._AW @ c
        return np.asarray(self._W @ c)

    def mult(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Apply the dual system, y = 𝒜 x."""
        self._operator.mult(mat, x, y)
        self._record(X=x, AX=y)

    def apply(self, pc: PETSc.PC, r: PETSc.Vec, z: PETSc.Vec) -> None:
        """Apply the deflated preconditioner, z = (I − W H⁻¹ (𝒜 W)ᵀ) C r."""
        self._constraint.apply(pc, r, z)
        self._record(R=r, Z=z)
        if self.size:
            overlap = self._product(self._AW, z.array_r[: self._m])  # (𝒜 W)ᵀ C r
            z.array[:] -= self._W @ (self._inverse @ overlap)

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Let products go by unrecorded for a while."""
        self._recording = False
        try:
            yield
        finally:
            self._recording = True

    def _record(self, **vectors: PETSc.Vec) -> None:
        """Keep the multipliers of some vectors, as long as there is room."""
        for name, vector in vectors.items():
            columns = self._records[name]
            if self._recording and len(columns) < self.most:
                columns.append(vector.array_r[: self._m].copy())

    def _forget(self) -> None:
        self._records = {name: [] for name in ("X", "AX", "R", "Z")}

    def _ritz_vectors(self) -> Array:
        """Find the Ritz vectors of the largest Ritz values of C 𝒜, (m, at most ``most``)."""
        n = min(map(len, self._records.values()))
        X, AX, R, Z = (np.column_stack(self._records[name][:n]) for name in ("X", "AX", "R", "Z"))
        sizes = np.array([np.diag(self._product(R, Z)), np.diag(self._product(X, AX))])
        sound = np.all(np.isfinite(sizes) & (sizes != 0.0), axis=0)  # a solve may end in NaN
        X, AX, R, Z = (vectors[:, sound] for vectors in (X, AX, R, Z))
        none = np.zeros((self._m, 0))
        W, AW, CW = (self._W[: self._m], self._AW, self._CW) if self.size else (none, none, none)
        P, AP = np.hstack([W, X]), np.hstack([AW, AX])
        V, Q = np.hstack([W, Z]), np.hstack([CW, R])
        scale = _to_one(np.diag(self._product(V, Q)))  # CG's residuals become small
        V, Q = V * scale, Q * scale
        cross = self._product(AP, V)
        H = cross.T @ _pseudo_inverse(self._product(P, AP)) @ cross  # Vᵀ 𝒜 V
        S = self._product(V, Q)  # Vᵀ C⁻¹ V
        values, vectors = np.linalg.eigh(0.5 * (S + S.T))
        there = values > REPEATED * np.abs(values).max(initial=0.0)
        T = vectors[:, there] / np.sqrt(values[there])
        θ, Y = np.linalg.eigh(T.T @ H @ T)
        T = T @ Y[:, np.argsort(-np.abs(θ))[: self.most]]
        self._CW = Q @ T
        return V @ T

    def _product(self, X: Array, Y: Array) -> Array:
        """Return Xᵀ Y over all processes."""
        return np.asarray(self._operator.vector.comm.allreduce(X.T @ Y))


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
