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
from typing import NamedTuple

from mpi4py import MPI

import numpy as np

from dolfinx_feti.feti.gluing.copies import Copies
from dolfinx_feti.feti.subdomain.panels import Panels, load_panels
from dolfinx_feti.runtime.arrays import Array, Integers
from dolfinx_feti.runtime.collective import on_all

__all__ = ["Fields", "averaged_fields", "jump_fields"]


#: Gives the j-th column of each pair's subdomain in the pair's row, zero beyond the last, (pairs,).
Column = Callable[[int], Array]


@dataclass(frozen=True, slots=True)
class Fields:
    """The columns near each subdomain: a panel for each subdomain whose columns are there.

    Attributes:
        panels: For each subdomain the columns near it, by their owners, (n_i, c_i).
        owners: For each subdomain the numbers, over all processes, of the first column of each of
            its panels, ascending.
    """

    panels: list[Panels]
    owners: list[Integers]


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
    code = load_panels(copies.comm)
    ends = np.array([rows.stop for rows in copies.blocks], dtype=np.int64)
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
    first = np.append(starts, len(order))  # of the pairs of each panel, and then of its values
    start = np.append((end - pairs.columns)[starts], len(values))
    bounds = [int(b) for b in np.searchsorted(block[starts], np.arange(len(ends) + 1))]

    def panels(rows: slice, a: int, b: int) -> Panels:
        return Panels(
            code,
            rows.stop - rows.start,
            (first[a : b + 1] - first[a]).astype(np.int32),
            (pairs.row[first[a] : first[b]] - rows.start).astype(np.int32),
            pairs.columns[starts[a:b]].astype(np.int32),
            values[start[a] : start[b]],
        )

    of_blocks = list(zip(copies.blocks, bounds[:-1], bounds[1:], strict=True))
    made = on_all(lambda: [panels(*of_block) for of_block in of_blocks], copies.comm)
    return Fields(made, [pairs.first[starts[a:b]] for _, a, b in of_blocks])
