# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Rigid motions of each body that its supports leave free and the matrix does not resist.

.. math:: \hat w = 0 \text{ on the supports}, \qquad \|\hat A \hat w\| ≤ τ\, \|\hat w\|

in the scaling of ``scaled_assembled``, for motions in the span of the near kernel. No factor is
needed.

If A is known to be positive semi-definite, the energy :math:`\hat w^⊤ \hat A\, \hat w` has to be
rounding, too. Rounding errors of size ε in the entries of w cause a force of order ε, but an energy
of order ε² only. The energy of a weak support can therefore exceed rounding although its force does
not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_feti.feti.regularity.bodies import Bodies
from dolfinx_feti.feti.regularity.scaled_assembled import ScaledAssembledMatrix
from dolfinx_feti.feti.regularity.tsqr import r_factors
from dolfinx_feti.feti.subdomain.kernel_detection import MAX_NORM_ON_FIXED_DOFS
from dolfinx_feti.feti.subdomain.orthonormal import (
    null_combinations,
    orthonormal_combinations,
    symmetric_part,
)
from dolfinx_feti.runtime.arrays import Array, Numbers
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.torn.matrix import Torn
from dolfinx_feti.torn.null_space import read_null_space

#: Largest energy of a motion of size one, in the scaled semi-definite matrix, that counts as
#: rounding: some 50 EPS, for a sum of many products. A choice: half of it changes no test.
MAX_MOTION_ENERGY = 1e-14

#: Largest force of a motion of size one, in the scaled matrix, that counts as rounding. The
#: rotation of a body far from the origin is a difference of large numbers and loses digits: the
#: bound leaves room for four. A choice: half of it changes no test.
MAX_MOTION_FORCE = 1e-12

#: Sine of the angle to a span of motions below which a motion belongs to it. Motions from inverse
#: iteration are accurate to about 1e-8, and others are at angles near one. A choice between both:
#: half of it changes no test.
SAME_MOTION = 1e-4


@dataclass(frozen=True, slots=True)
class RigidMotions:
    """Rigid motions of the bodies that the matrix does not resist.

    Attributes:
        torn: The torn matrix.
        bodies: Its bodies.
        matrix: The assembled matrix, scaled.
        fields: The motions as single-valued fields on the torn dofs, (n, largest dimension). In
            column j, the dofs of each body have its motion j, or zeros if it has fewer motions.
        dimensions: Number of motions of each body, (bodies,).
        null_space: Kernel of the matrix that the user gave to it, on the torn dofs, (n, k).
    """

    torn: Torn
    bodies: Bodies
    matrix: ScaledAssembledMatrix
    fields: Array
    dimensions: Numbers
    null_space: Array

    @property
    def total(self) -> int:
        """Number of motions of all bodies."""
        return int(self.dimensions.sum())

    def lie_in_null_space(self) -> bool:
        """Return True if the given null space contains all of the motions. Collective."""
        comm = self.torn.comm
        weight = self.matrix.root_share[:, None]
        Z = self.null_space
        W = self.fields
        remainder = W - Z @ comm.allreduce((weight * Z).T @ (weight * W))  # W − Z Zᵀ W
        squares = np.array([((weight * X) ** 2).sum() for X in (remainder, W)])
        outside_square, square = comm.allreduce(squares)
        return self.total <= Z.shape[1] and bool(outside_square <= SAME_MOTION**2 * square)


def free_motions(torn: Torn, bodies: Bodies, *, is_semidefinite: bool) -> RigidMotions:
    """Compute the motions in the span of the near kernel that nothing resists. Collective.

    Args:
        torn: The torn matrix.
        bodies: Its bodies.
        is_semidefinite: Whether the assembled matrix is known to be positive semi-definite.
    """
    near_kernel = torn.near_kernel()
    matrix = ScaledAssembledMatrix(torn)
    combinations = _unsupported_combinations(matrix, near_kernel, bodies, torn)
    fields = _combine(near_kernel, combinations, bodies)
    if fields.shape[1]:
        combinations = _unresisted_combinations(
            matrix, fields, bodies, torn, is_semidefinite=is_semidefinite
        )
        fields = _combine(fields, combinations, bodies)
    dimensions = np.array([C.shape[1] for C in combinations], dtype=np.int64)
    return RigidMotions(torn, bodies, matrix, fields, dimensions, read_null_space(torn))


def _unsupported_combinations(
    matrix: ScaledAssembledMatrix, modes: Array, bodies: Bodies, torn: Torn
) -> list[Array]:
    """Return the combinations of modes that vanish on the supports of each body. Collective.

    Args:
        matrix: The assembled matrix, scaled.
        modes: Modes on the torn dofs, (n, k).
        bodies: The bodies.
        torn: The torn matrix.

    Returns:
        Coefficients of each body, (k, ≤ k); the motions have size one on the body and its supports.
    """
    motions = matrix.scale_motions(modes)
    supports = bodies.supports
    R_supports = r_factors(motions[supports.dofs], supports.bodies, bodies.count, torn.comm)
    # Dirichlet dofs have the label ``count``, so that these factors leave them out.
    R_free = r_factors(motions, bodies.label, bodies.count, torn.comm)

    def combinations() -> list[Array]:
        coefficients = []
        for on_free, on_supports in zip(R_free, R_supports, strict=True):
            on_both = np.vstack([on_free, on_supports])
            basis = orthonormal_combinations(on_both)  # motions of size one
            vanishing = null_combinations(on_supports @ basis, MAX_NORM_ON_FIXED_DOFS)
            coefficients.append(basis @ vanishing)
        return coefficients

    return on_all(combinations, torn.comm)


def _unresisted_combinations(
    matrix: ScaledAssembledMatrix,
    fields: Array,
    bodies: Bodies,
    torn: Torn,
    *,
    is_semidefinite: bool,
) -> list[Array]:
    """Return the combinations of fields that cause no force on each body. Collective.

    Args:
        matrix: The assembled matrix, scaled.
        fields: Single-valued fields on the torn dofs, (n, k).
        bodies: The bodies.
        torn: The torn matrix.
        is_semidefinite: Whether to test their energy, too.

    Returns:
        Coefficients of each body, (k, ≤ k).
    """
    k = fields.shape[1]
    forces_and_motions = np.hstack([matrix.scaled_forces(fields), matrix.scale_motions(fields)])
    # R has forces and motions in one orthonormal basis: their scalar products are those of R.
    R = r_factors(forces_and_motions, bodies.label, bodies.count, torn.comm)

    def combinations() -> list[Array]:
        coefficients = []
        for of_body in R:
            forces = of_body[:, :k]
            motions = of_body[:, k:]
            coefficients.append(
                _combinations_without_force(forces, motions, is_semidefinite=is_semidefinite)
            )
        return coefficients

    return on_all(combinations, torn.comm)


def _combinations_without_force(forces: Array, motions: Array, *, is_semidefinite: bool) -> Array:
    """Return the combinations of size one whose force is rounding, (k, ≤ k).

    Args:
        forces: Scaled forces of the fields, (rows, k), in an orthonormal basis.
        motions: The scaled fields in the same basis, (rows, k).
        is_semidefinite: Whether to test their energy, too.
    """
    basis = orthonormal_combinations(motions)
    if is_semidefinite:
        energy = (motions @ basis).T @ (forces @ basis)
        values, Y = np.linalg.eigh(symmetric_part(energy))
        basis = basis @ Y[:, values <= MAX_MOTION_ENERGY]
    return np.asarray(basis @ null_combinations(forces @ basis, MAX_MOTION_FORCE))


def _combine(fields: Array, coefficients: list[Array], bodies: Bodies) -> Array:
    """Combine fields body by body.

    Args:
        fields: Fields on the torn dofs, (n, k).
        coefficients: Coefficients C of each body, (k, m_b).
        bodies: The bodies.

    Returns:
        ``fields @ C`` on the dofs of each body, (n, largest m_b). Dirichlet dofs are zero; so are
        the last columns on a body with a smaller m_b.
    """
    combined = np.zeros((len(fields), max((C.shape[1] for C in coefficients), default=0)))
    for b, C in enumerate(coefficients):
        if C.shape[1]:
            rows = bodies.label == b
            combined[rows, : C.shape[1]] = fields[rows] @ C
    return combined
