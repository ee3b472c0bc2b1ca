# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Columns of all subdomains on the interface of each: their averages, and their scaled jumps.

With the copies of its dofs averaged, a column of a subdomain reaches into its neighbours, and no
further. So each subdomain sees

.. math:: W_i = (T V)_i, \quad V = T^⊤ δ\, U, \qquad \text{or} \qquad
          (B_D^⊤ B\, U)_i = U_i - (T V)_i

as a block of its own columns and those of its neighbours, one panel each (``panels``). The first is
the coarse space of the primal form (``averaged``), the second what the preconditioner of the dual
form sees of G (``weighted``): on a dof with a prescribed value, where no copies are averaged, it is
U itself.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx_feti.feti.copies import Copies
from dolfinx_feti.feti.panels import Panels

__all__ = ["Fields", "averaged_fields", "jump_fields"]

Array = npt.NDArray[np.float64]
Numbers = npt.NDArray[np.int64]


class Fields:
    """What each subdomain sees of the columns, formed when it is asked for: together it is large.

    Attributes:
        numbers: Numbers of the columns of each subdomain over all processes, ascending, (c_i,).
    """

    def __init__(self, copies: Copies, pairs: _Pairs) -> None:
        """Sort out whose columns there are.

        Args:
            copies: Copies of the interface dofs.
            pairs: What there is on their rows.
        """
        self._rows = copies.blocks
        self._pairs = pairs
        self.numbers: list[Numbers] = []
        self._panels: list[list[Numbers]] = []  # the pairs of each owner, for each subdomain
        ends = np.searchsorted(pairs.row, [rows.start for rows in self._rows] + [copies.n])
        for start, stop in itertools.pairwise(ends):
            owners, at, group = np.unique(
                pairs.first[start:stop], return_index=True, return_inverse=True
            )
            width = pairs.count[start:stop][at]
            before = np.cumsum(width) - width
            self.numbers.append(np.arange(width.sum()) + np.repeat(owners - before, width))
            order = np.argsort(group, kind="stable") + start
            self._panels.append(np.split(order, np.cumsum(np.bincount(group))[:-1]))

    def __len__(self) -> int:
        """Return the number of subdomains."""
        return len(self.numbers)

    def memory(self) -> float:
        """Return the memory of what there is on the rows in MiB."""
        return self._pairs.values.nbytes / 2**20

    def __getitem__(self, i: int) -> Panels:
        """Return the columns of subdomain i, a panel for each owner, (n_i, c_i)."""
        rows, pairs = self._rows[i], self._pairs
        if len(self.numbers[i]) == 0:
            return Panels(rows.stop - rows.start, [], [])
        return Panels(
            rows.stop - rows.start,
            [pairs.row[panel] - rows.start for panel in self._panels[i]],
            [pairs.values[panel, : pairs.count[panel[0]]].T.copy() for panel in self._panels[i]],
        )


def averaged_fields(copies: Copies, U: Sequence[Array]) -> Fields:
    """Return the averaged columns of all subdomains, T V, subdomain by subdomain.

    Args:
        copies: Copies of the interface dofs.
        U: For each subdomain its columns, (n_i, k_i), numbered on over subdomains and processes.

    Note:
        Collective.
    """
    return Fields(copies, _averages(copies, U))


def jump_fields(copies: Copies, U: Sequence[Array]) -> Fields:
    """Return the scaled jumps of the columns of all subdomains, B_Dᵀ B U = U − T V.

    The arguments are those of :func:`averaged_fields`.

    Note:
        Collective.
    """
    averages, own = _averages(copies, U), _own(copies, U)
    values, at = -averages.values, averages.row
    itself = averages.first == own.first[at]
    values[itself] += own.values[at[itself]]
    rest = own.count > 0  # rows with a prescribed value
    rest[at[itself]] = False
    row = np.concatenate([at, np.flatnonzero(rest)])
    order = np.argsort(row, kind="stable")
    pairs = _Pairs(
        row[order],
        np.concatenate([averages.first, own.first[rest]])[order],
        np.concatenate([averages.count, own.count[rest]])[order],
        np.concatenate([values, own.values[rest]])[order],
    )
    return Fields(copies, pairs)


@dataclass(frozen=True, slots=True)
class _Pairs:
    """What columns of single subdomains, of those that have any, have on single rows.

    Attributes:
        row: Row of the interface, ascending, (pairs,).
        first: First column of the subdomain, (pairs,).
        count: Its number of columns, (pairs,).
        values: Their values, in the first ``count`` entries, (pairs, most).
    """

    row: npt.NDArray[np.integer]
    first: Numbers
    count: Numbers
    values: Array


def _own(copies: Copies, U: Sequence[Array]) -> _Pairs:
    """Return the columns of each subdomain on its own rows."""
    count = np.array([U_i.shape[1] for U_i in U], dtype=np.int64)
    first = copies.comm.scan(int(count.sum())) - count.sum() + np.cumsum(count) - count
    sizes = [rows.stop - rows.start for rows in copies.blocks]
    most = copies.comm.allreduce(int(count.max(initial=0)), op=MPI.MAX)
    values = np.zeros((copies.n, most))
    for U_i, rows in zip(U, copies.blocks, strict=True):
        values[rows, : U_i.shape[1]] = U_i
    return _Pairs(np.arange(copies.n), np.repeat(first, sizes), np.repeat(count, sizes), values)


def _averages(copies: Copies, U: Sequence[Array]) -> _Pairs:
    """Return δ U at each copy of each row. Collective."""
    own = _own(copies, U)
    first, count = (copies.values(of.astype(np.float64)) for of in (own.first, own.count))
    some = count > 0
    values = np.empty((np.count_nonzero(some), own.values.shape[1]))
    for j in range(values.shape[1]):
        values[:, j] = copies.values(copies.delta * own.values[:, j])[some]
    return _Pairs(
        copies.row[some], first[some].astype(np.int64), count[some].astype(np.int64), values
    )
