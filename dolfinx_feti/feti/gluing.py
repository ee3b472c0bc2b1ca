# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Gluing: the jump operator B and its scaled companion B_D.

Continuity across the interface and, for all-floating FETI, the Dirichlet conditions are rows of

.. math:: B u = c, \qquad B = \begin{pmatrix} B_{jump} \\ B_{Dirichlet} \end{pmatrix}, \quad
          c = \begin{pmatrix} 0 \\ u_D \end{pmatrix}

(eq. 34, Augustin_eq:jumpConstraints, eq. 35, eq. 37, Augustin_eq:jumpoperatorAF). A dof with d
copies gives d (d − 1)/2 rows if the gluing is fully redundant and d − 1 if it is not. A Dirichlet
dof is not glued: all-floating FETI gives it one row a copy, classical FETI none.

The scaled jump operator of the preconditioners weighs a copy by the *other* side's stiffness k,

.. math:: δ_i = k_i / \sum_j k_j, \qquad (B_D)_{ij} = (δ_j, -δ_i),

with k = 1 for multiplicity scaling, so that :math:`B_D^⊤ B` is a projection and
:math:`u - B_D^⊤ B u` averages the copies. A Dirichlet row has weight one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx_feti.torn import Torn

__all__ = ["Gluing", "create_gluing"]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
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

    B: PETSc.Mat
    B_D: PETSc.Mat
    delta: Array
    dirichlet_rows: npt.NDArray[np.int32]
    dirichlet_dofs: npt.NDArray[np.int32]
    glued: npt.NDArray[np.int32]

    def gap(self, u_D: Array) -> Array:
        """Return the right-hand side c of :math:`B u = c`, (m,).

        Args:
            u_D: Prescribed values on the torn Dirichlet dofs, (n,).
        """
        c = np.zeros(self.B.getLocalSize()[0])
        c[self.dirichlet_rows] = u_D[self.dirichlet_dofs]
        return c

    def destroy(self) -> None:
        """Free the matrices."""
        self.B.destroy()
        self.B_D.destroy()


def create_gluing(
    torn: Torn, *, all_floating: bool, redundant: bool = True, stiffness: Array | None = None
) -> Gluing:
    """Build B and B_D from the copies of each dof.

    Args:
        torn: The torn matrix.
        all_floating: Give every Dirichlet dof a row a copy; otherwise it has none.
        redundant: All pairs of copies, or a chain of them.
        stiffness: Stiffness k of each torn dof, (n,), positive; multiplicity scaling if not given.

    Note:
        Collective. A row lives with the owner of its dof, a Dirichlet row with its copy.
    """
    k = np.ones(torn.n) if stiffness is None else stiffness
    delta = k / _over_copies(torn, k)  # δᵢ = kᵢ / Σⱼ kⱼ
    glued = (_over_copies(torn, np.ones(torn.n)) > 1.5) & ~torn.dirichlet
    rows = [_jumps(ids, δ, redundant=redundant) for ids, δ in _copies(torn, delta)]

    dirichlet = np.flatnonzero(torn.dirichlet & all_floating)
    one = np.ones((len(dirichlet), 1))
    ids = torn.start + dirichlet[:, None]
    rows.append(_Rows(ids, one, ids, one))
    m = sum(len(block.B) for block in rows)
    return Gluing(
        B=_assemble(torn, [(block.ids, block.B) for block in rows]),
        B_D=_assemble(torn, [(block.ids_D, block.B_D) for block in rows]),
        delta=delta,
        dirichlet_rows=np.arange(m - len(dirichlet), m, dtype=np.int32),
        dirichlet_dofs=dirichlet.astype(np.int32),
        glued=np.flatnonzero(glued | (torn.dirichlet & all_floating)).astype(np.int32),
    )


@dataclass(frozen=True, slots=True)
class _Rows:
    """Rows of B and B_D: global torn columns and values, each (rows, entries a row)."""

    ids: npt.NDArray[np.integer]
    B: Array
    ids_D: npt.NDArray[np.integer]
    B_D: Array


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
    B = np.eye(d - 1, d) - np.eye(d - 1, d, 1)
    BW = B / delta[:, None, :]
    B_D = np.linalg.solve(BW @ B.T, BW)  # (B W⁻¹ Bᵀ)⁻¹ B W⁻¹, W = diag(δ)
    return _Rows(
        chain,
        np.broadcast_to([1.0, -1.0], chain.shape),
        np.repeat(ids, d - 1, axis=0),
        B_D.reshape(-1, d).astype(np.float64),
    )


def _assemble(torn: Torn, blocks: list[tuple[npt.NDArray[np.integer], Array]]) -> PETSc.Mat:
    """Put row blocks (columns, values) below each other into one matrix, (m, n_torn)."""
    order = [np.argsort(ids, axis=1) for ids, _ in blocks]
    columns = [
        np.take_along_axis(ids, o, 1).ravel() for (ids, _), o in zip(blocks, order, strict=True)
    ]
    values = [np.take_along_axis(v, o, 1).ravel() for (_, v), o in zip(blocks, order, strict=True)]
    widths = np.concatenate([np.full(len(ids), ids.shape[1]) for ids, _ in blocks])
    csr = (
        np.concatenate(([0], np.cumsum(widths))).astype(PETSc.IntType),
        np.concatenate(columns).astype(PETSc.IntType),
        np.concatenate(values),
    )
    sizes = ((len(widths), None), (torn.n, None))
    return PETSc.Mat().createAIJ(sizes, csr=csr, comm=torn.A.comm)
