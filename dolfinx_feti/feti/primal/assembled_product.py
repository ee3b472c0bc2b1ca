# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The assembled interface operator restricted to one subdomain, for ``coarse/adaptive``.

.. math:: T_i\, A\, T_i^⊤ = S_i + \sum_{j ≠ i} T_i T_j^⊤ S_j\, T_j T_i^⊤ \qquad
          \text{or, if S is not formed,} \qquad T_i\, A\, T_i^⊤ ≈ δ^{-1/2} S_i\, δ^{-1/2},

(n_{Γ,i}, n_{Γ,i}), where T_i are the rows of T of subdomain i. Each neighbour j contributes the
*block* of :math:`S_j` on the b dofs that it shares with subdomain i: the lower triangle row by row,
(b (b + 1) / 2,). Each pair of processes exchanges its blocks in one message. Adaptive columns need
a few correct digits only; with a formed S products are in single precision, which halves memory and
time.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import scipy.linalg.blas as blas

from dolfinx_feti.feti.interface.copies import Copies
from dolfinx_feti.feti.subdomain.failures import on_subdomains
from dolfinx_feti.feti.subdomain.schur import FormedSchurComplement, SchurComplement
from dolfinx_feti.feti.subdomain.schur_operator import FormedSchurOperator, SchurOperator
from dolfinx_feti.runtime.arrays import Array, Indices, Single, concatenate
from dolfinx_feti.runtime.native import load_with_header, pointer

#: ``block(j, rows)`` returns the block of S_j on b of its rows, in any order, (b (b + 1) / 2,). The
#: subdomain is one of this process. Its number j counts those of this process in
#: ``NeighbourBlocks.__init__``, and those of all processes in ``_exchange_blocks``.
BlockOfSubdomain = Callable[[int, Indices], Array]


@dataclass(frozen=True, slots=True)
class SharedBlock:
    """The block that a neighbour adds to the assembled matrix of a subdomain.

    Attributes:
        rows: Rows of the subdomain whose dofs it shares with the neighbour, ascending, (b,).
        entries: Block of the neighbour's S on the same dofs, its lower triangle row by row,
            (b (b + 1) / 2,).
    """

    rows: Indices
    entries: Array


class AssembledProduct(ABC):
    """Product with the assembled operator restricted to one subdomain, T_i A T_iᵀ.

    A product is not collective: the constructor fetches what neighbours contribute.
    """

    @abstractmethod
    def apply(self, i: int, X: Array) -> Array:
        """Return T_i A T_iᵀ X for subdomain i of this process, (n_{Γ,i}, k) → (n_{Γ,i}, k).

        Products with the same i should follow each other: a change of i may assemble a matrix.
        """


def create_assembled_product(S: SchurOperator, copies: Copies) -> AssembledProduct:
    """Prepare the products with T_i A T_iᵀ of all subdomains of this process. Collective.

    Args:
        S: Schur complements of the subdomains of this process.
        copies: Copies of the interface dofs.
    """
    if isinstance(S, FormedSchurOperator):
        return ProductWithNeighbours(S.by_subdomain, copies)
    return ProductWithoutNeighbours(S.by_subdomain, copies)


class ProductWithNeighbours(AssembledProduct):
    """T_i A T_iᵀ of formed Schur complements, in single precision.

    The first product of a subdomain assembles its matrix, which is stored until that of another
    subdomain.
    """

    def __init__(self, S: Sequence[FormedSchurComplement], copies: Copies) -> None:
        """Exchange the blocks of neighbours. Collective.

        Args:
            S: S_i of the subdomains of this process.
            copies: Copies of the interface dofs.
        """
        code = load_block_code(copies.comm)
        self._code = code
        self._S = S
        self._neighbours = NeighbourBlocks(copies, lambda j, rows: copy_block(code, S[j], rows))
        largest = max((rows.stop - rows.start for rows in copies.rows), default=0)
        self._work = np.empty(largest**2, dtype=np.float32)
        self._assembled: int | None = None  # subdomain whose matrix the work space holds
        self._A: Single = np.empty((0, 0), dtype=np.float32)  # its lower triangle

    def apply(self, i: int, X: Array) -> Array:
        """Return T_i A T_iᵀ X in single precision, (n_{Γ,i}, k)."""
        if self._assembled != i:
            self._A = self._assemble(i)
            self._assembled = i
        single = np.asfortranarray(X, dtype=np.float32)
        return np.asarray(blas.ssymm(1.0, self._A, single, lower=1), dtype=np.float64)

    def _assemble(self, i: int) -> Single:
        """Return the lower triangle of T_i A T_iᵀ, (n_{Γ,i}, n_{Γ,i}), in the work space."""
        A = self._S[i].matrix.copy_in_single_precision(self._work)
        for block in self._neighbours.blocks_of(i):
            add_block(self._code, A, block)
        return A


class ProductWithoutNeighbours(AssembledProduct):
    """δ^−½ S_i δ^−½, an approximation by S_i alone.

    If each neighbour's block is a multiple of S_i, in the proportion of the stiffnesses of the
    copies, the sum over the copies multiplies S_i by 1/δ.
    """

    def __init__(self, S: Sequence[SchurComplement], copies: Copies) -> None:
        """Compute δ^−½; for dofs with a prescribed value, which alone have δ = 0, it is one."""
        self._S = S
        self._rows = copies.rows
        self._root = np.where(copies.delta > 0.0, copies.delta, 1.0)[:, None] ** -0.5  # δ^−½

    def apply(self, i: int, X: Array) -> Array:
        """Return δ^−½ S_i δ^−½ X, (n_{Γ,i}, k)."""
        root = self._root[self._rows[i]]
        return root * self._S[i].multiply(root * X)


class NeighbourBlocks:
    """The blocks of the neighbours' Schur complements on the rows shared with each subdomain.

    Subdomains have two numbers: i and j on this process, or ``number`` over all processes.
    """

    def __init__(self, copies: Copies, block: BlockOfSubdomain) -> None:
        """Find the shared rows, and exchange the blocks of other processes. Collective.

        Args:
            copies: Copies of the interface dofs.
            block: Block of S of a subdomain, by its number on this process.
        """
        comm = copies.comm
        count = len(copies.rows)
        self._rank = comm.rank
        self._first_number = comm.scan(count) - count  # of the first subdomain of this process
        self._block = block
        self._shared: list[list[SharedRows]] = [[] for _ in range(count)]
        for pair in find_shared_rows(copies):
            self._shared[pair.subdomain - self._first_number].append(pair)
        remote = [pair for pairs in self._shared for pair in pairs if pair.rank != comm.rank]
        self._received = _exchange_blocks(remote, self._local_block, comm)

    def blocks_of(self, i: int) -> list[SharedBlock]:
        """Return the blocks that all neighbours add to the matrix of subdomain i."""
        return [SharedBlock(pair.rows, self._entries(pair)) for pair in self._shared[i]]

    def _entries(self, pair: SharedRows) -> Array:
        """Return the block of the neighbour's S, (b (b + 1) / 2,)."""
        if pair.rank == self._rank:
            return self._local_block(pair.neighbour, pair.neighbour_rows)
        return self._received[pair.subdomain, pair.neighbour]

    def _local_block(self, number: int, rows: Indices) -> Array:
        """Return a block of S of a subdomain of this process, by its number over all processes."""
        return self._block(number - self._first_number, rows)


@dataclass(frozen=True, slots=True)
class SharedRows:
    """The interface dofs that a subdomain of this process shares with a neighbour.

    Subdomains are numbered over all processes, rows within each subdomain.

    Attributes:
        subdomain: Number of the subdomain.
        neighbour: Number of the neighbour.
        rank: Process of the neighbour.
        rows: Rows of the subdomain, ascending, (b,).
        neighbour_rows: The same dofs among the rows of the neighbour, (b,).
    """

    subdomain: int
    neighbour: int
    rank: int
    rows: Indices
    neighbour_rows: Indices


def find_shared_rows(copies: Copies) -> list[SharedRows]:
    """Find the dofs that each subdomain of this process shares with each neighbour. Collective.

    Returns:
        An object for each pair of a subdomain and a neighbour, sorted by subdomain, then neighbour.
    """
    comm = copies.comm
    local_sizes = [rows.stop - rows.start for rows in copies.rows]
    sizes = comm.allgather(np.array(local_sizes, dtype=np.int64))  # n_{Γ,i} of each process
    rank_of_subdomain = np.repeat(np.arange(comm.size), [len(each) for each in sizes])
    first_row = np.concatenate([[0], np.cumsum(np.concatenate(sizes))])  # of each subdomain
    first_subdomain = sum(len(each) for each in sizes[: comm.rank])  # of this process

    # Number both rows of each pair of copies over all processes, and find their subdomains.
    row = first_row[first_subdomain] + copies.pair_rows
    neighbour_row = copies.pair_copies
    subdomain = np.searchsorted(first_row, row, side="right") - 1
    neighbour = np.searchsorted(first_row, neighbour_row, side="right") - 1

    # Sort the pairs by subdomain, neighbour and row, without those of a row with itself.
    order = np.lexsort((row, neighbour, subdomain))
    order = order[subdomain[order] != neighbour[order]]
    if not len(order):
        return []

    # Split the sorted pairs where the subdomain or the neighbour changes.
    is_new_subdomain = np.diff(subdomain[order]) != 0
    is_new_neighbour = np.diff(neighbour[order]) != 0
    ends = np.flatnonzero(is_new_subdomain | is_new_neighbour) + 1
    shared = []
    for pairs in np.split(order, ends):
        i = int(subdomain[pairs[0]])
        j = int(neighbour[pairs[0]])
        shared.append(
            SharedRows(
                subdomain=i,
                neighbour=j,
                rank=int(rank_of_subdomain[j]),
                rows=(row[pairs] - first_row[i]).astype(np.int32),
                neighbour_rows=(neighbour_row[pairs] - first_row[j]).astype(np.int32),
            )
        )
    return shared


def _exchange_blocks(
    remote: Sequence[SharedRows], block: BlockOfSubdomain, comm: MPI.Comm
) -> dict[tuple[int, int], Array]:
    """Exchange blocks between neighbours on different processes. Collective.

    Here a pair is a subdomain and its neighbour, and not two copies of a dof. A message from one
    process to another has the blocks of all their pairs, sorted by the receiver's subdomain and
    then by the sender's. Both processes know both numbers of each pair, and therefore sort the
    pairs alike. The rows of a block are in the receiver's order. The two blocks of a pair are on
    the same dofs, and therefore of the same size.

    Args:
        remote: Dofs shared with neighbours on other processes.
        block: Block of S of a subdomain of this process, by its number over all processes.
        comm: All processes.

    Returns:
        The block of the neighbour for each pair (subdomain, neighbour), (b (b + 1) / 2,).
    """
    # The receiver's subdomain is pair.neighbour of outgoing, and pair.subdomain of incoming blocks.
    outgoing = sorted(remote, key=lambda pair: (pair.rank, pair.neighbour, pair.subdomain))
    incoming = sorted(remote, key=lambda pair: (pair.rank, pair.subdomain, pair.neighbour))

    def outgoing_entries() -> Array:
        """Return the entries of all messages, one after the other."""
        blocks = []
        for pair in outgoing:
            rows = pair.rows[np.argsort(pair.neighbour_rows)]  # in the receiver's order
            blocks.append(block(pair.subdomain, rows))
        return concatenate(blocks)

    sent = on_subdomains(outgoing_entries, comm)
    sizes = np.array([len(pair.rows) * (len(pair.rows) + 1) // 2 for pair in incoming], np.int64)
    ranks = np.array([pair.rank for pair in incoming], np.int64)
    counts = np.bincount(ranks, sizes, comm.size).astype(np.int64)  # the same in both directions
    received = np.empty(counts.sum())
    comm.Alltoallv((sent, counts), (received, counts))
    ends = np.cumsum(sizes)
    return {
        (pair.subdomain, pair.neighbour): received[end - size : end]
        for pair, size, end in zip(incoming, sizes, ends, strict=True)
    }


def load_block_code(comm: MPI.Comm) -> Any:
    """Load the C code, after compiling it at its first use. Collective."""
    return load_with_header(Path(__file__).with_name("assembled_product.c"), comm)


def copy_block(code: Any, S_j: FormedSchurComplement, rows: Indices) -> Array:
    """Return the block of S_j on some of its rows, (b (b + 1) / 2,).

    Args:
        code: The C code.
        S_j: Schur complement of the subdomain.
        rows: Rows, in any order, (b,).

    Raises:
        ValueError: S_j does not have these rows.
    """
    n = S_j.matrix.n
    b = len(rows)
    _require_rows(rows, n)
    block = np.empty(b * (b + 1) // 2)
    code.lib.copy_block(
        n, pointer(code, S_j.matrix.values), b, pointer(code, rows), pointer(code, block)
    )
    return block


def add_block(code: Any, A: Single, block: SharedBlock) -> None:
    """Add a neighbour's block to the lower triangle of a matrix.

    Args:
        code: The C code.
        A: The matrix, (n, n) in Fortran's order.
        block: The block.

    Raises:
        ValueError: A does not have the rows of the block, or its entries do not fit them.
    """
    b = len(block.rows)
    _require_rows(block.rows, len(A))
    if len(block.entries) != b * (b + 1) // 2:
        raise ValueError(f"A block of {len(block.entries)} entries does not fit {b} rows.")
    code.lib.add_block(
        len(A),
        pointer(code, A, order="F"),
        b,
        pointer(code, block.rows),
        pointer(code, block.entries),
    )


def _require_rows(rows: Indices, n: int) -> None:
    """Raise a ValueError if a row is not in 0 … n − 1; the C code does not check."""
    if len(rows) and not (rows.min() >= 0 and rows.max() < n):
        raise ValueError(
            f"Rows {rows.min()} … {rows.max()} are not those of a matrix of order {n}."
        )
