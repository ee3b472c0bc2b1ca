# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Detection of the zero-energy modes of one subdomain: the procedure, and its tolerances.

A null vector is found in the *equilibrated* matrix, which has a unit diagonal. With the absolute
diagonal d of K_i, and an orthonormal basis :math:`\tilde R` of the span of :math:`d^{1/2} R`,

.. math:: \tilde K = d^{-1/2} K d^{-1/2}, \qquad
          \|(\tilde K + \tilde R \tilde R^⊤)\, \tilde y\| ≤ ε\, \|\tilde y\|,
          \qquad y = d^{-1/2}\, \tilde y.

1. *Rigid modes* (``modes.rigid_modes``): the candidates are the near kernel of the assembled
   problem, restricted to the subdomain. Combinations that vanish on its fixed dofs
   (:data:`MAX_NORM_ON_FIXED_DOFS`) are its rigid modes. They join R even if K R ≠ 0.
2. *Test* (``null_vectors.is_numerically_singular``): K_ρ is factored with the rigid modes in R. It
   counts as singular if a pivot is zero, or if a solve makes random vectors grow by more than
   ``max_growth`` of :class:`NullTolerances`. A factor in single precision has already passed a
   stricter bound on the growth (``scaled.ScaledMatrix.factor_for_preconditioner``).
3. *Null vectors* (``null_vectors.null_vectors``): if K_ρ counts as singular, the null vectors with
   ε = ``max_singular_value`` join R. If there are none, the matrix is only badly conditioned, and
   is used as it is. If K_ρ counts as singular although the null vectors are in R, an error is
   raised (``mode_search``).
4. *Exactness* (``mode_search``): if the forces K R of rigid modes (:data:`MAX_RIGID_FORCE`) and of
   null vectors (:data:`MAX_NULL_FORCE`) are rounding errors, E = R and D = 0 are used. Otherwise E
   and D are computed from K R.
5. *Interior* (``interior``): steps 2 and 3 for K_II, which has no rigid modes. Vectors whose forces
   are not rounding errors (``torn.rounding.FORCE_ROUNDING_MARGIN``) are dropped: K_II is only badly
   conditioned. The others are null vectors of the assembled matrix if they exert no force on the
   interface (:data:`MAX_INTERFACE_FORCE`).

If d spans many orders of magnitude (:data:`MAX_DIAGONAL_RATIO`), the matrix is scaled (``scaled``),
to :math:`\bar d` times the equilibrated one. Modes with little energy then count as well:
:data:`NEARLY_NULL` replaces :data:`EXACTLY_NULL`.

The tolerances of the decisions are below. Those of the tools are beside them: when columns depend
on each other (``orthonormal``), how null vectors are computed (``null_vectors``), and which error a
factor in single precision may have (``scaled.MAX_SINGLE_PRECISION_ERROR``). The bound for negative
eigenvalues of D, ``mode_search.DEFECT_RTOL``, belongs to step 4: D is compared with zero.

To detect null vectors in another way, replace the two functions of ``null_vectors``, which serve
both K_ρ and K_II. Two shortcuts in ``mode_search`` precede step 2: a factor in single precision is
not tested again, and if the factorisation stops at a zero pivot, step 3 follows at once.
"""

from __future__ import annotations

from dataclasses import dataclass

#: A mode counts as zero on the fixed dofs if its norm on them is at most this multiple of its norm
#: on all dofs of the subdomain. The value is the square root of the machine epsilon: modes of
#: subdomains far from the origin agree in up to half of their digits, and their combinations lose
#: these digits.
MAX_NORM_ON_FIXED_DOFS = 1e-8

#: Largest ‖K R ω‖ of rigid modes with random weights ω, over the mean ρ of the diagonal of K, that
#: counts as rounding of the assembly. Measured: up to 8e-14 for rounding, and from 2e-9 on for
#: small stress. Above the bound E and D are computed, which is as accurate, and takes some more
#: solves.
MAX_RIGID_FORCE = 1e-12

#: Largest ‖K̃ ỹ‖/‖ỹ‖ of a null vector that counts as rounding, with D = 0. Measured: up to 8e-15
#: for mechanisms and single cells, for which D = 0 is right; 2e-13 for an island in a void with
#: 1e-12 of the stiffness, for which D has to be computed.
MAX_NULL_FORCE = 3e-14

#: Largest force on the interface, max |K_ΓI y| over max |K_II| max |y|, that counts as zero.
#: Measured: up to 2e-7 for null vectors of the assembled matrix, and 0.09 for a motion that the
#: interface resists.
MAX_INTERFACE_FORCE = 1e-5

#: Largest ratio of two diagonal entries of a matrix that is not scaled. At this ratio, ρ R Rᵀ costs
#: six of sixteen digits of the smallest stiffness. With half and twice the value, the voids of the
#: tests converge in the same way.
MAX_DIAGONAL_RATIO = 1e6


@dataclass(frozen=True, slots=True)
class NullTolerances:
    """Tolerances of the search for null vectors of K_ρ that are not in R.

    The first one decides whether there is a search, the second one which vectors it finds. To find
    vectors with more energy, raise ``max_singular_value`` and reduce ``max_growth``: without a
    search no vector is found.

    Attributes:
        max_growth: Null vectors are searched if a solve with the equilibrated matrix makes random
            vectors x grow by more, ‖K̃_ρ⁻¹ x‖ > max_growth ‖x‖. The growth is about the inverse of
            the smallest singular value, divided by the square root of n_i.
        max_singular_value: ε, the largest singular value of the equilibrated matrix whose singular
            vector counts as a null vector.
    """

    max_growth: float
    max_singular_value: float


#: Null vectors to rounding accuracy. If random vectors grow by 1e11, a solve loses 11 of 16 digits;
#: rounding changes the singular values of a block of some 1000 dofs by 1e-13.
EXACTLY_NULL = NullTolerances(max_growth=1e11, max_singular_value=1e-12)

#: Modes with hardly any stiffness, in a scaled matrix. At 1e8 a solve loses eight of sixteen
#: digits, which a fresh start on the true residual recovers (``outer_loop``).
NEARLY_NULL = NullTolerances(max_growth=1e8, max_singular_value=1e-8)
