# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Null vectors of the interior of a subdomain: motions of the interior without energy.

.. math:: K_{II}\, y = 0, \qquad K_{ΓI}\, y = 0

If both hold, y is a null vector of the assembled matrix, which is singular. If only the first
equation holds, S does not exist. The tolerances are in ``kernel_detection``.
"""

from __future__ import annotations

from collections.abc import Sequence

from petsc4py import PETSc

import numpy as np
import scipy.sparse

from dolfinx_feti.feti.subdomain.blocks import sparse_block
from dolfinx_feti.feti.subdomain.factors.petsc_factor import factor_by_petsc
from dolfinx_feti.feti.subdomain.factors.petsc_solver import FactorOptions
from dolfinx_feti.feti.subdomain.factors.protocol import Factor
from dolfinx_feti.feti.subdomain.failures import NumberedErrors, RemediedFactorError
from dolfinx_feti.feti.subdomain.kernel_detection import MAX_INTERFACE_FORCE
from dolfinx_feti.feti.subdomain.null_vectors import (
    is_numerically_singular,
    null_vectors,
    positive_diagonal,
)
from dolfinx_feti.feti.subdomain.schur import SchurComplement
from dolfinx_feti.feti.subdomain.subdomain import Subdomain
from dolfinx_feti.runtime.arrays import Array, Mask
from dolfinx_feti.torn.matrix import Torn
from dolfinx_feti.torn.rounding import EPS, FORCE_ROUNDING_MARGIN


def interior_null_vectors(
    torn: Torn, schur_complements: Sequence[SchurComplement], options: FactorOptions
) -> Array:
    """Return the null vectors of the assembled matrix that are zero outside of one interior.

    Args:
        torn: The torn matrix.
        schur_complements: S_i of the subdomains of this process, with the factors of K_II.
        options: How PETSc factors K_II.

    Returns:
        The null vectors on the torn dofs, (n, r).

    Raises:
        RemediedFactorError: A null vector of K_II exerts a force on the interface. S does not
            exist then, although the assembled matrix may be regular.
    """
    diagonal = np.abs(torn.diagonal())
    columns = [np.zeros((torn.n, 0))]
    for S_i in schur_complements:
        s = S_i.subdomain
        d = diagonal[s.interior]
        factor = S_i.interior_factor
        with NumberedErrors(s.number):
            if factor is not None and is_numerically_singular(factor, d):
                Y = _null_vectors_of_interior(torn.K, s, options, d)
                on_torn_dofs = np.zeros((torn.n, Y.shape[1]))
                on_torn_dofs[s.interior] = Y
                columns.append(on_torn_dofs)
    return np.hstack(columns)


def _null_vectors_of_interior(
    K: PETSc.Mat, subdomain: Subdomain, options: FactorOptions, d: Array
) -> Array:
    """Return the null vectors of the K_II of one subdomain.

    Args:
        K: Local matrix of this process, (n, n).
        subdomain: The subdomain.
        options: How PETSc factors K_II.
        d: Absolute diagonal of K_II, (n_{I,i},).

    Returns:
        The null vectors on the interior, (n_{I,i}, r).

    Raises:
        RemediedFactorError: One of them exerts a force on the interface.
    """
    Γ = subdomain.interface
    I = subdomain.interior  # noqa: E741
    K_II = sparse_block(K, I, I)
    K_ΓI = sparse_block(K, Γ, I)

    def multiply(X: Array) -> Array:
        return np.asarray(K_II @ X)

    def factor_shifted(B: Array, shift: Array) -> Factor:
        return factor_by_petsc(K, I, options, B, 1.0, shift)

    Y = null_vectors(multiply, factor_shifted, d)
    Y = Y[:, _are_null_vectors(K_II, Y, d)]  # none if K_II is only badly conditioned
    force = np.abs(K_ΓI @ Y).max(initial=0.0)
    if force > MAX_INTERFACE_FORCE * np.abs(K_II.data).max() * np.abs(Y).max(initial=0.0):
        raise RemediedFactorError(
            "the matrix of its interior is singular, though the assembled one need not be: take "
            "other subdomains, or the options feti_interior keep and feti_pc_type lumped"
        )
    return Y


def _are_null_vectors(K: scipy.sparse.csr_array, Y: Array, d: Array) -> Mask:
    r"""Return the mask of the columns y whose product K y consists of rounding errors, (r,).

    .. math:: \|d^{-1/2} K y\| ≤ c\, ε\, \bigl(\|d^{-1/2} \sqrt{\textstyle\sum_j K_{ij}^2 y_j^2}\|
              + \|d^{1/2} y\|\bigr)

    with c = ``FORCE_ROUNDING_MARGIN`` and the machine epsilon ε: rounding of the sums K y, if the
    errors of their terms are independent, and of y itself. This is stricter than
    ``null_vectors``, because the result is reported as motions of the assembled matrix, which a
    badly conditioned K_II does not have.

    Args:
        K: The block, (n_{I,i}, n_{I,i}).
        Y: The columns, (n_{I,i}, r).
        d: Absolute diagonal of K, (n_{I,i},), by which forces are scaled.
    """
    root = np.sqrt(positive_diagonal(d))[:, None]
    force = np.linalg.norm((K @ Y) / root, axis=0)
    squared = K.copy()
    squared.data **= 2
    terms = np.linalg.norm(np.sqrt(squared @ Y**2) / root, axis=0)  # in the sums K y
    sizes = np.linalg.norm(root * Y, axis=0)
    return np.asarray(force <= FORCE_ROUNDING_MARGIN * EPS * (terms + sizes))
