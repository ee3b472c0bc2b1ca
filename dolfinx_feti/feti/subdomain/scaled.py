# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The matrix of one subdomain, scaled if its diagonal spans many orders of magnitude.

.. math:: \hat K = s^{-1} K s^{-1}, \quad s^2 = d / \bar d, \qquad
          K_ρ = K + ρ\, R R^⊤, \quad R = s \hat R, \quad E = s^{-1} \hat E

with the absolute diagonal d, its mean :math:`\bar d`, and orthonormal columns :math:`\hat R`; D is
the same for both matrices. An example is a body with a void (docs/theory.md): with orthonormal R,
:math:`ρ\, R R^⊤` would be far stiffer than the void. If the diagonal spans few orders of magnitude,
s = 1 and :math:`\hat K = K`. The modes are those of :math:`\hat K`; ``soft_modes`` and
``mode_search`` omit the hats.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_feti.feti.subdomain.factors.cholesky import SINGLE_ROUNDING
from dolfinx_feti.feti.subdomain.factors.protocol import Factor, FactorInertia
from dolfinx_feti.feti.subdomain.kernel_detection import (
    EXACTLY_NULL,
    MAX_DIAGONAL_RATIO,
    NEARLY_NULL,
    NullTolerances,
)
from dolfinx_feti.feti.subdomain.matrix import SubdomainMatrix
from dolfinx_feti.feti.subdomain.null_vectors import growth, is_numerically_singular, null_vectors
from dolfinx_feti.feti.subdomain.orthonormal import orthonormal
from dolfinx_feti.runtime.arrays import Array

#: Largest relative error of a solve in single precision that a preconditioner may have. The error
#: is estimated by the growth of random vectors times :data:`SINGLE_ROUNDING`. A tube of 12
#: subdomains at 80 mmHg takes 416 iterations with this bound, with half of it, and with twice of
#: it. In double precision, which needs twice the memory, it takes 415.
MAX_SINGLE_PRECISION_ERROR = 0.1


@dataclass(frozen=True, slots=True)
class ScaledFactor:
    """Factor of a scaled matrix, by that of the unscaled one; methods are those of ``Factor``.

    Attributes:
        unscaled: Factor of the same matrix before it was scaled, s K̂ s.
        scale: s, (n_i,); None for ones.
        is_well_conditioned: Whether a test has shown that random vectors grow little in a solve
            (:data:`MAX_SINGLE_PRECISION_ERROR`): the matrix is regular, and none of its modes is
            soft. False if the test has failed, or was not made.
    """

    unscaled: Factor
    scale: Array | None
    is_well_conditioned: bool = False

    @property
    def inertia(self) -> FactorInertia:
        """Numbers of negative eigenvalues and zero pivots, which scaling does not change."""
        return self.unscaled.inertia

    @property
    def is_single_precision(self) -> bool:
        """Whether the factor is in single precision."""
        return self.unscaled.is_single_precision

    def solve(self, Y: Array, *, transpose: bool = False) -> Array:
        """Return s K⁻¹ s Y, (n_i,) or (n_i, r), where K is the matrix of ``unscaled``."""
        X = self.unscaled.solve(_multiply_rows(self.scale, Y), transpose=transpose)
        return _multiply_rows(self.scale, X)

    def memory(self) -> float:
        """Return the memory of the factor in MiB."""
        return self.unscaled.memory()

    def destroy(self) -> None:
        """Free the factor."""
        self.unscaled.destroy()


@dataclass(frozen=True, slots=True)
class ScaledMatrix:
    """K̂ = s⁻¹ K s⁻¹, where K is K_i or S_i of one subdomain. Vectors and modes are those of K̂.

    Attributes:
        matrix: K.
        scale: s, (n_i,); None for ones.
        diagonal_of_K: Absolute diagonal d/s² of K̂_i, even if the matrix is Ŝ_i, (n_i,).
        stiffness: Stiffness k_Γ/s² of the interface dofs, zero on other dofs, (n_i,). It excludes
            the stiffness that a condensed pressure adds.
        allow_single_precision: Whether a factor for a preconditioner may be in single precision.
    """

    matrix: SubdomainMatrix
    scale: Array | None
    diagonal_of_K: Array
    stiffness: Array
    allow_single_precision: bool

    @property
    def null_tolerances(self) -> NullTolerances:
        """Tolerances of null vectors. In a scaled matrix modes with little energy are included."""
        return EXACTLY_NULL if self.scale is None else NEARLY_NULL

    def scale_modes(self, R: Array) -> Array:
        """Return orthonormal modes R̂ of K̂ for orthonormal modes R of K: a basis of s R."""
        return R if self.scale is None else orthonormal(self.scale[:, None] * R)

    def unscaled_forces(self, X: Array) -> Array:
        """Return s X, (n_i,) or (n_i, r): forces X in the system with K.

        R and Y are transformed like forces: K + ρ R Rᵀ = s (K̂ + ρ R̂ R̂ᵀ) s.
        """
        return _multiply_rows(self.scale, X)

    def unscaled_displacements(self, X: Array) -> Array:
        """Return s⁻¹ X, (n_i,) or (n_i, r): displacements X, such as E, in the system with K."""
        return X if self.scale is None else (X.T / self.scale).T

    def multiply(self, X: Array) -> Array:
        """Return K̂ X, (n_i, r)."""
        scaled = self.unscaled_displacements(X)
        return self.unscaled_displacements(self.matrix.multiply(scaled))  # s⁻¹ K s⁻¹ X

    def factor(self, R: Array, rho: float, shift: Array | None = None) -> ScaledFactor:
        """Factor K̂ + ρ R Rᵀ + diag(shift), in double precision.

        Args:
            R: Columns, (n_i, k); orthonormal unless there is a shift.
            rho: The stiffness ρ.
            shift: Entries that are added to the diagonal, (n_i,).
        """
        is_graded = self.scale is not None
        if shift is not None and self.scale is not None:
            shift = shift * self.scale**2
        columns = self.unscaled_forces(R)
        unscaled = self.matrix.factor(columns, rho, shift, is_graded=is_graded)
        return ScaledFactor(unscaled, self.scale)

    def factor_for_preconditioner(self, R: Array, rho: float) -> ScaledFactor:
        """Factor K̂ + ρ R Rᵀ, in single precision if that is allowed and accurate enough."""
        if not self.allow_single_precision:
            return self.factor(R, rho)
        unscaled = self.matrix.factor_for_preconditioner(self.unscaled_forces(R), rho)
        if not unscaled.is_single_precision:
            return ScaledFactor(unscaled, self.scale)
        error = growth(unscaled, self.matrix.diagonal_of_K) * SINGLE_ROUNDING
        if not error <= MAX_SINGLE_PRECISION_ERROR:  # or it is NaN
            unscaled.destroy()
            return self.factor(R, rho)
        return ScaledFactor(unscaled, self.scale, is_well_conditioned=True)

    def is_singular(self, factor: ScaledFactor) -> bool:
        """Return True if the factored matrix is singular within ``null_tolerances``."""
        d = self.matrix.diagonal_of_K
        return is_numerically_singular(factor.unscaled, d, self.null_tolerances)

    def null_vectors(self, R: Array) -> Array:
        """Return the null vectors of K̂ other than orthonormal modes R, (n_i, r), of any norm."""

        def factor_shifted(B: Array, shift: Array) -> ScaledFactor:
            return self.factor(B, 1.0, shift)

        return null_vectors(
            self.multiply, factor_shifted, self.diagonal_of_K, R, self.null_tolerances
        )


def _multiply_rows(scale: Array | None, X: Array) -> Array:
    """Return s X, (n_i,) or (n_i, r); X if s is None."""
    return X if scale is None else (scale * X.T).T


def scale_matrix(
    matrix: SubdomainMatrix, stiffness: Array, *, allow_single_precision: bool
) -> ScaledMatrix:
    """Scale the matrix of a subdomain if its diagonal spans many orders of magnitude.

    Args:
        matrix: The matrix K, (n_i, n_i).
        stiffness: Stiffness of the interface dofs, zero on other dofs, (n_i,).
        allow_single_precision: Whether a factor for a preconditioner may be in single precision.
            The factor of a scaled matrix never is: rounding would lose its softest modes.
    """
    d = matrix.diagonal_of_K
    positive = d[d > 0.0]
    if not len(positive) or positive.max() <= MAX_DIAGONAL_RATIO * positive.min():
        return ScaledMatrix(matrix, None, d, stiffness, allow_single_precision)
    mean = positive.mean()
    scale = np.sqrt(np.where(d > 0.0, d, mean) / mean)
    return ScaledMatrix(
        matrix, scale, d / scale**2, stiffness / scale**2, allow_single_precision=False
    )
