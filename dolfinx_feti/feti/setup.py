# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Numerical parts of both formulations: weights δ, S, :math:`K_{II}^{-1}`, :math:`K^+`, the modes.

S is computed for each matrix. :math:`K^+` and the modes belong to a preconditioner, which may be
reused for later matrices (``cache``). They have separate owners, which destroy them: arguments
``matrix_objects`` and ``preconditioner_objects``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from mpi4py import MPI

import numpy as np

from dolfinx_feti.errors import SetUpError
from dolfinx_feti.feti.interface.scaling import SCALINGS
from dolfinx_feti.feti.pattern import Pattern
from dolfinx_feti.feti.regularity.detection import require_regular_interior
from dolfinx_feti.feti.subdomain.factors.protocol import sum_counts
from dolfinx_feti.feti.subdomain.failures import on_subdomains
from dolfinx_feti.feti.subdomain.generalized_inverse import (
    GeneralizedInverse,
    create_generalized_inverse,
)
from dolfinx_feti.feti.subdomain.interior import interior_null_vectors
from dolfinx_feti.feti.subdomain.mode_search import SoftModeOptions
from dolfinx_feti.feti.subdomain.schur_operator import SchurOperator, create_schur_operator
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.events import event
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.torn.matrix import Torn
from dolfinx_feti.torn.null_space import require_null_space


@dataclass(frozen=True, slots=True)
class Inertia:
    """Numbers of negative eigenvalues over all processes; None if a factor does not count them.

    Attributes:
        local: Sum over the regularised matrices K_ρ of all subdomains.
        defect: Sum over the defects D of all subdomains.
        interior: Sum over the interior blocks K_II; None also if none is factored.
        assembled: Lower bound for the assembled matrix. The formulations add it when they have a
            coarse space (``coarse.primal_problem``). Before that, it is None as well.
    """

    local: int | None
    defect: int
    interior: int | None
    assembled: int | None

    @property
    def dual(self) -> int | None:
        """Sum over all K_ρ and D. If it is zero, the dual system is definite: CG can be used."""
        return None if self.local is None else self.local + self.defect

    @property
    def is_definite(self) -> bool:
        """Whether the dual system is known to be positive definite on balanced pairs.

        It is not about A: if the interior is eliminated, K_ρ is that of S, and an indefinite K_II
        (``interior``) makes A indefinite as well.
        """
        return self.dual == 0


@dataclass(frozen=True, slots=True)
class Setup:
    """The numerical parts of the method for one matrix.

    Attributes:
        operator: S, and K_II⁻¹.
        delta: Weight δ of every torn dof, (n,).
        inverse: K⁺, with R, E and D of each subdomain.
        inertia: Negative eigenvalues of K_ρ, D and K_II, without ``assembled``.
    """

    operator: SchurOperator
    delta: Array
    inverse: GeneralizedInverse
    inertia: Inertia


def set_up(
    pattern: Pattern,
    matrix_objects: Lifetime,
    preconditioner_objects: Lifetime,
    *,
    is_primal: bool = False,
) -> Setup:
    """Compute S, the weights of the copies, K⁺ and the modes for the present matrix. Collective.

    Args:
        pattern: All that depends on the pattern.
        matrix_objects: Owner of S, which destroys it.
        preconditioner_objects: Owner of K⁺, which destroys it.
        is_primal: Whether K⁺ is for the primal form, which uses it as a preconditioner only. Then
            factors may be in single precision, and the coarse space may have adaptive columns,
            which reduce the number of soft modes.

    Returns:
        The parts; the inertia lacks ``assembled``.

    Raises:
        SetUpError: A factorisation failed, or the matrix is singular inside of a subdomain.
    """
    torn = pattern.torn
    operator = set_up_operator(pattern, matrix_objects)
    with event("FETIGluing"):
        delta = SCALINGS[pattern.options.scaling](torn)
    inverse, inertia = _set_up_inverse(
        pattern, operator, preconditioner_objects, is_primal=is_primal
    )
    return Setup(operator, delta, inverse, inertia)


def to_double_precision(pattern: Pattern, setup: Setup, preconditioner_objects: Lifetime) -> Setup:
    """Return the parts with K⁺ in double precision on all processes. Collective.

    Args:
        pattern: All that depends on the pattern.
        setup: The parts. If their K⁺ is in single precision on a process, it is freed on all.
        preconditioner_objects: Owner of the K⁺ that replaces it.
    """
    if not pattern.torn.comm.allreduce(setup.inverse.is_single_precision, op=MPI.LOR):
        return setup
    setup.inverse.destroy()  # frees memory now; its owner destroys it again, without effect
    inverse, inertia = _set_up_inverse(
        pattern, setup.operator, preconditioner_objects, is_primal=False
    )
    return replace(setup, inverse=inverse, inertia=inertia)


def _set_up_inverse(
    pattern: Pattern, operator: SchurOperator, preconditioner_objects: Lifetime, *, is_primal: bool
) -> tuple[GeneralizedInverse, Inertia]:
    """Compute K⁺ with the modes of all subdomains, and count negative eigenvalues. Collective.

    Args:
        pattern: All that depends on the pattern.
        operator: S, and K_II⁻¹.
        preconditioner_objects: Owner of K⁺.
        is_primal: Whether K⁺ is for the primal form; see :func:`set_up`.
    """
    torn = pattern.torn
    near_kernel = torn.near_kernel()
    has_adaptive_columns = pattern.options.coarse_adaptive > 0
    options = SoftModeOptions(
        max_count=pattern.options.coarse_modes,
        threshold=pattern.options.coarse_threshold,
        allow_omission=is_primal and has_adaptive_columns and operator.is_interior_eliminated,
    )

    def create() -> GeneralizedInverse:
        return create_generalized_inverse(
            operator,
            pattern.analysis,
            near_kernel,
            pattern.is_fixed,
            options,
            allow_single_precision=is_primal,
        )

    with event("FETIFactor"), event("FETIModes"):
        inverse = preconditioner_objects.own(on_subdomains(create, torn.comm))
    # D of a subdomain has a negative eigenvalue for each column of its stabilisation Z.
    defect = torn.comm.allreduce(sum(m.stabilisation.shape[1] for m in inverse.modes))
    inertia = Inertia(
        local=sum_if_known(inverse.count_negative_eigenvalues, torn.comm),
        defect=defect,
        interior=sum_if_known(operator.count_negative_interior_eigenvalues, torn.comm),
        assembled=None,
    )
    return inverse, inertia


def set_up_operator(pattern: Pattern, matrix_objects: Lifetime) -> SchurOperator:
    """Compute S of the present matrix. Collective.

    Args:
        pattern: All that depends on the pattern.
        matrix_objects: Owner of S.

    Raises:
        SetUpError: A factorisation failed, or some K_II is singular.
    """
    torn = pattern.torn
    analysis = pattern.analysis
    with event("FETIFactor"), event("FETISchur"):
        operator = on_subdomains(
            lambda: create_schur_operator(torn, analysis, pattern.errors), torn.comm
        )
        matrix_objects.own(operator)
    if analysis.is_interior_eliminated:
        require_regular_interior_blocks(pattern, operator)
    return operator


def require_regular_interior_blocks(pattern: Pattern, operator: SchurOperator) -> None:
    """Check that all K_II are regular, so that S exists. Collective.

    Raises:
        SetUpError: Some K_II is singular.
        SingularError: The assembled matrix is singular: a null vector of K_II exerts no force on
            the interface.
    """
    torn = pattern.torn
    if not pattern.analysis.has_interior_factors:
        return
    options = pattern.analysis.interior_options
    motions = on_subdomains(
        lambda: interior_null_vectors(torn, operator.by_subdomain, options), torn.comm
    )
    require_regular_interior(torn, pattern.bodies, motions)


def require_valid_matrix(torn: Torn) -> None:
    """Check that the matrix is finite, and that A Z = 0 for an attached null space Z. Collective.

    Raises:
        SetUpError: The matrix has entries that are NaN or Inf, or the vectors that the user has
            attached as null space are not orthonormal or no null vectors.
    """
    is_finite = np.isfinite(torn.K.norm()) and bool(np.isfinite(torn.stiffness()).all())
    if torn.comm.allreduce(not is_finite, op=MPI.LOR):
        raise SetUpError(
            "The matrix has entries that are NaN or Inf: check the coefficients of the form and, "
            "in a nonlinear problem, the last step."
        )
    require_null_space(torn)


def sum_if_known(count: Callable[[], int | None], comm: MPI.Comm) -> int | None:
    """Return the sum of a count over all processes; None if one of them has None. Collective."""
    return sum_counts(comm.allgather(on_subdomains(count, comm)))
