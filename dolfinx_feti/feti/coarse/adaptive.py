# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Adaptive columns (GenEO): displacements whose average has much more energy than themselves.

.. math:: δ\, T_i A\, T_i^⊤ δ\, u = χ\, S_ρ\, u, \quad χ > χ_0

on the interface of subdomain i, (n_{Γ,i},): χ is the energy of :math:`T^⊤ δ\, u`, what the
subdomain contributes to an average, over that of u. The eigenvectors (Spillane and Rixen,
*IJNME* 95, 2013; docs/theory.md, *Adaptive columns*) are approximated by the
Rayleigh–Ritz method in a block Krylov space

.. math:: X_k = S_ρ^{-1} F_k, \qquad F_{k+1} = P\, δ\, T_i A\, T_i^⊤ δ\, X_k, \qquad
          P = I - Q Q^⊤, \quad Q^⊤ Q = I, \quad \operatorname{span} Q = \operatorname{span} U_0,

from random forces F₀. :math:`U_0` are the other coarse columns of the subdomain, E for instance. P
removes the forces that do work on them, :math:`U_0^⊤ F = 0`: the coarse space balances these
already.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from dolfinx_feti.feti.interface.copies import Copies
from dolfinx_feti.feti.subdomain.failures import on_subdomains
from dolfinx_feti.runtime.arrays import Array

#: ``multiply(X)`` returns the product of a matrix, (n, n), with columns X, (n, k).
Multiply = Callable[[Array], Array]

#: ``multiply(i, X)`` returns the product of subdomain i's matrix, (n_i, n_i), with X, (n_i, k).
MultiplyOnSubdomain = Callable[[int, Array], Array]

#: Bound χ₀: an eigenvector with a larger χ becomes a column. A smaller bound makes the coarse space
#: larger, a larger one lets it miss negative eigenvalues of A, which Newton's method has to detect.
#: With 4.5 or 5, load steps of a block take 4 to 10 % less time and those of a vessel and a tube 0
#: to 3 % less; but a first solve under load takes 47 iterations instead of 39, and an inflated ball
#: fails unless each Newton step may be repeated four times.
ENERGY_RATIO_THRESHOLD = 3.5

#: Smallest number of steps of the Krylov method. More steps make the eigenvectors more accurate.
#: With 4 to 12 steps in place of 3 to 9, load steps of a vessel take 4 %, those of a tube 3 % and
#: those of a block 20 % more time.
MIN_STEPS = 3

#: Largest number of steps: another one follows while more than half of the Ritz values are above
#: χ₀. Each step adds 1/MAX_STEPS of the largest number of columns of the subdomain, so that all
#: steps together can find as many. Measured with :data:`MIN_STEPS`.
MAX_STEPS = 9

#: Interface dofs from which on a subdomain may have the largest number of columns. One with fewer
#: dofs may have a proportional number: one column for six dofs with the default of 108. It bounds
#: the coarse matrix of many small subdomains. A block of 27 subdomains with jumps of 1e3 takes 28,
#: 35 and 50 iterations with half, once and twice of it, on 1270, 1034 and 730 columns; a tube of 32
#: takes 26, 26 and 33.
INTERFACE_DOFS_FOR_ALL_COLUMNS = 640

#: Energy up to which a combination of columns of unit energy counts as dependent on the others.
#: Columns with a large χ are orthonormal only up to rounding amplified by χ; this keeps the
#: combinations that are accurate to half of the digits. The square root of the rounding unit. Half
#: and twice of it change iterations only with jumps of 1e8: 161 and 181 instead of 178.
DEPENDENT_ENERGY = 1e-8

#: Norm of P f up to which it is rounding, for a force of norm one that U₀ balances. The square root
#: of the rounding unit, between EPS and the norms of other forces. Half and twice of it change no
#: iteration of a tube, nor of blocks with jumps of 1e3 and 1e8.
FORCE_ROUNDING = 1e-8

#: Smallest norm or energy that is divided by: zero forces remain zero.
TINY = np.finfo(float).tiny


def adaptive_columns(
    copies: Copies,
    multiply_A: MultiplyOnSubdomain,
    solve_S: MultiplyOnSubdomain,
    U_0: Sequence[Array],
    *,
    max_columns: int,
    threshold: float = ENERGY_RATIO_THRESHOLD,
) -> list[Array]:
    """Compute the adaptive columns of each subdomain. Collective.

    Args:
        copies: Copies of the interface dofs, with the weights δ.
        multiply_A: Product with :math:`T_i A T_i^⊤`; not collective. It is called for one subdomain
            after the other.
        solve_S: Product with :math:`S_{ρ,i}^{-1}`, likewise. It is applied to forces F with
            U₀ᵀ F = 0 only.
        U_0: All other coarse columns of each subdomain, (n_{Γ,i}, any number).
        max_columns: Largest number of columns of a subdomain.
        threshold: The bound χ₀.

    Returns:
        U_i of each subdomain with U_iᵀ S_ρ U_i = I, largest χ first, (n_{Γ,i}, ≤ max_columns).

    Raises:
        SetUpError: An operation failed on some subdomain; on all processes.
    """

    def columns(i: int) -> Array:
        """Compute U_i."""
        rows = copies.rows[i]
        δ = copies.delta[rows][:, None]
        return _columns_of_subdomain(
            multiply_average=lambda X: δ * multiply_A(i, δ * X),  # δ T_i A T_iᵀ δ X
            solve=lambda F: solve_S(i, F),
            U_0=U_0[i],
            max_columns=_max_columns_of(rows.stop - rows.start, max_columns),
            threshold=threshold,
        )

    return on_subdomains(lambda: [columns(i) for i in range(len(copies.rows))], copies.comm)


def _max_columns_of(n: int, max_columns: int) -> int:
    """Return the largest number of adaptive columns of one subdomain, in proportion to its dofs.

    Args:
        n: Number of its interface dofs, n_{Γ,i}.
        max_columns: Largest number of columns of any subdomain.

    Returns:
        The number in proportion to n, but at least ``MAX_STEPS``, as each step computes a column;
        no more than n or ``max_columns``.
    """
    in_proportion = max_columns * n // INTERFACE_DOFS_FOR_ALL_COLUMNS
    return min(max_columns, n, max(MAX_STEPS, in_proportion))


def _columns_of_subdomain(
    *, multiply_average: Multiply, solve: Multiply, U_0: Array, max_columns: int, threshold: float
) -> Array:
    """Compute the adaptive columns of one subdomain.

    Args:
        multiply_average: Product with δ T_i A T_iᵀ δ.
        solve: Product with S_ρ⁻¹.
        U_0: Its other coarse columns, (n, any number).
        max_columns: Largest number of columns.
        threshold: The bound χ₀.

    Returns:
        U with Uᵀ S_ρ U = I, largest χ first, (n, ≤ max_columns).
    """
    n = len(U_0)
    if max_columns == 0:
        return np.zeros((n, 0))
    block_size = -(-max_columns // MAX_STEPS)  # rounded up
    space = _KrylovSpace(
        multiply_average=multiply_average,
        solve=solve,
        Q=np.linalg.qr(U_0)[0],
        n=n,
        max_size=MAX_STEPS * block_size,
    )
    # The same random numbers in each run, wherever the subdomain is.
    forces = np.random.default_rng(n).standard_normal((n, block_size))  # F₀
    for step in range(1, MAX_STEPS + 1):
        forces = space.extend(forces)
        if step >= MIN_STEPS and not space.is_mostly_above(threshold):
            break
    return space.ritz_vectors(threshold)[:, :max_columns]


class _KrylovSpace:
    """Growing space of columns U of one subdomain, with Uᵀ S_ρ U = I up to rounding.

    A large χ amplifies these rounding errors. :meth:`ritz_vectors` takes them into account:
    it uses the computed Uᵀ S_ρ U, and not I.
    """

    def __init__(
        self, *, multiply_average: Multiply, solve: Multiply, Q: Array, n: int, max_size: int
    ) -> None:
        """Create an empty space.

        Args:
            multiply_average: Product with δ T_i A T_iᵀ δ.
            solve: Product with S_ρ⁻¹.
            Q: Orthonormal basis of the span of U₀, (n, any number).
            n: Number of interface dofs of the subdomain.
            max_size: Largest number of columns of all calls of :meth:`extend` together.
        """
        self._multiply_average = multiply_average
        self._solve = solve
        self._Q = Q
        self._size = 0
        self._U = np.empty((n, max_size), order="F")
        self._SU = np.empty((n, max_size), order="F")  # S_ρ U
        self._energy = np.empty((max_size, max_size))  # Uᵀ S_ρ U, upper triangle
        self._average_energy = np.empty((max_size, max_size))  # Uᵀ δ T_i A T_iᵀ δ U, upper triangle

    def extend(self, forces: Array) -> Array:
        """Append S_ρ⁻¹ P F for forces F, orthonormalised.

        Args:
            forces: F, (n, k). Forces that U₀ balances, and columns that depend on others, are
                left out.

        Returns:
            Forces of the next step, δ T_i A T_iᵀ δ U of the new columns, (n, ≤ k).
        """
        SX = self._without_balanced_part(forces)  # S_ρ X = P F
        X = self._solve(SX)
        norm = np.sqrt(np.maximum(np.sum(X * SX, axis=0), TINY))  # (xᵀ S_ρ x)^½
        X = X / norm
        SX = SX / norm

        U = self._U[:, : self._size]
        SU = self._SU[:, : self._size]
        overlap = U.T @ SX  # Uᵀ S_ρ X
        X = X - U @ overlap
        SX = SX - SU @ overlap

        B = _unit_energy(X.T @ SX)  # Bᵀ (Xᵀ S_ρ X) B = I
        return self._append(X @ B, SX @ B)

    def _without_balanced_part(self, forces: Array) -> Array:
        """Return P F of forces scaled to norm one, without columns that are rounding, (n, ≤ k)."""
        F = forces / np.maximum(np.linalg.norm(forces, axis=0), TINY)
        PF = F - self._Q @ (self._Q.T @ F)  # P F
        return PF[:, np.linalg.norm(PF, axis=0) > FORCE_ROUNDING]

    def _append(self, X: Array, SX: Array) -> Array:
        """Append columns X, with S_ρ X, both (n, k), and return δ T_i A T_iᵀ δ X, (n, k)."""
        new = slice(self._size, self._size + X.shape[1])
        self._size = new.stop
        self._U[:, new] = X
        self._SU[:, new] = SX
        U = self._U[:, : self._size]
        forces = self._multiply_average(self._U[:, new])
        self._energy[: self._size, new] = U.T @ self._SU[:, new]
        self._average_energy[: self._size, new] = U.T @ forces
        return forces

    def is_mostly_above(self, threshold: float) -> bool:
        """Return True if more than half of the Ritz values χ are above a threshold.

        Uᵀ S_ρ U is taken to be I: the rounding errors of a few values do not change the majority.
        """
        χ = np.linalg.eigvalsh(self._average_energy[: self._size, : self._size], UPLO="U")
        return 2 * np.count_nonzero(χ > threshold) > len(χ)

    def ritz_vectors(self, threshold: float) -> Array:
        """Return the Ritz vectors with χ above a threshold, largest first, (n, ≤ size)."""
        U = self._U[:, : self._size]
        upper = self._average_energy[: self._size, : self._size]
        average_energy = np.triu(upper) + np.triu(upper, 1).T
        B = _unit_energy(self._energy[: self._size, : self._size])
        χ, Y = np.linalg.eigh(B.T @ average_energy @ B)
        descending = np.flatnonzero(χ > threshold)[::-1]
        return np.asarray(U @ (B @ Y[:, descending]))


def _unit_energy(H: Array) -> Array:
    """Return combinations B of columns with Bᵀ H B = I, without those that depend on others.

    Args:
        H: Energies of the columns, Uᵀ S_ρ U, (k, k), of which the upper triangle is read.

    Returns:
        B, (k, ≤ k).
    """
    θ, B = np.linalg.eigh(H, UPLO="U")
    is_independent = θ > DEPENDENT_ENERGY
    return np.asarray(B[:, is_independent] / np.sqrt(θ[is_independent]))
