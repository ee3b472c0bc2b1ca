# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Columns of all subdomains on the interface of each: their averages, and their scaled jumps.

.. math:: W_i = (T V)_i, \quad V = T^⊤ δ\, U, \qquad \text{or} \qquad
          (B_D^⊤ B\, U)_i = U_i - (T V)_i

with columns U_i of each subdomain, (n_i, k_i). :math:`W_i` has a block of columns for the subdomain
and each neighbour (``panels``). On a dof with a prescribed value the jump is U itself.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from mpi4py import MPI

import numpy as np

from dolfinx_feti.feti.gluing.copies import Copies
from dolfinx_feti.feti.subdomain.panels import Panels, load_panels
from dolfinx_feti.runtime.arrays import Array, Indices, Integers
from dolfinx_feti.runtime.collective import on_all

__all__ = ["Fields", "averaged_fields", "jump_fields"]


#: Gives the j-th column of each pair's subdomain in the pair's row, zero beyond the last, (pairs,).
Column = Callable[[int], Array]


@dataclass(frozen=True, slots=True)
class Fields:
    """The columns near each subdomain: a panel for each subdomain whose columns are there.

    Attributes:
        code: Products of panels.
        sizes: Rows of each subdomain, (subdomains,).
        panels: Where the panels of each subdomain begin, and the end, (subdomains + 1,).
        owner: Number of the first column of each panel over all processes, ascending in each
            subdomain, (panels,).
        count: Number of its columns, (panels,).
        first: Where each panel begins among the rows, and the end, (panels + 1,).
        row: Rows of each panel in its subdomain, (pairs,).
        start: Where the values of each panel begin, and the end, (panels + 1,).
        values: Values of the columns, panel by panel, row by row.
    """

    code: Any
    sizes: Integers
    panels: Integers
    owner: Integers
    count: Indices
    first: Indices
    row: Indices
    start: Integers
    values: Array

    def __len__(self) -> int:
        """Return the number of subdomains."""
        return len(self.sizes)

    def __getitem__(self, i: int) -> Panels:
        """Return the columns near subdomain i, by their owners, (n_i, c_i)."""
        begin, end = self.panels[i], self.panels[i + 1]
        first, start = self.first[begin : end + 1], self.start[begin : end + 1]
        return Panels(
            self.code,
            int(self.sizes[i]),
            first - first[0],
            self.row[first[0] : first[-1]],
            self.count[begin:end],
            self.values[start[0] : start[-1]],
        )


class _Pairs(NamedTuple):
    """Pairs of a row and a subdomain with columns on it: number of the first one, and of all."""

    row: Integers
    first: Integers
    columns: Integers

    def some(self, chosen: Integers) -> _Pairs:
        """Return some of the pairs, by their numbers."""
        return _Pairs(*(part[chosen] for part in self))


def averaged_fields(copies: Copies, U: Sequence[Array]) -> Fields:
    """Return the averaged columns of all subdomains, T V. Collective.

    Args:
        copies: Copies of the interface dofs.
        U: For each subdomain its columns, (n_i, k_i), numbered on over subdomains and processes.
    """
    own, column = _own_pairs(copies, U)
    mean, average = _averaged_pairs(copies, own)
    return _by_panels(copies, mean, lambda j: average(column(j)))


def jump_fields(copies: Copies, U: Sequence[Array]) -> Fields:
    """Return the scaled jumps of the columns of all subdomains, B_Dᵀ B U = U − T V. Collective.

    The arguments are those of :func:`averaged_fields`.
    """
    own, column = _own_pairs(copies, U)
    mean, average = _averaged_pairs(copies, own)
    diagonal = mean.first == own.first[mean.row]
    alone = own.columns > 0
    alone[mean.row[diagonal]] = False  # rows with a prescribed value are left
    rest = own.some(np.flatnonzero(alone))
    pairs = _Pairs(*map(np.concatenate, zip(mean, rest, strict=True)))

    def jump(j: int) -> Array:
        u = column(j)
        return np.concatenate([np.where(diagonal, u[mean.row], 0.0) - average(u), u[rest.row]])

    return _by_panels(copies, pairs, jump)


def _own_pairs(copies: Copies, U: Sequence[Array]) -> tuple[_Pairs, Column]:
    """Pair all rows, ascending, with their own subdomain. Collective."""
    count = np.array([U_i.shape[1] for U_i in U], dtype=np.int64)
    first = copies.comm.scan(int(count.sum())) - count.sum() + np.cumsum(count) - count
    sizes = [rows.stop - rows.start for rows in copies.blocks]

    def column(j: int) -> Array:
        values = np.zeros(copies.n)
        for U_i, rows in zip(U, copies.blocks, strict=True):
            if j < U_i.shape[1]:
                values[rows] = U_i[:, j]
        return values

    pairs = _Pairs(np.arange(copies.n), np.repeat(first, sizes), np.repeat(count, sizes))
    return pairs, column


def _averaged_pairs(copies: Copies, own: _Pairs) -> tuple[_Pairs, Callable[[Array], Array]]:
    """Pair rows with all subdomains that share them; return u ↦ δ u, (n,) → (pairs,), too."""
    first, count = (
        copies.values(numbers.astype(np.float64)).astype(np.int64)
        for numbers in (own.first, own.columns)
    )
    some = count > 0

    def average(u: Array) -> Array:
        return np.asarray(copies.values(copies.delta * u)[some])

    return _Pairs(copies.row[some], first[some], count[some]), average


def _by_panels(copies: Copies, pairs: _Pairs, column: Column) -> Fields:
    """Sort pairs into the panels of each subdomain. Collective."""
    ends = np.array([rows.stop for rows in copies.blocks], dtype=np.int64)
    sizes = np.diff(ends, prepend=0)
    block = np.searchsorted(ends, pairs.row, side="right")
    order = np.argsort(block * (1 + pairs.first.max(initial=0)) + pairs.first, kind="stable")
    pairs, block = pairs.some(order), block[order]
    starts = np.flatnonzero(np.diff(block, prepend=-1) | np.diff(pairs.first, prepend=-1))
    end = np.cumsum(pairs.columns)
    values = on_all(lambda: np.empty(pairs.columns.sum()), copies.comm)  # or no memory for it
    most = copies.comm.allreduce(int(pairs.columns.max(initial=0)), op=MPI.MAX)
    for j in range(most):
        some = pairs.columns > j
        values[(end - pairs.columns)[some] + j] = column(j)[order][some]
    return Fields(
        code=load_panels(copies.comm),
        sizes=sizes,
        panels=np.searchsorted(block[starts], np.arange(len(ends) + 1)),
        owner=pairs.first[starts],
        count=pairs.columns[starts].astype(np.int32),
        first=np.append(starts, len(order)).astype(np.int32),
        row=(pairs.row - (ends - sizes)[block]).astype(np.int32),
        start=np.append((end - pairs.columns)[starts], len(values)),
        values=values,
    )
