# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Deflation: the coarse space V of the primal formulation, extended by further vectors W.

.. math:: x_0 = V A_0^{-1} V^⊤ b + W H^{-1} W^⊤ b, \qquad
          Π = (I - W H^{-1} W^⊤ A)(I - V A_0^{-1} V^⊤ A), \qquad H = W^⊤ A W, \quad V^⊤ A W = 0

(Saad, Yeung, Erhel, Guyomarc'h, A deflated version of the conjugate gradient algorithm, 2000;
docs/theory.md). The Krylov method converges as if the spectrum of A on the spans of V and W did not
exist: these are the *deflated* directions. W comes from ``ritz_vectors`` or ``soft_fields``. Here
it is made A-orthogonal to V (*balanced*) and multiplied with A, once for each matrix.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_feti.feti.coarse.primal_problem import PrimalCoarseProblem
from dolfinx_feti.feti.coarse.rounding import proves_indefinite
from dolfinx_feti.feti.interface.copies import Copies
from dolfinx_feti.feti.solve_info import DeflationVectors
from dolfinx_feti.feti.subdomain.failures import on_subdomains
from dolfinx_feti.feti.subdomain.orthonormal import diagonalise
from dolfinx_feti.feti.subdomain.schur_operator import SchurOperator
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_all, total_of
from dolfinx_feti.runtime.events import event

#: Smallest ‖·‖² of a balanced combination of vectors that counts as outside V, relative to the
#: largest ‖w‖² before balancing. Its square root 1e-5 is far above the rounding errors of
#: balancing, and far below the size of vectors outside V. A choice between both, where a factor of
#: two does not matter.
MIN_BALANCED_SQUARE = 1e-10

#: Smallest energy of a combination of vectors of unit energy that counts as independent of the
#: others. Products of vectors from iterations are accurate to about six digits only, as the
#: residuals lose their orthogonality by rounding. Half and twice of it change no iteration on the
#: artery path (``primal/__init__``).
MIN_INDEPENDENT_ENERGY = 1e-6


@dataclass(frozen=True, slots=True, weakref_slot=True)  # a test checks that it is freed
class DeflationSpace:
    """V, and vectors W that are A-orthogonal to it, for one matrix; vectors stored by copies.

    Attributes:
        coarse: V, Vᵀ A and A₀.
        S: Schur complements of the subdomains of this process.
        W: The vectors, balanced, (n_Γ, k).
        M_inverse_W: M⁻¹ W, with the M of the solves in which W was computed, (n_Γ, k).
        Y: Sᵀ W of every subdomain, which yields Wᵀ A z = Yᵀ z of copies z, (n_Γ, k).
        H: Wᵀ A W, (k, k).
        H_inverse: H⁻¹ on the span of the independent combinations of W, else zero, (k, k).
        is_indefinite: Whether A₀ or H proves that A has negative eigenvalues.
    """

    coarse: PrimalCoarseProblem
    S: SchurOperator
    W: Array
    M_inverse_W: Array
    Y: Array
    H: Array
    H_inverse: Array
    is_indefinite: bool

    @property
    def copies(self) -> Copies:
        """Copies of the interface dofs."""
        return self.coarse.copies

    @property
    def count(self) -> int:
        """Number k of vectors W."""
        return self.W.shape[1]

    def initial_guess(self, r: Array) -> Array:
        """Return x in the span of V and W with r − A x orthogonal to both, (n_Γ,). Collective.

        Args:
            r: Assembled right-hand side, (n_Γ,).
        """
        x = self.coarse.initial_guess(r)
        if not self.count:
            return x
        local = self.W.T @ (self.copies.delta * r) - self.Y.T @ x  # Wᵀ (r − A x)
        return np.asarray(x + self.W @ (self.H_inverse @ total_of(local, self.copies.comm)))

    def correct(self, z: Array, r: Array) -> tuple[Array, float]:
        """Correct z by V and then by W, and compute rᵀ z of the result. Collective.

        The scalar product shares the reduction that the correction by W needs.

        Args:
            z: Preconditioned residual M r, (n_Γ,).
            r: Residual, (n_Γ,).

        Returns:
            z ← z + V A₀⁻¹ Vᵀ (r − A z), then z ← z + W H⁻¹ Wᵀ (r − A z), (n_Γ,), and its product
            with r. For r = 0 this is Π z; the terms with r vanish if r is orthogonal to V and W.
        """
        z = self.coarse.correct(z, r)
        r = self.copies.delta * r
        local = np.concatenate([[r @ z], self.W.T @ r, self.Y.T @ z])
        sums = total_of(local, self.copies.comm)
        product, W_r, W_Az = np.split(sums, [1, 1 + self.count])  # rᵀ z, Wᵀ r, Wᵀ A z
        c = self.H_inverse @ (W_r - W_Az)
        return np.asarray(z + self.W @ c), float(product[0] + W_r @ c)

    def proves_indefinite(self, v: Array, energy: float) -> bool:
        """Return True if vᵀ A v is negative beyond rounding (``coarse.rounding``). Collective.

        Args:
            v: Assembled vector by its copies, (n_Γ,).
            energy: Its computed vᵀ A v.
        """
        return proves_indefinite(self.copies, self.S, v, energy)

    def memory(self) -> float:
        """Return the memory of the vectors of this process in MiB."""
        return (self.W.nbytes + self.Y.nbytes + self.M_inverse_W.nbytes) / 2**20


def create_deflation_space(
    coarse: PrimalCoarseProblem,
    S: SchurOperator,
    vectors: DeflationVectors | None,
    *,
    is_symmetric: bool = True,
) -> DeflationSpace:
    """Balance the vectors and multiply them with the current matrix. Collective.

    Combinations of the vectors that lie in V are dropped.

    Args:
        coarse: V, Vᵀ A and A₀ of the current matrix.
        S: Schur complements of the subdomains of this process.
        vectors: W and M⁻¹ W, (n_Γ, k) each; None for V alone.
        is_symmetric: Whether A is symmetric.
    """
    copies = coarse.copies
    comm = copies.comm
    with event("FETIRecycling"):
        if vectors is None:
            vectors = DeflationVectors(np.zeros((copies.size, 0)), np.zeros((copies.size, 0)))
        W = _balanced(coarse, S, vectors.W)
        B = _combinations_outside_V(copies, vectors.W, W)
        W = W @ B
        # Y = Sᵀ W
        Y = on_subdomains(lambda: S.multiply_columns(W, transpose=not is_symmetric), comm)
        H = total_of(Y.T @ W, comm)  # H = Wᵀ A W
        θ, B_θ, H_inverse = on_all(lambda: _diagonal_and_inverse(H), comm)
        is_indefinite = bool(coarse.negative_eigenvalues)
        if len(θ) and θ[0] < 0.0:
            v = W @ B_θ[:, 0]  # vᵀ A v = θ₀
            if proves_indefinite(copies, S, v, θ[0]):
                is_indefinite = True
    return DeflationSpace(
        coarse=coarse,
        S=S,
        W=W,
        M_inverse_W=vectors.M_inverse_W @ B,
        Y=Y,
        H=H,
        H_inverse=H_inverse,
        is_indefinite=is_indefinite,
    )


def _balanced(coarse: PrimalCoarseProblem, S: SchurOperator, W: Array) -> Array:
    """Return W − V A₀⁻¹ Vᵀ A W, (n_Γ, k). Collective."""
    copies = coarse.copies
    SW = on_subdomains(lambda: S.multiply_columns(W), copies.comm)
    balanced = W.copy(order="F")
    for j in range(W.shape[1]):
        balanced[:, j] -= coarse.initial_guess(copies.sum(SW[:, j]))
    return balanced


def _combinations_outside_V(copies: Copies, W: Array, balanced: Array) -> Array:
    """Return orthonormal combinations B of vectors W that V does not contain. Collective.

    Args:
        copies: Copies of the interface dofs.
        W: The vectors before balancing, (n_Γ, k).
        balanced: The vectors after it, (n_Γ, k).

    Returns:
        B, (k, up to k).
    """
    δ = copies.delta[:, None]
    before = total_of(W.T @ (δ * W), copies.comm).diagonal()  # ‖w‖²
    gram = total_of(balanced.T @ (δ * balanced), copies.comm)
    squares, B = on_all(lambda: np.linalg.eigh(gram), copies.comm)
    return np.asarray(B[:, squares > MIN_BALANCED_SQUARE * before.max(initial=0.0)])


def _diagonal_and_inverse(H: Array) -> tuple[Array, Array, Array]:
    """Diagonalise the symmetric part of H, and invert H on its independent combinations.

    Args:
        H: Wᵀ A W, (k, k), symmetric or not.

    Returns:
        θ, ascending, (r,); combinations B with Bᵀ H B = diag(θ) for the symmetric part of H,
        (k, r); and B (Bᵀ H B)⁻¹ Bᵀ, (k, k).
    """
    θ, B = diagonalise(H, MIN_INDEPENDENT_ENERGY)
    return θ, B, B @ np.linalg.solve(B.T @ H @ B, B.T)
