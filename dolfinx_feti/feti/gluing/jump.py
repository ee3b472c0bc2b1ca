# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Gluing: the jump operator B, of the pattern, and the weights δ of the copies, of a matrix.

.. math:: B u = c, \qquad B = \begin{pmatrix} B_{jump} \\ B_{Dirichlet} \end{pmatrix}, \quad
          c = \begin{pmatrix} 0 \\ u_D \end{pmatrix}, \qquad
          δ_i = k_i / \sum_j k_j, \quad (B_D)_{ij} = (δ_j, -δ_i)

(eq. 34, Augustin_eq:jumpConstraints, eq. 35, eq. 37, Augustin_eq:jumpoperatorAF), fully redundant:
d copies of a dof give d (d − 1)/2 rows, and those of a Dirichlet dof d, or none in classical FETI.
With stiffnesses k, or ones, :math:`u - B_D^⊤ B u` averages copies; a Dirichlet row has weight one.
"""

from __future__ import annotations

from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np

from dolfinx_feti.runtime.arrays import Array, Indices, Mask, Numbers
from dolfinx_feti.torn.matrix import Torn

#: Least share of a copy in the stiffness of its dof.
LEAST = 1e-12


class Gluing:
    """The jump operator of a torn matrix.

    Attributes:
        B: Jumps, (m, n_torn) over all processes, entries ±1.
        glued: Torn dofs that occur in B, the interface Γ (eq. 31, Augustin_eq:skeleton), (n_Γ,).
    """

    def __init__(self, torn: Torn, *, all_floating: bool) -> None:
        """Build B, with Dirichlet dofs as rows if ``all_floating``. Collective."""
        constrained = torn.dirichlet & all_floating
        self._dirichlet_dofs = np.flatnonzero(constrained)
        ids = torn.gather((torn.start + np.arange(torn.n)).astype(np.float64)).astype(np.int64)
        pairs = _pairs(torn)
        order = np.argsort(ids[pairs], axis=1)  # the columns of a row ascend
        self._pairs = np.take_along_axis(pairs, order, axis=1)
        self._signs = np.where(order == 0, 1.0, -1.0)
        self._ids = ids[self._pairs]
        self._start = torn.start
        self.B = self._jumps(torn, self._signs)
        several = (torn.tear(torn.multiplicity()) > 1.0) & ~torn.dirichlet
        self.glued = np.flatnonzero(several | constrained).astype(np.int32)

    def scaled_jumps(self, torn: Torn, delta: Array) -> PETSc.Mat:
        """Create B_D, of the shape of B, for weights δ, (n,), which the caller ends. Collective."""
        copies = torn.gather(delta)
        return self._jumps(torn, self._signs * copies[self._pairs[:, ::-1]])  # (δ_j, −δ_i)

    def _jumps(self, torn: Torn, values: Array) -> PETSc.Mat:
        """Create a matrix of B's pattern; the values of pairs are (pairs, 2). Collective."""
        single = self._dirichlet_dofs
        rows = len(self._pairs)
        ends = np.concatenate([2 * np.arange(rows + 1), 2 * rows + np.arange(1, len(single) + 1)])
        columns = np.concatenate([self._ids.ravel(), self._start + single])
        data = np.concatenate([values.ravel(), np.ones(len(single))])
        csr = (ends.astype(PETSc.IntType), columns.astype(PETSc.IntType), data)
        sizes = ((len(ends) - 1, None), (torn.n, None))
        return PETSc.Mat().createAIJ(sizes, csr=csr, comm=torn.A.comm)

    def gap(self, u_D: Array) -> Array:
        """Return c of :math:`B u = c`, (m,), for prescribed values on torn Dirichlet dofs, (n,)."""
        return np.concatenate([np.zeros(len(self._pairs)), u_D[self._dirichlet_dofs]])

    def destroy(self) -> None:
        """Free the matrix."""
        self.B.destroy()


@dataclass(frozen=True, slots=True)
class Dofs:
    """The torn dofs of each subdomain of this process, ascending.

    Attributes:
        fixed: Mask of the torn dofs that are fixed in the local matrices, (n,).
        glued: Mask of the interface, (n,).
        free: Free dofs of each subdomain.
        interface: Γ of each subdomain.
        interior: I of each subdomain.
        on_interface: Mask of Γ among the free dofs of each subdomain.
    """

    fixed: Mask
    glued: Mask
    free: list[Indices]
    interface: list[Indices]
    interior: list[Indices]
    on_interface: list[Mask]


def sort_dofs(torn: Torn, glued: Indices, *, all_floating: bool) -> Dofs:
    """Sort the dofs of each subdomain into fixed, glued (those that occur in B), and inside."""
    fixed = torn.dirichlet & (not all_floating)
    mask = np.zeros(torn.n, dtype=bool)
    mask[glued] = True
    free = [rows[~fixed[rows]] for rows in torn.subdomains]
    on = [mask[rows] for rows in free]
    return Dofs(
        fixed=fixed,
        glued=mask,
        free=free,
        interface=[rows[is_glued] for rows, is_glued in zip(free, on, strict=True)],
        interior=[rows[~is_glued] for rows, is_glued in zip(free, on, strict=True)],
        on_interface=on,
    )


def weights_of_copies(torn: Torn, k: Array) -> Array:
    """Weigh the copies of each dof by stiffnesses k ≥ 0; return δ, (n,). Collective."""
    total = torn.tear(torn.assemble(k))
    k = np.where(total > 0.0, np.maximum(k, LEAST * total), 1.0)  # no share is zero
    return np.asarray(k / torn.tear(torn.assemble(k)))  # δᵢ = kᵢ / Σⱼ kⱼ


def _pairs(torn: Torn) -> Numbers:
    """Return all pairs of copies of the free dofs owned, by their places in ``gather``."""
    free = torn.gather((~torn.dirichlet).astype(np.float64)) > 0.5
    degree = torn.multiplicity()
    first = np.cumsum(degree, dtype=np.int64) - degree
    pairs = [np.zeros((0, 2), dtype=np.int64)]
    for d in np.unique(degree[degree > 1]):
        copies = first[degree == d][:, None] + np.arange(d)
        copies = copies[free[copies[:, 0]]]
        i, j = np.triu_indices(d, 1)
        pairs.append(np.stack([copies[:, i], copies[:, j]], axis=-1).reshape(-1, 2))
    return np.concatenate(pairs)
