# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Check that scalars and their equations depend on u, and not on each other."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import scipy.linalg

from dolfinx_feti.runtime.arrays import Array, Mask
from dolfinx_feti.runtime.collective import total_of
from dolfinx_feti.scalars.border import Border

__all__ = ["require_independent"]

#: Sine of the angle between two normalised constraints below which they count as dependent. Its
#: square is compared with an eigenvalue of their products. The rounding errors of the eigenvalue
#: are some 2e-16, and their root is 1.4e-8: the sine is seven times as large, as a margin.
DEPENDENT_SINE = 1e-7

#: Largest derivative of an equation by the free dofs, relative to that by all dofs, that counts as
#: zero: a margin above rounding, not measured.
ROUNDING_SHARE = 1e-10

#: Smallest coefficient, in a combination of norm one that vanishes, of an equation that is named in
#: the message. It affects the message alone.
NAMED_ENTRY = 1e-3


def require_independent(border: Border, is_free: Mask, comm: MPI.Comm) -> None:
    """Check that the equations, and the unknowns, depend on u and not on each other. Collective.

    Args:
        border: B, C and D of the scalars.
        is_free: Mask of the dofs without Dirichlet condition, (N,).
        comm: Communicator.

    Raises:
        ValueError: They do not; on all processes.
    """
    _check_columns(border.C, border.D.T, is_free, "equations", comm)
    _check_columns(border.B, border.D, is_free, "unknowns", comm)


def _check_columns(columns: Array, corner: Array, is_free: Mask, name: str, comm: MPI.Comm) -> None:
    """Check that columns of a border are not zero on free dofs, and independent. Collective.

    Columns that are coupled to a scalar by D are not checked: to another one, or to their own,
    whose equation then determines it.

    Args:
        columns: B or C, (N, m).
        corner: D or Dᵀ, (m, m).
        is_free: Mask of the dofs without Dirichlet condition, (N,).
        name: Name of the columns in a message.
        comm: Communicator.
    """
    all_squares = total_of((columns**2).sum(axis=0), comm)
    gram = total_of(columns[is_free].T @ columns[is_free], comm)
    size = np.sqrt(gram.diagonal())
    is_coupled = np.abs(corner).max(axis=0, initial=0.0) > 0.0  # to another scalar, or to itself
    is_zero = size <= ROUNDING_SHARE * np.sqrt(all_squares)
    without_effect = np.flatnonzero(is_zero & ~is_coupled)
    if len(without_effect):
        raise ValueError(
            f"The scalar {name} {without_effect.tolist()} depend neither on a free dof of u nor on "
            "another scalar, so that no solve can satisfy them. Look at the Dirichlet "
            "conditions and at the measures."
        )
    uncoupled = np.flatnonzero(~is_coupled)
    if not len(uncoupled):
        return
    normalised = gram[np.ix_(uncoupled, uncoupled)] / np.outer(size[uncoupled], size[uncoupled])
    values, vectors = scipy.linalg.eigh(normalised)
    if values[0] < DEPENDENT_SINE**2:
        dependent = uncoupled[np.abs(vectors[:, 0]) > NAMED_ENTRY]
        raise ValueError(
            f"The scalar {name} {dependent.tolist()} depend on each other, so that they "
            "contradict each other or leave a multiplier free: leave one of them out."
        )
