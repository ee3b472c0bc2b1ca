# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Gluing: the jump operator B and its scaled companion B_D.

Continuity across the interface and, for all-floating FETI, the Dirichlet conditions are rows of

.. math:: B u = c, \qquad B = \begin{pmatrix} B_{jump} \\ B_{Dirichlet} \end{pmatrix}, \quad
          c = \begin{pmatrix} 0 \\ u_D \end{pmatrix}

(eq. 34, Augustin_eq:jumpConstraints, eq. 35, eq. 37, Augustin_eq:jumpoperatorAF). A dof with d
copies gives d (d − 1)/2 rows if the gluing is fully redundant and d − 1 if it is not. A Dirichlet
dof is not glued: all-floating FETI gives it one row per copy, classical FETI none.

The scaled jump operator of the preconditioners weighs a copy by the *other* side's stiffness k,

.. math:: δ_i = k_i / \sum_j k_j, \qquad (B_D)_{ij} = (δ_j, -δ_i),

with k = 1 for multiplicity scaling, so that :math:`B_D^⊤ B` is a projection and
:math:`u - B_D^⊤ B u` averages the copies. A Dirichlet row has weight one. B depends on the pattern
alone; :meth:`Gluing.update` takes the stiffness of the present matrix into δ and B_D.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx_feti.torn import Torn

__all__ = ["Gluing"]

Array = npt.NDArray[np.float64]

#: Least share of a copy.
LEAST = 1e-12


class Gluing:
    """The jump operator of a torn matrix.

    Attributes:
        B: Jumps, (m, n_torn) over all processes, entries ±1.
        B_D: Scaled jumps, same shape; for full gluing also the same pattern.
        delta: Weight δ of every torn dof, (n,); the copies of a dof sum to one.
        dirichlet_rows: Local rows of B that hold Dirichlet conditions.
        dirichlet_dofs: The torn dof of each of them.
        glued: Torn dofs that occur in B, the interface Γ (eq. 31, Augustin_eq:skeleton), (n_Γ,).
    """

    def __init__(self, torn: Torn, *, all_floating: bool, redundant: bool = True) -> None:
        """Build B, and B_D with the weights of multiplicity scaling.

        Args:
            torn: The torn matrix.
            all_floating: Make Dirichlet dofs rows of B.
            redundant: A row for each pair of copies, not only for a chain of them.

        Note:
            Collective.
        """
        self._torn = torn
        self._redundant = redundant
        self._held = np.flatnonzero(torn.dirichlet & all_floating)
        self.delta = _shares(torn, np.ones(torn.n))
        rows = self._rows()
        self.B = _assemble(torn, [(block.ids, block.B) for block in rows])
        self.B_D = _assemble(torn, [(block.ids_D, block.B_D) for block in rows])
        m = self.B.getLocalSize()[0]
        self.dirichlet_rows = np.arange(m - len(self._held), m, dtype=np.int32)
        self.dirichlet_dofs = self._held.astype(np.int32)
        copies = _over_copies(torn, np.ones(torn.n))
        glued = (copies > 1.5) & ~torn.dirichlet
        glued[self._held] = True
        self.glued = np.flatnonzero(glued).astype(np.int32)

    def update(self, stiffness: Array) -> None:
        """Weigh the copies of each dof by a stiffness.

        Args:
            stiffness: Stiffness k of every torn dof, not negative, (n,).

        Note:
            Collective.
        """
        self.delta = _shares(self._torn, stiffness)
        blocks = [(block.ids_D, block.B_D) for block in self._rows()]
        self.B_D.setValuesCSR(*_csr(blocks))
        self.B_D.assemble()

    def gap(self, u_D: Array) -> Array:
        """Return the right-hand side c of :math:`B u = c`, (m,).

        Args:
            u_D: Prescribed values on the torn Dirichlet dofs, (n,).
        """
        c = np.zeros(self.B.getLocalSize()[0])
        c[self.dirichlet_rows] = u_D[self.dirichlet_dofs]
        return c

    def _rows(self) -> list[_Rows]:
        """Form the rows of this process: jumps by multiplicity, then Dirichlet conditions."""
        rows = [
            _jumps(ids, delta, redundant=self._redundant)
            for ids, delta in _copies(self._torn, self.delta)
        ]
        ids = self._torn.start + self._held[:, None]
        one = np.ones((len(ids), 1))
        return [*rows, _Rows(ids, one, ids, one)]

    def destroy(self) -> None:
        """Free the matrices."""
        self.B.destroy()
        self.B_D.destroy()


@dataclass(frozen=True, slots=True)
class _Rows:
    """Rows of B and B_D: global torn columns and values, each (rows, entries per row)."""

    ids: npt.NDArray[np.integer]
    B: Array
    ids_D: npt.NDArray[np.integer]
    B_D: Array


def _shares(torn: Torn, k: Array) -> Array:
    """Return the share of each copy in the stiffness of its dof, δ, (n,).

    No share is zero, and copies without any stiffness share alike.
    """
    total = _over_copies(torn, k)
    k = np.where(total > 0.0, np.maximum(k, LEAST * total), 1.0)
    return np.asarray(k / _over_copies(torn, k))  # δᵢ = kᵢ / Σⱼ kⱼ


def _over_copies(torn: Torn, t: Array) -> Array:
    """Sum over the copies of each dof and hand the sum back to every copy, T Tᵀ t."""
    x = torn.A.createVecRight()
    x.array[:] = torn.assemble(t)
    total = torn.tear(x)
    x.destroy()
    return total


def _copies(torn: Torn, delta: Array) -> Iterator[tuple[npt.NDArray[np.integer], Array]]:
    """Yield, for each multiplicity d ≥ 2, ids and weights of the copies: two (dofs, d) arrays."""
    free = torn.gather((~torn.dirichlet).astype(np.float64))
    ids = torn.gather((torn.start + np.arange(torn.n)).astype(np.float64))
    weights = torn.gather(delta)
    degree = torn.multiplicity()
    first = np.concatenate(([0], np.cumsum(degree)[:-1])).astype(np.int64)
    for d in np.unique(degree[degree > 1]):
        of = first[degree == d][:, None] + np.arange(d)
        of = of[free[of[:, 0]] > 0.5]
        yield ids[of].astype(np.int64), weights[of]


def _jumps(ids: npt.NDArray[np.integer], delta: Array, *, redundant: bool) -> _Rows:
    """Form the rows of dofs with d copies, ids and δ being (dofs, d)."""
    d = ids.shape[1]
    if redundant:
        a, b = np.triu_indices(d, 1)
        pair = np.stack([ids[:, a], ids[:, b]], axis=-1).reshape(-1, 2)
        weight = np.stack([delta[:, b], -delta[:, a]], axis=-1).reshape(-1, 2)
        return _Rows(pair, np.broadcast_to([1.0, -1.0], pair.shape), pair, weight)
    chain = np.stack([ids[:, :-1], ids[:, 1:]], axis=-1).reshape(-1, 2)
    right = np.tri(d - 1, d)  # transposed right inverse of B: uᵢ = rᵢ + … + r_{d−1}
    B_D = right - np.cumsum(delta, axis=1)[:, :-1, None]  # B_Dᵀ = (I − 1 δᵀ) B⁻¹
    return _Rows(
        chain,
        np.broadcast_to([1.0, -1.0], chain.shape),
        np.repeat(ids, d - 1, axis=0),
        B_D.reshape(-1, d),
    )


def _csr(
    blocks: list[tuple[npt.NDArray[np.integer], Array]],
) -> tuple[npt.NDArray[np.integer], npt.NDArray[np.integer], Array]:
    """Put row blocks (columns, values) below each other, as rows in CSR."""
    order = [np.argsort(ids, axis=1) for ids, _ in blocks]
    columns = [
        np.take_along_axis(ids, o, 1).ravel() for (ids, _), o in zip(blocks, order, strict=True)
    ]
    values = [np.take_along_axis(v, o, 1).ravel() for (_, v), o in zip(blocks, order, strict=True)]
    widths = np.concatenate([np.full(len(ids), ids.shape[1]) for ids, _ in blocks])
    return (
        np.concatenate(([0], np.cumsum(widths))).astype(PETSc.IntType),
        np.concatenate(columns).astype(PETSc.IntType),
        np.concatenate(values),
    )


def _assemble(torn: Torn, blocks: list[tuple[npt.NDArray[np.integer], Array]]) -> PETSc.Mat:
    """Put row blocks (columns, values) below each other into one matrix, (m, n_torn)."""
    csr = _csr(blocks)
    sizes = ((len(csr[0]) - 1, None), (torn.n, None))
    return PETSc.Mat().createAIJ(sizes, csr=csr, comm=torn.A.comm)
