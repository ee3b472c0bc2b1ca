# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The generalised inverse :math:`K^+ = \operatorname{diag}(K_i^+)`, exact under prestress.

.. math:: K^+ = (K_ρ + ρ\, Y Y^⊤)^{-1} = (I - E_Y Y^⊤)\, K_ρ^{-1}, \qquad K_ρ = K + ρ\, R R^⊤

(eq. 39 of the paper, if there are no soft modes Y; docs/theory.md). It is not the pseudoinverse of
Moore and Penrose. :math:`K_ρ` is factored; :math:`E_Y` are the columns of E for Y (``modes``). If
the interior is eliminated, S replaces K.
"""

from __future__ import annotations

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np

from dolfinx_feti.feti.subdomain.analysis import Analysis
from dolfinx_feti.feti.subdomain.blocks import as_slice
from dolfinx_feti.feti.subdomain.factors.protocol import Factor, sum_counts
from dolfinx_feti.feti.subdomain.failures import NumberedErrors, on_subdomains
from dolfinx_feti.feti.subdomain.matrix import SubdomainMatrix, create_sparse_matrices
from dolfinx_feti.feti.subdomain.mode_search import SoftModeOptions, find_modes
from dolfinx_feti.feti.subdomain.modes import SubdomainModes, rigid_modes
from dolfinx_feti.feti.subdomain.scaled import scale_matrix
from dolfinx_feti.feti.subdomain.schur_operator import FormedSchurOperator, SchurOperator
from dolfinx_feti.feti.subdomain.subdomain import Subdomain, interface_dofs
from dolfinx_feti.runtime.arrays import Array, ArrayOrNaN, Indices, Mask
from dolfinx_feti.runtime.collective import DeferredErrors
from dolfinx_feti.runtime.events import event
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.torn.matrix import Torn


class SubdomainInverse:
    """K_i⁺ of one subdomain, or S_i⁺ if the interior is eliminated, (n_i, n_i).

    It owns the factor, and does not refer to the matrix: it may precondition later ones.

    Attributes:
        subdomain: The subdomain.
        dofs: Torn dofs of its rows: the free ones of the subdomain, or Γ, (n_i,).
        dof_index: The same dofs, as a slice if they are consecutive: numpy reads slices faster.
        modes: R, Y, E and D.
        factor: Factor of K_ρ.
    """

    def __init__(self, matrix: SubdomainMatrix, factor: Factor, modes: SubdomainModes) -> None:
        """Copy the dofs of a matrix, and take over the factor of its K_ρ.

        Args:
            matrix: K_i, or S_i.
            factor: Factor of K_ρ.
            modes: The modes of the matrix.
        """
        self.subdomain = matrix.subdomain
        self.dofs: Indices = matrix.dofs
        self.dof_index = as_slice(matrix.dofs)
        self.modes = modes
        self.factor = factor
        #: Mask of Γ among the rows, (n_i,); None if all rows are on Γ.
        self._is_on_interface: Mask | None = None
        if len(self.dofs) > len(self.subdomain.interface):
            self._is_on_interface = self.subdomain.is_on_interface

    @property
    def E_on_interface(self) -> Array:
        """E on the interface, (n_{Γ,i}, k + k_Y)."""
        return self.restrict(self.modes.E)

    def restrict(self, X: Array) -> Array:
        """Return X on the interface, (n_i,) → (n_{Γ,i},) or (n_i, r) → (n_{Γ,i}, r)."""
        return X if self._is_on_interface is None else X[self._is_on_interface]

    def extend_by_zero(self, F: Array) -> Array:
        """Return F on Γ, else zero, (n_{Γ,i},) → (n_i,) or (n_{Γ,i}, r) → (n_i, r)."""
        if self._is_on_interface is None:
            return F
        X = np.zeros((len(self.dofs), *F.shape[1:]))
        X[self._is_on_interface] = F
        return X

    def solve(self, y: Array) -> Array:
        """Return K_i⁺ y, (n_i,), or K_i⁺ Y, (n_i, r)."""
        x = self.factor.solve(y)  # K_ρ⁻¹ y
        if not self.modes.n_soft:
            return x
        return np.asarray(x - self.modes.E_Y @ (self.modes.Y.T @ x))  # (I − E_Y Yᵀ) K_ρ⁻¹ y

    def solve_on_interface(self, F: Array) -> Array:
        """Return K_i⁺ F restricted to the interface, (n_{Γ,i}, r) → (n_{Γ,i}, r)."""
        return self.restrict(self.solve(self.extend_by_zero(F)))

    def solve_regularised_on_interface(self, t: Array) -> Array:
        """Return K_ρ⁻¹ t restricted to the interface, (n_{Γ,i},) → (n_{Γ,i},).

        It differs from K_i⁺ t by a combination of the columns of E_Y.
        """
        return self.restrict(self.factor.solve(self.extend_by_zero(t)))

    def destroy(self) -> None:
        """Free the factor."""
        self.factor.destroy()


class GeneralizedInverse:
    """K⁺ of all subdomains of this process, block-diagonal, and K_ρ⁻¹.

    The methods for iterations return an ``ArrayOrNaN``; the others raise their errors.

    Attributes:
        by_subdomain: K_i⁺ of each subdomain.
    """

    def __init__(self, by_subdomain: Sequence[SubdomainInverse], errors: DeferredErrors) -> None:
        """Store the inverses of all subdomains of this process.

        Args:
            by_subdomain: K_i⁺ of each subdomain.
            errors: Store for the errors of the methods for iterations.
        """
        self.by_subdomain = tuple(by_subdomain)
        self._errors = errors

    @property
    def modes(self) -> tuple[SubdomainModes, ...]:
        """R, Y, E and D of each subdomain."""
        return tuple(inverse.modes for inverse in self.by_subdomain)

    def E_on_interface(self, comm: MPI.Comm) -> list[Array]:
        """Return E on the interface of each subdomain, (n_{Γ,i}, k + k_Y). Collective.

        Args:
            comm: Communicator of the matrix.

        Raises:
            SetUpError: A process has no memory for the copies; on all processes.
        """
        return on_subdomains(
            lambda: [inverse.E_on_interface for inverse in self.by_subdomain], comm
        )

    @property
    def is_single_precision(self) -> bool:
        """Whether a factor of this process is in single precision."""
        return any(inverse.factor.is_single_precision for inverse in self.by_subdomain)

    def solve(self, y: Array) -> ArrayOrNaN:
        """Return K⁺ y, (n,), or K⁺ Y, (n, r), for torn vectors.

        The result is zero on dofs that have no row in a block: on fixed dofs and, if the interior
        is eliminated, on interior ones.
        """

        def solve() -> Array:
            x = np.zeros_like(y)
            for inverse in self.by_subdomain:
                dofs = inverse.dof_index
                x[dofs] = inverse.solve(y[dofs])  # K_i⁺ y_i
            return x

        with event("FETILocalSolve"):
            return self._errors.guard(solve, y.shape)

    def solve_on_interface(self, F: Array) -> Array:
        """Return K⁺ F restricted to the interface, (n_Γ, r) → (n_Γ, r)."""
        X = np.empty_like(F)
        for inverse in self.by_subdomain:
            rows = inverse.subdomain.interface_rows
            X[rows] = inverse.solve_on_interface(F[rows])  # K_i⁺ F_i
        return X

    def solve_regularised_on_interface(self, t: Array) -> ArrayOrNaN:
        """Return K_ρ⁻¹ t restricted to the interface, for an interface vector, (n_Γ,) → (n_Γ,).

        This takes less time than K⁺ t, and differs from it by a combination of the columns of E_Y.
        A projection whose coarse space contains E_Y removes the difference.
        """

        def solve() -> Array:
            x = np.empty_like(t)
            for inverse in self.by_subdomain:
                rows = inverse.subdomain.interface_rows
                x[rows] = inverse.solve_regularised_on_interface(t[rows])  # K_ρ⁻¹ t_i
            return x

        with event("FETILocalSolve"):
            return self._errors.guard(solve, t.shape)

    def count_negative_eigenvalues(self) -> int | None:
        """Return the number of negative eigenvalues of all K_ρ of this process; None if unknown."""
        return sum_counts([inverse.factor.inertia.negative for inverse in self.by_subdomain])

    def memory(self) -> float:
        """Return the memory of the factors of this process in MiB."""
        return sum(inverse.factor.memory() for inverse in self.by_subdomain)

    def destroy(self) -> None:
        """Free the factors."""
        for inverse in self.by_subdomain:
            inverse.destroy()


def create_generalized_inverse(
    S: SchurOperator,
    analysis: Analysis,
    near_kernel: Array,
    fixed: Mask,
    options: SoftModeOptions,
    *,
    allow_single_precision: bool,
) -> GeneralizedInverse:
    """Compute the modes of every subdomain of this process, and factor K_ρ.

    Call it inside of ``on_subdomains``: it may fail on a single process.

    Args:
        S: The Schur complements of the current K, with the store for errors. If they are formed,
            all S_i are inverted; otherwise all K_i of ``S.torn``.
        analysis: The subdomains, and how they are factored.
        near_kernel: The near kernel of the assembled problem on the torn dofs, (n, r).
        fixed: Mask of the torn dofs that are fixed in the local matrices, (n,).
        options: Which soft modes join Y.
        allow_single_precision: Whether factors may be in single precision, for a preconditioner.

    Returns:
        K⁺; the caller destroys it.

    Raises:
        FactorError: The work on a subdomain of this process failed.
    """
    torn = S.torn
    interface = interface_dofs(analysis.subdomains)
    stiffness = np.zeros(torn.n)  # k_Γ on the interface, zero elsewhere
    stiffness[interface] = torn.stiffness()[interface]
    rigid = [rigid_modes(near_kernel[s.all_dofs], fixed[s.all_dofs]) for s in analysis.subdomains]
    rigid_forces = _estimate_rigid_forces(torn, analysis.subdomains, rigid)
    by_subdomain = []
    with Lifetime() as inverses:  # destroyed if a later subdomain fails
        matrices = subdomain_matrices(S, analysis)
        for matrix, R, rigid_force in zip(matrices, rigid, rigid_forces, strict=True):
            with NumberedErrors(matrix.subdomain.number):
                scaled = scale_matrix(
                    matrix, stiffness[matrix.dofs], allow_single_precision=allow_single_precision
                )
                R_scaled = scaled.scale_modes(matrix.modes_on_dofs(R))
                factor, modes = find_modes(scaled, R_scaled, rigid_force, options)
            by_subdomain.append(inverses.own(SubdomainInverse(matrix, factor, modes)))
        inverses.release()  # the generalised inverse owns them
    return GeneralizedInverse(by_subdomain, S.errors)


def subdomain_matrices(S: SchurOperator, analysis: Analysis) -> Sequence[SubdomainMatrix]:
    """Return the matrices that K⁺ inverts: all S_i if the interior is eliminated, else all K_i."""
    if isinstance(S, FormedSchurOperator):
        return S.by_subdomain
    return create_sparse_matrices(S.torn, analysis)


def _estimate_rigid_forces(
    torn: Torn, subdomains: Sequence[Subdomain], rigid: Sequence[Array]
) -> list[float]:
    """Return ‖K_i R ω‖ of every subdomain for random weights ω, which estimates ‖K_i R‖.

    One product with the local matrix K of the process serves all subdomains.

    Args:
        torn: The torn matrix.
        subdomains: The subdomains.
        rigid: Rigid modes R of each on its free dofs, (n_i, k).
    """
    t = np.zeros(torn.n)
    # Weights from 1 to 2: each mode counts, and their forces cancel only by chance.
    for s, R in zip(subdomains, rigid, strict=True):
        t[s.free_dofs] = R @ np.random.default_rng(len(s.free_dofs)).uniform(1.0, 2.0, R.shape[1])
    force = torn.multiply(t)  # K R ω
    return [float(np.linalg.norm(force[s.free_dofs])) for s in subdomains]
