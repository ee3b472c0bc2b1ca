# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The generalised inverse K⁺, exact under prestress.

With the orthonormal modes R of a subdomain, (n_i, k), and a stiffness ρ > 0, the regularised

.. math:: K_ρ = K + ρ\, R R^⊤, \qquad K^+ = K_ρ^{-1},

is regular and :math:`K K^+ K = K` as long as :math:`K R = 0`. Under prestress the rotations leave
the kernel. For *any* K, put :math:`s = R^⊤ u` and

.. math:: E = ρ\, K_ρ^{-1} R, \qquad D = ρ\, (I - R^⊤ E), \qquad
          u = K^+(f - B^⊤ λ) + E s, \qquad E^⊤(f - B^⊤ λ) = D s.

With :math:`K R = 0` these are :math:`E = R`, :math:`D = 0` and the paper's equations
(eq. 39, Augustin_eq:localSolutions; eq. 40). A factor with pivots carries R as a border
(``factors``; fronts do otherwise, see ``regularised``), and one solve with the border yields E and
D at once, without cancellation:

.. math:: \begin{pmatrix} K & ρ R \\ ρ R^⊤ & -ρ I \end{pmatrix}
          \begin{pmatrix} E \\ -D/ρ \end{pmatrix} =
          \begin{pmatrix} 0 \\ ρ I \end{pmatrix}.

R is a function of the present matrix alone, so that a run that is restarted goes on like the one
that it continues. It holds

1. the rigid body modes that Dirichlet dofs leave (``kernel``),
2. the null vectors of K beyond them (``nullspace``), which count as kernel, too,
3. the modes in which the subdomain buckles, which makes K_ρ positive definite, with a ρ that lifts
   the most negative of them, and leaves the negative curvature to D; and soft ones, for speed
   (``enrichment``).

With the eigenvalues :math:`δ < 0` and eigenvectors y of D,

.. math:: K_+ = K + Z Z^⊤, \qquad Z = 2 R y \sqrt{-δ},

is positive semi-definite: these *props* hold a subdomain that would buckle alone, and the
preconditioner is built on them. (:math:`K + R y (-δ) y^⊤ R^⊤` would just do; the work hardly
depends on how much more there is.)

Fixing dofs (Brzobohatý et al. 2011) keep the sparsity as well, but are too weak a support: held in
a few points, a compressed subdomain still gives way, and K_ρ gets more negative eigenvalues.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from dolfinx_feti.errors import FactorError
from dolfinx_feti.events import event
from dolfinx_feti.feti.subdomain.blocks import named
from dolfinx_feti.feti.subdomain.direct import sum_pivots
from dolfinx_feti.feti.subdomain.enrichment import (
    Basis,
    Enrichment,
    append_orthonormal,
    buckling_modes,
    join,
    soft_modes,
)
from dolfinx_feti.feti.subdomain.kernel import kernel_basis
from dolfinx_feti.feti.subdomain.matrices import SubdomainMatrices
from dolfinx_feti.feti.subdomain.modes import Modes, SubdomainModes
from dolfinx_feti.feti.subdomain.nullspace import factor_tells_singular, null_space
from dolfinx_feti.torn import Torn

__all__ = ["PseudoInverse"]

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int32]

#: ‖K R‖ below this multiple of ‖K‖‖R‖ counts as zero: rounding of the assembly.
KERNEL_TOLERANCE = 1e-12

#: Rounds of enrichment of one subdomain for one matrix.
ENRICHMENTS = 3

#: ρ is at least this multiple of the most negative curvature that it has to lift above zero.
LIFT = 2.0

#: An eigenvalue of D above this multiple of −ρ counts as zero: rounding of the local solves.
DEFECT_TOLERANCE = 1e-13


class PseudoInverse:
    """K⁺ of every subdomain; S⁺ where the interior is eliminated.

    Attributes:
        fixed: Mask of the torn dofs that are fixed in the local matrices (classical), (n,).
        dofs: Torn dofs of each subdomain on which K⁺ lives: all free ones, or Γ.
    """

    def __init__(
        self,
        torn: Torn,
        matrices: SubdomainMatrices,
        fixed: npt.NDArray[np.bool_],
        glued: Indices,
        *,
        symmetric: bool,
        enrichment: Enrichment,
    ) -> None:
        """Take the matrices of the subdomains; nothing is factored yet.

        Args:
            torn: The torn matrix.
            matrices: The matrices of the subdomains, K or S.
            fixed: Mask of the torn dofs that are fixed in the local matrices, (n,).
            glued: Torn dofs of the interface.
            symmetric: Whether K is symmetric.
            enrichment: Which elastic modes join R.
        """
        self._torn = torn
        self._symmetric = symmetric
        self._matrices = matrices
        self._factors = matrices.factors
        self._free = [rows[~fixed[rows]] for rows in torn.subdomains]
        self._glued = np.zeros(torn.n, dtype=bool)
        self._glued[glued] = True
        self._enrichment = enrichment
        self.fixed = fixed
        self.dofs = matrices.dofs
        self._raised = 0  # negative eigenvalues that soft modes have made positive
        none = [np.zeros((len(dofs), 0)) for dofs in self.dofs]
        self._soft: list[tuple[Array, Array]] = [(Y, Y) for Y in none]  # Y and E_Y

    def update(self, near_kernel: Array, *, single: bool = False) -> Modes:
        """Find the modes of the current matrices and factor.

        Args:
            near_kernel: Rigid body modes on the torn dofs, (n, number of modes).
            single: Whether the factors are then stored in single precision, where that does; the
                modes are of double precision.

        Raises:
            FactorError: Some work on a subdomain failed. Not collective: the caller reduces.
        """
        weight = np.where(self._glued, self._torn.stiffness(), 0.0)
        candidates = [
            kernel_basis(near_kernel[dofs], self.fixed[dofs]) for dofs in self._torn.subdomains
        ]
        defects = self._defects(candidates)
        self._raised, found = 0, []
        for i, (R, defect) in enumerate(zip(candidates, defects, strict=True)):
            with named(self._torn.first + i):
                found.append(self._regularise(i, R, defect, weight[self.dofs[i]]))
                if single:
                    self._matrices.to_single(i)
        return Modes(self.dofs, tuple(found), self._symmetric)

    def solve(self, y: Array, *, up_to_soft_modes: bool = False) -> Array:
        """Apply the generalised inverse, K⁺ y, (n,), or K⁺ Y, (n, r); zero on fixed dofs.

        Several columns go through each factor together, which is read from memory once.

        Args:
            y: Forces on the torn dofs.
            up_to_soft_modes: Whether K⁺ y may have any share of E_Y, for y of one column.
        """
        x = np.zeros_like(y)
        if y.ndim == 1:
            with event("FETILocalSolve"):
                self._factors.solve(y, x)
            if up_to_soft_modes:
                return x
            for dofs, (Y, E_Y) in zip(self.dofs, self._soft, strict=True):
                if Y.shape[1]:
                    x_i = x[dofs]
                    x[dofs] = x_i - E_Y @ (Y.T @ x_i)
            return x
        for i, dofs in enumerate(self.dofs):
            x[dofs] = self.solve_many(i, y[dofs])
        return x

    def solve_many(self, i: int, Y: Array) -> Array:
        """Apply the generalised inverse of subdomain i to columns on its dofs, (n_i, r)."""
        X = self._factors.solve_many(i, Y)
        soft, E_soft = self._soft[i]
        return X - E_soft @ (soft.T @ X)

    def negative(self) -> int | None:
        """Count the negative eigenvalues of all K_ρ of this process; None if not known."""
        negative = sum_pivots(self._factors.pivots(i) for i in range(len(self.dofs))).negative
        return None if negative is None else negative - self._raised

    def _regularise(self, i: int, R: Array, defect: float, weight: Array) -> SubdomainModes:
        """Find the modes of subdomain i, and leave the factor of its K_ρ.

        Args:
            i: Number of the subdomain.
            R: Its rigid body modes on all free dofs, (n_free, k).
            defect: ‖K R‖.
            weight: Stiffness of its interface dofs, zero on the others, (n_i,).
        """
        scale = self._matrices.diagonal(i)
        rho = float(scale.mean()) if len(scale) else 1.0
        rigid = self._matrices.restrict(i, R)
        kernel = self._with_null_vectors(i, rigid, rho)
        R, rho = self._with_buckling_modes(i, kernel, rho)
        exact = defect <= KERNEL_TOLERANCE * rho and R is kernel
        basis = self._basis(i, R, rho, exact=exact)
        basis = self._with_soft_modes(i, basis, rho, weight)
        return SubdomainModes(
            *basis,
            props=basis.R @ _negative_directions(basis.D, rho),
            exact=exact and basis.R is kernel,
            rho=rho,
            rigid=rigid.shape[1],
            null=kernel.shape[1] - rigid.shape[1],
        )

    def _with_null_vectors(self, i: int, R: Array, rho: float) -> Array:
        """Factor K_ρ, and append to R the null vectors that it still has."""
        try:
            self._factors.update_block(i, R, rho)
            singular = self._is_singular(i)
        except FactorError:  # a solver that stops at a zero pivot
            singular = True
        if not singular:
            return R

        def multiply(X: Array) -> Array:
            return self._matrices.multiply_many(i, X)

        Y = null_space(self._factors, i, multiply, self._matrices.diagonal(i), R, rho)
        R = append_orthonormal(R, Y)
        self._factors.update_block(i, R, rho)
        if Y.shape[1] and self._is_singular(i):
            raise FactorError("the regularised matrix stays singular with its null vectors")
        return R

    def _is_singular(self, i: int) -> bool:
        """Tell whether the factored K_ρ of subdomain i is singular up to rounding."""
        return factor_tells_singular(self._factors, i, self._matrices.diagonal(i))

    def _with_buckling_modes(self, i: int, R: Array, rho: float) -> tuple[Array, float]:
        """Append buckling modes to R until K_ρ is positive definite, and factor it; return R, ρ."""
        for _ in range(ENRICHMENTS):
            negative = self._factors.pivots(i).negative
            if not (self._enrichment.buckling and negative):
                break
            more = append_orthonormal(R, self._buckling_modes(i, R, rho, negative))
            needed = max(rho, LIFT * self._most_negative(i, more))
            if more.shape[1] == R.shape[1] and needed == rho:
                break
            self._factors.update_block(i, more, needed)
            if self._is_singular(i):  # a border that the factor cannot tell from zero
                self._factors.update_block(i, R, rho)
                break
            R, rho = more, needed
        return R, rho

    def _buckling_modes(self, i: int, R: Array, rho: float, count: int) -> Array:
        """Approximate eigenvectors of negative eigenvalues of the factored K_ρ, (n_i, k)."""

        def solve(X: Array) -> Array:
            return self._factors.solve_many(i, X)

        def multiply(X: Array) -> Array:
            return self._matrices.multiply_many(i, X) + rho * (R @ (R.T @ X))  # K_ρ X

        return buckling_modes(solve, multiply, len(R), count)

    def _most_negative(self, i: int, R: Array) -> float:
        """Return −μ of the most negative eigenvalue μ of Rᵀ K R; below zero if all are positive."""
        values = np.linalg.eigvalsh(R.T @ self._matrices.multiply_many(i, R))
        return -float(values.min(initial=np.inf))

    def _with_soft_modes(self, i: int, basis: Basis, rho: float, weight: Array) -> Basis:
        """Let soft modes join R, by an update of the inverse."""
        choice = self._enrichment

        def solve(X: Array, *, transpose: bool = False) -> Array:
            return self._factors.solve_many(i, X, transpose=transpose)

        k = basis.R.shape[1]
        soft = soft_modes(solve, weight, choice.soft, choice.threshold)
        Y = append_orthonormal(basis.R, soft)[:, k:]
        if Y.shape[1]:
            Z = solve(Y)
            Z_left = Z if self._symmetric else solve(Y, transpose=True)
            basis = join(basis, Y, Z, Z_left, rho)
            C = basis.D[k:, k:]
            self._raised += int(np.count_nonzero(np.linalg.eigvalsh(C) < 0.0))  # Haynsworth
        self._soft[i] = basis.R[:, k:], basis.E[:, k:]
        return basis

    def _basis(self, i: int, R: Array, rho: float, *, exact: bool) -> Basis:
        """Return R with E and D of the factored K_ρ; R and 0 where K R = 0."""
        if exact:
            return Basis(R, R, R, np.zeros((R.shape[1], R.shape[1])))
        x, mu = self._factors.solve_border(i)
        E, D = rho * x, -(rho**2) * mu
        if self._symmetric:
            return Basis(R, E, E, 0.5 * (D + D.T))
        return Basis(R, E, rho * self._factors.solve_many(i, R, transpose=True), D)

    def _defects(self, R: Sequence[Array]) -> list[float]:
        """Return ‖K R‖ of every subdomain, and if it is larger ‖Kᵀ R‖."""
        images = [self._multiply(R)]
        if not self._symmetric:
            images.append(self._multiply(R, transpose=True))
        norms = [[float(np.linalg.norm(KR)) for KR in image] for image in images]
        return [max(of_one) for of_one in zip(*norms, strict=True)]

    def _multiply(self, X: Sequence[Array], *, transpose: bool = False) -> list[Array]:
        """Return K_i X_i on the free dofs of every subdomain."""
        columns = np.zeros((self._torn.n, max((X_i.shape[1] for X_i in X), default=0)))
        for dofs, X_i in zip(self._free, X, strict=True):
            columns[dofs, : X_i.shape[1]] = X_i
        image = self._torn.multiply(columns, transpose=transpose)
        return [image[dofs, : X_i.shape[1]] for dofs, X_i in zip(self._free, X, strict=True)]


def _negative_directions(D: Array, rho: float) -> Array:
    """Return 2 y √−δ for the eigenvalues δ < 0 of D, above rounding."""
    δ, y = np.linalg.eigh(0.5 * (D + D.T))
    negative = δ < -DEFECT_TOLERANCE * rho
    return np.asarray(2.0 * y[:, negative] * np.sqrt(-δ[negative]))
