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

from collections.abc import Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np

from dolfinx_feti.feti.gluing.copies import Copies
from dolfinx_feti.feti.subdomain.panels import Panels, load_panels
from dolfinx_feti.runtime.arrays import Array, Integers
from dolfinx_feti.runtime.collective import on_all


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


def averaged_fields(copies: Copies, U: Sequence[Array]) -> Fields:
    """Return the averages T V of the columns U_i of all subdomains, (n_i, k_i). Collective."""
    return _fields(copies, U, jump=False)


def jump_fields(copies: Copies, U: Sequence[Array]) -> Fields:
    """Return the scaled jumps B_Dᵀ B U = U − T V of the columns of all subdomains. Collective."""
    return _fields(copies, U, jump=True)


def _fields(copies: Copies, U: Sequence[Array], *, jump: bool) -> Fields:
    """Pair rows with all subdomains that have columns there, sorted into panels. Collective.

    Columns are numbered on over subdomains and processes.
    """
    comm, code = copies.comm, load_panels(copies.comm)
    counts = np.array([U_i.shape[1] for U_i in U], dtype=np.int64)
    before = comm.scan(int(counts.sum())) - counts.sum() + np.cumsum(counts) - counts
    sizes = [rows.stop - rows.start for rows in copies.blocks]
    own = [np.repeat(numbers, sizes) for numbers in (before, counts)]  # first column, and number
    shared = [copies.values(part.astype(np.float64)).astype(np.int64) for part in own]
    is_own = shared[0] == own[0][copies.row]
    alone = np.setdiff1d(np.arange(copies.n if jump else 0), copies.row)  # with a prescribed value

    def column(j: int) -> Array:
        """Return the j-th column of each pair's subdomain in its row, zero beyond the last."""
        u = np.zeros(copies.n)
        for U_i, rows in zip(U, copies.blocks, strict=True):
            if j < U_i.shape[1]:
                u[rows] = U_i[:, j]
        mean = copies.values(copies.delta * u)
        return np.append(np.where(is_own, u[copies.row], 0.0) - mean, u[alone]) if jump else mean

    row = np.append(copies.row, alone)
    first, count = (np.append(a, b[alone]) for a, b in zip(shared, own, strict=True))
    block = np.searchsorted([rows.stop for rows in copies.blocks], row, side="right")
    order = np.argsort(block * (1 + first.max(initial=0)) + first, kind="stable")
    order = order[count[order] > 0]
    row, first, count, block = row[order], first[order], count[order], block[order]
    starts = np.flatnonzero(np.diff(block, prepend=-1) | np.diff(first, prepend=-1))
    end = np.cumsum(count)
    values = on_all(lambda: np.empty(count.sum()), comm)  # or no memory for it
    for j in range(comm.allreduce(int(count.max(initial=0)), op=MPI.MAX)):
        some = count > j
        values[(end - count)[some] + j] = column(j)[order][some]
    ends = np.append(starts, len(order))  # of the rows of the panels, and then of their values
    places = np.append((end - count)[starts], len(values))
    bounds = [int(b) for b in np.searchsorted(block[starts], np.arange(len(sizes) + 1))]

    def panels(rows: slice, a: int, b: int) -> Panels:
        return Panels(
            code,
            rows.stop - rows.start,
            (ends[a : b + 1] - ends[a]).astype(np.int32),
            (row[ends[a] : ends[b]] - rows.start).astype(np.int32),
            count[starts[a:b]].astype(np.int32),
            values[places[a] : places[b]],
        )

    of_blocks = list(zip(copies.blocks, bounds[:-1], bounds[1:], strict=True))
    made = on_all(lambda: [panels(*of_block) for of_block in of_blocks], comm)
    return Fields(made, [first[starts[a:b]] for _, a, b in of_blocks])
