# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Which subdomains a coarse matrix couples, read off the pattern of one row of each."""

from __future__ import annotations

from typing import NamedTuple

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx_feti.feti.coarse.near import joined
from dolfinx_feti.runtime.collective import join

__all__ = ["CoupledSubdomains", "coupled_subdomains"]

Numbers = npt.NDArray[np.int64]


class CoupledSubdomains(NamedTuple):
    """The subdomains that are coupled with each one of this process, without itself.

    Attributes:
        starts: First row of each subdomain of all processes, and K, (subdomains + 1,).
        first: Number of the first subdomain of this process.
        indptr: Where those of each begin, and the end, (own subdomains + 1,).
        indices: Their numbers over all processes, ascending, (pairs,).
    """

    starts: Numbers
    first: int
    indptr: Numbers
    indices: Numbers


def coupled_subdomains(N: PETSc.Mat, counts: Numbers) -> CoupledSubdomains:
    """Find which subdomains N couples; all rows of one have the same columns. Collective.

    Args:
        N: Coarse matrix, (K, K).
        counts: Rows of each subdomain of this process.
    """
    comm = N.comm.tompi4py()
    first = N.getOwnershipRange()[0] + np.cumsum(counts) - counts
    starts = join(first, comm)  # of all subdomains; one without rows begins with the next one
    own = comm.scan(len(counts)) - len(counts)
    rows = first[counts > 0]
    columns = [N.getRow(row)[0] for row in rows.tolist()]
    subdomain = np.repeat(own + np.flatnonzero(counts), [len(row) for row in columns])
    near = np.searchsorted(starts, joined(columns, np.int64), side="right") - 1
    new = (np.diff(near, prepend=-1) != 0) | (np.diff(subdomain, prepend=-1) != 0)
    new &= near != subdomain
    lengths = np.bincount(subdomain[new] - own, minlength=len(counts))
    starts = np.append(starts, N.getSize()[0])
    return CoupledSubdomains(starts, own, np.cumsum(np.append(0, lengths)), near[new])
