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
(eq. 39, Augustin_eq:localSolutions; eq. 40). The factor carries R as a border (``factors``), and
one solve with the border yields E and D at once, without cancellation:

.. math:: \begin{pmatrix} K & ρ R \\ ρ R^⊤ & -ρ I \end{pmatrix}
          \begin{pmatrix} E \\ -D/ρ \end{pmatrix} =
          \begin{pmatrix} 0 \\ ρ I \end{pmatrix}.

A few elastic modes may join R (``enrichment``): soft ones, for speed, and those that buckle, which
makes K_ρ positive definite and leaves the negative curvature to D. They stay in R for later
matrices. With the eigenvalues :math:`δ < 0` and eigenvectors y of D,

.. math:: K_+ = K + Z Z^⊤, \qquad Z = 2 R y \sqrt{-δ},

is positive semi-definite: these *props* hold a subdomain that would buckle alone, and the
preconditioner is built on them. (:math:`K + R y (-δ) y^⊤ R^⊤` would just do; the work hardly
depends on how much more there is.)

Fixing dofs (Brzobohatý et al. 2011) keep the sparsity as well, but are too weak a support: held in
a few points, a compressed subdomain still gives way, and K_ρ gets more negative eigenvalues.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from dolfinx_feti.feti.subdomain.enrichment import append_orthonormal, buckling_modes, soft_modes
from dolfinx_feti.feti.subdomain.kernel import kernel_basis
from dolfinx_feti.feti.subdomain.matrices import Interior
from dolfinx_feti.torn import Torn

__all__ = ["PseudoInverse"]

Array = npt.NDArray[np.float64]

#: ‖K R‖ below this multiple of ‖K‖‖R‖ counts as zero: rounding of the assembly.
KERNEL_TOLERANCE = 1e-12

#: Rounds of enrichment of one subdomain for one matrix.
ENRICHMENTS = 3

#: An eigenvalue of D above this multiple of −ρ counts as zero: rounding of the local solves.
DEFECT_TOLERANCE = 1e-13


class PseudoInverse:
    """K⁺ of every subdomain, with its kernel; S⁺ where the interior is eliminated.

    Attributes:
        fixed: Mask of the torn dofs that are fixed in the local matrices (classical), (n,).
        dofs: Torn dofs of each subdomain on which K⁺ lives: all free ones, or Γ.
        factors: The factors of K_ρ.
        rigid: Number of rigid body modes of each subdomain.
        R: For each subdomain the orthonormal modes, (n_i, k_i).
        E: For each subdomain the kernel or its regularised stand-in, (n_i, k_i).
        E_left: The same for :math:`K^⊤`; the identical list if K is symmetric.
        D: For each subdomain the defect of the kernel, (k_i, k_i); zero while K R = 0.
        props: For each subdomain the columns Z of K₊ = K + Z Zᵀ, (n_i, negative eigenvalues of D).
        exact: Whether K R = 0 holds, for each subdomain.
        rho: The stiffness ρ of each subdomain.
    """

    def __init__(
        self,
        torn: Torn,
        interior: Interior,
        fixed: npt.NDArray[np.bool_],
        *,
        symmetric: bool,
        buckling: bool,
        soft: int,
        threshold: float,
        weight: Array,
    ) -> None:
        """Take the matrices of the subdomains; nothing is factored yet.

        Args:
            torn: The torn matrix.
            interior: The matrix of each subdomain, K or S.
            fixed: Mask of the torn dofs that are fixed in the local matrices, (n,).
            symmetric: Whether K is symmetric.
            buckling: Let modes with a negative eigenvalue join R.
            soft: Most soft modes of a subdomain that join R.
            threshold: Share of the interface stiffness below which a mode is soft.
            weight: Stiffness of the interface dofs, zero on the others, (n,).
        """
        self._torn = torn
        self._symmetric = symmetric
        self._interior = interior
        self.fixed = fixed
        self.dofs = interior.dofs
        self.factors = interior.factors
        self._buckling = buckling and symmetric
        self._soft = [soft] * len(self.dofs)  # modes still to be looked for
        self._threshold = threshold
        self._weight = weight
        self._elastic: list[Array] = [np.zeros((len(dofs), 0)) for dofs in self.dofs]
        self.rigid: npt.NDArray[np.int64] = np.zeros(len(self.dofs), dtype=np.int64)
        self._dimensions: npt.NDArray[np.int64] = np.zeros(len(self.dofs), dtype=np.int64)
        self.R: list[Array] = []
        self.E: list[Array] = []
        self.E_left: list[Array] = []
        self.D: list[Array] = []
        self.props: list[Array] = []
        self.exact: list[bool] = []
        self.rho: Array = np.zeros(0)

    def update(self) -> None:
        """Find the kernels of the current K and factor.

        Raises:
            FactorError: A factorisation failed. Not collective: the caller reduces.
        """
        modes = self._torn.near_kernel()
        R = [kernel_basis(modes[dofs], self.fixed[dofs]) for dofs in self._torn.subdomains]
        self.rigid = np.array([R_i.shape[1] for R_i in R], dtype=np.int64)
        self._interior.update()
        self.rho = self._interior.norms()
        self.exact = self._test(R)
        R = [self._interior.restrict(i, R_i) for i, R_i in enumerate(R)]
        R = [append_orthonormal(R_i, Y) for R_i, Y in zip(R, self._elastic, strict=True)]
        self.factors.update(R, self.rho)
        self.R = [self._enriched(i, R_i) for i, R_i in enumerate(R)]
        self._dimensions = np.array([R_i.shape[1] for R_i in self.R], dtype=np.int64)
        self.E, self.D = self._stand_ins(transpose=False)
        self.props = [R_i @ Y for R_i, Y in zip(self.R, self._negative_directions(), strict=True)]
        self.E_left = self.E
        if not self._symmetric:
            self.E_left, _ = self._stand_ins(transpose=True)

    def solve(self, y: Array) -> Array:
        """Apply the generalised inverse, K⁺ y, (n,), or K⁺ Y, (n, r); zero on fixed dofs.

        Several columns go through each factor together, which is read from memory once.
        """
        x = np.zeros_like(y)
        if y.ndim == 1:
            self.factors.solve(y, x)
            return x
        for i, dofs in enumerate(self.dofs):
            x[dofs] = self.factors.solve_many(i, y[dofs])
        return x

    def kernel_dimensions(self) -> npt.NDArray[np.int64]:
        """Return k_i for each subdomain: rigid body modes and elastic modes that joined them."""
        return self._dimensions

    def negative_local(self) -> int | None:
        """Count the negative eigenvalues of all K_ρ of this process; None if not known."""
        inertia = self.factors.inertia()[:, 0]
        return None if np.any(inertia < 0) else int(inertia.sum())

    def negative_defects(self) -> int:
        """Count the negative eigenvalues of D on this process, above rounding."""
        return sum(Z.shape[1] for Z in self.props)

    def _enriched(self, i: int, R: Array) -> Array:
        """Let soft modes join R, once, and buckling modes until K_ρ has none left."""
        if self._soft[i]:
            weight = self._weight[self.dofs[i]]
            soft = soft_modes(self._solver(i), weight, self._soft[i], self._threshold)
            R = self._joined(i, R, soft)
            self._soft[i] = 0
        for _ in range(ENRICHMENTS if self._buckling else 0):
            count = self.factors.inertia_of(i)[0]
            if count <= 0:
                break
            R = self._joined(i, R, buckling_modes(self._solver(i), len(R), count))
        return R

    def _joined(self, i: int, R: Array, Y: Array) -> Array:
        """Append the modes Y to R and factor with the wider border."""
        wider = append_orthonormal(R, Y)
        if wider.shape[1] == R.shape[1]:
            return R
        self.factors.update_block(i, wider, self.rho[i])
        if self.factors.inertia_of(i)[1] > 0:  # a border that the factor cannot tell from zero
            self.factors.update_block(i, R, self.rho[i])
            return R
        self._elastic[i] = np.hstack([self._elastic[i], wider[:, R.shape[1] :]])
        self.exact[i] = False
        return wider

    def _solver(self, i: int) -> Callable[[Array], Array]:
        return lambda X: self.factors.solve_many(i, X)

    def _test(self, R: Sequence[Array]) -> list[bool]:
        """Decide for each subdomain whether K R = 0 up to rounding."""
        defects = zip(self._multiply(R), self._multiply(R, transpose=True), self.rho, strict=True)
        return [
            bool(max(float(np.linalg.norm(KR)), float(np.linalg.norm(KtR))) <= KERNEL_TOLERANCE * ρ)
            and Y.shape[1] == 0
            for (KR, KtR, ρ), Y in zip(defects, self._elastic, strict=True)
        ]

    def _stand_ins(self, *, transpose: bool) -> tuple[list[Array], list[Array]]:
        """Return E and D of every subdomain; R and 0 where K R = 0."""
        E, D = [], []
        for i, R_i in enumerate(self.R):
            E_i, defect = R_i, np.zeros((R_i.shape[1], R_i.shape[1]))
            if not self.exact[i]:
                x, mu = self.factors.solve_border(i, transpose=transpose)
                E_i, defect = self.rho[i] * x, -(self.rho[i] ** 2) * mu
            E.append(E_i)
            D.append(0.5 * (defect + defect.T) if self._symmetric else defect)
        return E, D

    def _negative_directions(self) -> list[Array]:
        """Return 2 y √−δ for the eigenvalues δ < 0 of every D, above rounding."""
        directions = []
        for D, ρ in zip(self.D, self.rho, strict=True):
            δ, y = np.linalg.eigh(0.5 * (D + D.T))
            negative = δ < -DEFECT_TOLERANCE * ρ
            directions.append(2.0 * y[:, negative] * np.sqrt(-δ[negative]))
        return directions

    def _multiply(self, X: Sequence[Array], *, transpose: bool = False) -> list[Array]:
        """Return K_i X_i on the free dofs of every subdomain."""
        free = [dofs[~self.fixed[dofs]] for dofs in self._torn.subdomains]
        image = [np.zeros_like(X_i) for X_i in X]
        for j in range(max((X_i.shape[1] for X_i in X), default=0)):
            column = np.zeros(self._torn.n)
            for dofs, X_i in zip(free, X, strict=True):
                if j < X_i.shape[1]:
                    column[dofs] = X_i[:, j]
            product = self._torn.multiply(column, transpose=transpose)
            for dofs, Y in zip(free, image, strict=True):
                if j < Y.shape[1]:
                    Y[:, j] = product[dofs]
        return image
