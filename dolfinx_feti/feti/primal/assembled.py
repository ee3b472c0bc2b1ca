# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""What a subdomain sees of the assembled interface: its own S and the shares of its neighbours.

.. math:: T_i\, A\, T_i^⊤ = S_i + \sum_{j ≠ i} T_i T_j^⊤ S_j\, T_j T_i^⊤ \qquad
          \text{or, without S,} \qquad T_i\, A\, T_i^⊤ ≈ δ^{-1/2} S_i\, δ^{-1/2},

(n_i, n_i): of each neighbour the block of :math:`S_j` with the m rows that both have, its lower
triangle row by row, (m (m + 1) / 2,), in one message for each process.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import scipy.linalg.blas as blas

from dolfinx_feti.feti.coarse.near import joined
from dolfinx_feti.feti.gluing.copies import Copies
from dolfinx_feti.feti.subdomain.blocks import on_subdomains
from dolfinx_feti.feti.subdomain.operator import EliminatedInterior, Operator
from dolfinx_feti.runtime.arrays import Array, Indices, Single
from dolfinx_feti.runtime.native import load, pointer

Multiply = Callable[[Array], Array]

DECLARATIONS = """
void copy_block(int, const double *, int, const int *, double *);
void add_block(int, float *, int, const int *, const double *);
"""

#: Returns a block of S, ``block(j, rows)``, for rows in any order.
Block = Callable[[int, Indices], Array]

#: The share of a neighbour: rows of the subdomain that it has, too, ascending, (m,), and the block
#: of its S, (m (m + 1) / 2,).
Share = tuple[Indices, Array]


def copy_block(code: Any, S: EliminatedInterior, j: int, rows: Indices) -> Array:
    """Return a block of S of subdomain j of this process, (m (m + 1) / 2,)."""
    m, to = len(rows), partial(pointer, code)
    _require_rows(rows, len(S.dofs[j]))
    entries = np.empty(m * (m + 1) // 2)
    code.lib.copy_block(len(S.dofs[j]), to(S.packed(j)), m, to(rows), to(entries))
    return entries


def add_block(code: Any, A: Single, share: Share) -> None:
    """Add a share to A, (n, n) in Fortran's order, below its diagonal."""
    to, (rows, S) = partial(pointer, code), share
    _require_rows(rows, len(A))
    if len(S) != len(rows) * (len(rows) + 1) // 2:
        raise ValueError(f"a share of {len(S)} entries does not fit {len(rows)} rows")
    code.lib.add_block(len(A), to(A, order="F"), len(rows), to(rows), to(S))


def _require_rows(rows: Indices, n: int) -> None:
    """Refuse rows beyond a matrix of order n, before C reads there."""
    if len(rows) and not (rows.min() >= 0 and rows.max() < n):
        raise ValueError(f"rows {rows.min()} … {rows.max()} are not those of a matrix of order {n}")


@dataclass(frozen=True, slots=True)
class _Common:
    """Rows of subdomain i of this process, (m,), of which j, on ``rank``, has ``copies``.

    Subdomains are numbered over all processes, rows in each of them.
    """

    i: int
    j: int
    rank: int
    rows: Indices
    copies: Indices


def assembled_products(S: Operator, copies: Copies) -> Callable[[int], Multiply]:
    """Prepare the products with the assembled A on each subdomain. Collective.

    Returns what returns, without communication, what applies :math:`T_i A T_i^⊤` of subdomain i to
    columns, (n_i, k) → (n_i, k), until it is asked for another one.
    """
    if not isinstance(S, EliminatedInterior):
        return lambda i: _like_itself(S, i, copies.delta[copies.blocks[i]])
    code = load_block_code(copies.comm)
    shares = shares_of_neighbours(copies, partial(copy_block, code, S))
    largest = max((b.stop - b.start for b in copies.blocks), default=0)
    work = np.empty(largest**2, dtype=np.float32)

    def product(i: int) -> Multiply:
        A = S.unpacked(i, work)
        for share in shares(i):
            add_block(code, A, share)
        return lambda X: np.asarray(
            blas.ssymm(1.0, A, np.asfortranarray(X, dtype=np.float32), lower=1), dtype=np.float64
        )

    return product


def load_block_code(comm: MPI.Comm) -> Any:
    """Load the code, which is compiled at first use. Collective."""
    return load(Path(__file__).with_name("assembled.c"), DECLARATIONS, comm)


def _like_itself(S: Operator, i: int, delta: Array) -> Multiply:
    """Return what applies δ^−½ S_i δ^−½; δ is zero with a prescribed value, and on no other dof."""
    root = np.where(delta > 0.0, delta, 1.0)[:, None] ** -0.5
    return lambda X: root * S.multiply_many(i, root * X)


def shares_of_neighbours(copies: Copies, block: Block) -> Callable[[int], list[Share]]:
    """Exchange the blocks of S, ``block(j, rows)``, between processes. Collective.

    Returns what finds the shares of all neighbours of a subdomain of this process.
    """
    rank = copies.comm.rank
    common, first = _common_rows(copies)
    remote = [pair for pair in common if pair.rank != rank]
    received = _exchange(remote, lambda j, rows: block(j - first, rows), copies.comm)

    def share(pair: _Common) -> Share:
        if pair.rank != rank:
            return pair.rows, received[pair.i, pair.j]
        return pair.rows, block(pair.j - first, pair.copies)

    by_subdomain: list[list[_Common]] = [[] for _ in copies.blocks]
    for pair in common:
        by_subdomain[pair.i - first].append(pair)
    return lambda i: [share(pair) for pair in by_subdomain[i]]


def _common_rows(copies: Copies) -> tuple[list[_Common], int]:
    """Find the rows that subdomains have in common; return the number of the first one, too."""
    comm = copies.comm
    sizes = comm.allgather(np.array([b.stop - b.start for b in copies.blocks], dtype=np.int64))
    rank_of = np.repeat(np.arange(comm.size), [len(own) for own in sizes])
    start = np.concatenate([[0], np.cumsum(np.concatenate(sizes))])
    first = sum(len(own) for own in sizes[: comm.rank])
    row = start[first] + copies.row
    i, j = (np.searchsorted(start, n, side="right") - 1 for n in (row, copies.copy))
    order = np.lexsort((row, j, i))
    order = order[i[order] != j[order]]
    ends = np.flatnonzero(np.diff(i[order]) | np.diff(j[order])) + 1
    common = []
    for pair in np.split(order, ends) if len(order) else []:
        a, b = int(i[pair[0]]), int(j[pair[0]])
        rows = (row[pair] - start[a]).astype(np.int32)
        others = (copies.copy[pair] - start[b]).astype(np.int32)
        common.append(_Common(a, b, int(rank_of[b]), rows, others))
    return common, first


def _exchange(
    remote: Sequence[_Common], block: Block, comm: MPI.Comm
) -> dict[tuple[int, int], Array]:
    """Send blocks to the processes of neighbours; return theirs, by i and j. Collective."""
    outgoing = sorted(remote, key=lambda pair: (pair.rank, pair.j, pair.i))
    incoming = sorted(remote, key=lambda pair: (pair.rank, pair.i, pair.j))
    sent = on_subdomains(
        lambda: joined([block(pair.i, pair.rows[np.argsort(pair.copies)]) for pair in outgoing]),
        comm,
    )
    sizes = np.array([len(pair.rows) * (len(pair.rows) + 1) // 2 for pair in incoming], np.int64)
    ranks = np.array([pair.rank for pair in incoming], np.int64)
    counts = np.bincount(ranks, sizes, comm.size).astype(np.int64)  # of blocks, the same both ways
    got = np.empty(counts.sum())
    comm.Alltoallv((sent, counts), (got, counts))
    pairs = [(pair.i, pair.j) for pair in incoming]
    return dict(zip(pairs, np.split(got, np.cumsum(sizes)), strict=False))
