# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Gluing: the constraints B u = c, with a multiplier λ for each, and the scaled jumps B_D.

.. math:: B u = c, \qquad B = \begin{pmatrix} B_{jump} \\ B_{Dirichlet} \end{pmatrix}, \quad
          c = \begin{pmatrix} 0 \\ u_D \end{pmatrix}

(eq. 34; eq. 35; eq. 37). The gluing is fully redundant: a free dof with d copies has d (d − 1)/2
rows of :math:`B_{jump}`, one for each pair. In all-floating FETI each copy of a Dirichlet dof has a
row of :math:`B_{Dirichlet}`; in classical FETI there are none. :math:`-B^⊤ λ` are the forces of the
gluing on the subdomains.

The row of B for copies i and j is :math:`u_i - u_j`. In :math:`B_D` it is
:math:`δ_j u_i - δ_i u_j`, with the weights δ (``scaling``), so that :math:`u - B_D^⊤ B u` averages
the copies. Dirichlet rows are the same in both.
"""

from __future__ import annotations

from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np

from dolfinx_feti.runtime.arrays import Array, Mask, Numbers
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.torn.matrix import Torn


@dataclass(frozen=True, slots=True)
class GluedPairs:
    """Two copies of a dof for each row of B_jump, which glues them to each other.

    They are all pairs of different copies of the free dofs that this process owns.

    Attributes:
        positions: Both copies as positions in the result of ``Torn.gather``, (pairs, 2).
        columns: Both copies as columns of B, ascending in each row, (pairs, 2). Columns are torn
            dofs, numbered over all processes.
        signs: Entries 1 and −1 of B in these columns, (pairs, 2).
    """

    positions: Numbers
    columns: Numbers
    signs: Array


class Gluing:
    """The constraints B u = c of a torn matrix; λ has an entry for each row of B.

    The rows of a process, m, are those of the pairs of copies of the dofs that it owns, and after
    them those of its torn Dirichlet dofs. The primal formulation uses ``interface_dofs`` alone, and
    the report the number of rows of B.

    Attributes:
        B: Jump operator with entries ±1, distributed, with m rows and n columns on this process.
        interface_dofs: Torn dofs of this process that occur in B, the interface Γ (eq. 31),
            ascending.
    """

    def __init__(self, torn: Torn, *, all_floating: bool) -> None:
        """Assemble B. Collective.

        Args:
            torn: The torn matrix.
            all_floating: Whether the copies of Dirichlet dofs have rows in B.
        """
        has_dirichlet_row = torn.is_dirichlet_copy & all_floating
        self._dirichlet_dofs = np.flatnonzero(has_dirichlet_row)
        self._pairs = _find_glued_pairs(torn)
        self.B = self._assemble(torn, self._pairs.signs)
        has_copies = (torn.tear(torn.multiplicity()) > 1) & ~torn.is_dirichlet_copy
        self.interface_dofs = np.flatnonzero(has_copies | has_dirichlet_row).astype(np.int32)

    def scaled_jumps(self, torn: Torn, delta: Array) -> PETSc.Mat:
        """Assemble the scaled jump operator B_D; the caller destroys it. Collective.

        Args:
            torn: The torn matrix.
            delta: Weight δ of each copy, (n,).

        Returns:
            B_D, with the pattern of B.
        """
        weight_of_copy = torn.gather(delta)
        weight_of_other = weight_of_copy[self._pairs.positions[:, ::-1]]
        return self._assemble(torn, self._pairs.signs * weight_of_other)  # δ_j u_i − δ_i u_j

    def gap(self, u_D: Array) -> Array:
        """Return the gap c, (m,): 0 between copies, and u_D in Dirichlet rows.

        Args:
            u_D: Prescribed values on the torn Dirichlet dofs, (n,).
        """
        return np.concatenate([np.zeros(len(self._pairs.signs)), u_D[self._dirichlet_dofs]])

    def _assemble(self, torn: Torn, values: Array) -> PETSc.Mat:
        """Assemble a matrix with the pattern of B. Collective.

        Args:
            torn: The torn matrix.
            values: Entries of the rows of pairs, (pairs, 2). The entry of a Dirichlet row is 1.
        """
        pairs = len(values)
        dirichlet = len(self._dirichlet_dofs)
        ends_of_pairs = 2 * np.arange(pairs + 1)
        ends_of_dirichlet = 2 * pairs + np.arange(1, dirichlet + 1)
        dirichlet_columns = torn.first_torn_dof + self._dirichlet_dofs
        indptr = np.concatenate([ends_of_pairs, ends_of_dirichlet])
        columns = np.concatenate([self._pairs.columns.ravel(), dirichlet_columns])
        entries = np.concatenate([values.ravel(), np.ones(dirichlet)])
        csr = (indptr.astype(PETSc.IntType), columns.astype(PETSc.IntType), entries)
        sizes = ((pairs + dirichlet, None), (torn.n, None))
        return PETSc.Mat().createAIJ(sizes, csr=csr, comm=torn.A.comm)

    def destroy(self) -> None:
        """Free B."""
        self.B.destroy()


def _find_glued_pairs(torn: Torn) -> GluedPairs:
    """Find the pairs of copies of the free dofs that this process owns. Collective."""
    column_of_copy = torn.gather(torn.first_torn_dof + np.arange(torn.n, dtype=np.int64))
    is_free = torn.gather((~torn.is_dirichlet_copy).astype(np.int64)) > 0
    multiplicity = torn.multiplicity()

    def sort_pairs() -> GluedPairs:
        """Return the pairs, each with its columns in ascending order, as PETSc needs them."""
        positions = _all_pairs(is_free, multiplicity)
        order = np.argsort(column_of_copy[positions], axis=1)
        positions = np.take_along_axis(positions, order, axis=1)
        signs = np.where(order == 0, 1.0, -1.0)  # u_i − u_j for the pair (i, j) before sorting
        return GluedPairs(positions, column_of_copy[positions], signs)

    return on_all(sort_pairs, torn.comm)


def _all_pairs(is_free: Mask, multiplicity: Numbers) -> Numbers:
    """Return all pairs of copies of the free dofs that this process owns.

    Args:
        is_free: Mask of the copies without a prescribed value, in the order of ``Torn.gather``.
        multiplicity: Number of copies of each owned dof, (owned,).

    Returns:
        Positions of both copies in the order of ``Torn.gather``, (pairs, 2).
    """
    first = np.cumsum(multiplicity, dtype=np.int64) - multiplicity
    pairs = [np.zeros((0, 2), dtype=np.int64)]
    for d in np.unique(multiplicity[multiplicity > 1]):
        copies = first[multiplicity == d][:, None] + np.arange(d)  # (dofs with d copies, d)
        copies = copies[is_free[copies[:, 0]]]
        i, j = np.triu_indices(d, 1)
        pairs.append(np.stack([copies[:, i], copies[:, j]], axis=-1).reshape(-1, 2))
    return np.concatenate(pairs)
