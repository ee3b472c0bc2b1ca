# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The preconditioner M of the interface operator A, and the columns of its coarse space.

.. math:: M = T^⊤ δ\, K_ρ^{-1} δ\, T, \qquad V = T^⊤ δ\, U

with columns :math:`U_i`, (n_{Γ,i}, k_i), of each subdomain on its interface: :math:`E_i` and
adaptive columns (docs/theory.md). A matrix that is not symmetric is preconditioned by M of its
symmetric part :math:`½ (K + K^⊤)`. In Newton's method later matrices may reuse M and V (``cache``).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dolfinx_feti.errors import SetUpError, SingularError
from dolfinx_feti.feti.coarse.adaptive import adaptive_columns
from dolfinx_feti.feti.coarse.averaged import AveragedBasis
from dolfinx_feti.feti.coarse.energy import Combinations
from dolfinx_feti.feti.interface.copies import Copies
from dolfinx_feti.feti.pattern import Pattern, torn_symmetric_part
from dolfinx_feti.feti.primal.assembled_product import create_assembled_product
from dolfinx_feti.feti.setup import Inertia, Setup, set_up
from dolfinx_feti.feti.subdomain.generalized_inverse import GeneralizedInverse
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.events import event
from dolfinx_feti.runtime.lifetime import Lifetime


@dataclass(frozen=True, slots=True)
class PrimalPreconditioner:
    """The preconditioner of A, and the coarse columns of the matrix for which it was set up.

    Attributes:
        delta: Weight δ of every torn dof, (n,).
        inverse: K_ρ⁻¹, and R, E, D of each subdomain.
        inertia: Numbers of negative eigenvalues of K_ρ, D and K_II.
        V: The averaged columns.
        is_reused: Whether it serves a later matrix than that of its set-up.
        combinations: Combinations of the columns of this process by the matrix of the set-up; None
            until it is reused.
    """

    delta: Array
    inverse: GeneralizedInverse
    inertia: Inertia
    V: AveragedBasis
    is_reused: bool = False
    combinations: Combinations | None = None

    @property
    def copies(self) -> Copies:
        """Copies of the interface dofs."""
        return self.V.copies

    def for_later_matrix(self, combinations: Combinations) -> PrimalPreconditioner:
        """Return this preconditioner for a later matrix, which uses the same combinations.

        Args:
            combinations: Combinations of the columns by the matrix of the set-up. To compute them
                again would take an eigenvalue problem for each subdomain.
        """
        return replace(self, is_reused=True, combinations=combinations)


def create_preconditioner(
    pattern: Pattern, setup: Setup, preconditioner_objects: Lifetime
) -> PrimalPreconditioner:
    """Create the preconditioner of a symmetric matrix, with its coarse columns. Collective.

    Args:
        pattern: Pattern of the matrix, which is symmetric.
        setup: S, δ and K_ρ⁻¹ of the matrix.
        preconditioner_objects: Owner of the copies and columns, which destroys them.
    """
    S = setup.operator
    copies = preconditioner_objects.own(
        Copies(pattern.torn, S.interfaces, setup.delta, pattern.errors)
    )
    with event("FETICoarse"):
        # The columns of every subdomain, (n_{Γ,i}, any number). Further ones join E here, so that
        # the adaptive columns leave out what they balance.
        E = setup.inverse.E_on_interface(pattern.torn.comm)
        adaptive = adaptive_columns(
            copies,
            create_assembled_product(S, copies).apply,  # T_i A T_iᵀ, for one i after the other
            # K_i⁺ F on the interface. It equals S_ρ⁻¹ F, because Eᵀ F = 0 for these forces.
            lambda i, F: setup.inverse.by_subdomain[i].solve_on_interface(F),
            E,
            max_columns=pattern.options.coarse_adaptive,
        )
        U = [np.hstack(columns) for columns in zip(E, adaptive, strict=True)]
        V = preconditioner_objects.own(AveragedBasis(copies, U))
    return PrimalPreconditioner(setup.delta, setup.inverse, setup.inertia, V)


def create_symmetric_part_preconditioner(
    pattern: Pattern, preconditioner_objects: Lifetime
) -> PrimalPreconditioner:
    """Create the preconditioner of the current matrix from ½ (K + Kᵀ). Collective.

    Args:
        pattern: Pattern of the matrix, which is not symmetric.
        preconditioner_objects: Owner of K_ρ⁻¹, copies and columns, which destroys them. Objects
            that only the set-up needs are freed here.

    Raises:
        SetUpError: The symmetric part is singular inside of a subdomain.
    """
    try:
        with torn_symmetric_part(pattern.torn) as torn, Lifetime() as setup_objects:
            assert pattern.symmetric_part_analysis is not None  # as the matrix is not symmetric
            # Bodies and gluing depend on the copies alone, and remain those of K.
            pattern = replace(
                pattern, torn=torn, is_symmetric=True, analysis=pattern.symmetric_part_analysis
            )
            setup = set_up(pattern, setup_objects, preconditioner_objects, is_primal=True)
            return create_preconditioner(pattern, setup, preconditioner_objects)
    except SingularError:  # the symmetric part is singular, but K may be regular
        raise SetUpError(
            "The matrix is not symmetric. Its symmetric part, which would precondition it, is "
            "singular inside of a subdomain: take other subdomains, or a direct solver."
        ) from None
