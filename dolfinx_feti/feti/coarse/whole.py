# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""A factor of the whole coarse matrix N, (K, K), on one process of a group: Cholesky's, by fronts.

.. math:: N = U^⊤ U

(``multifrontal``, docs/theory.md), with a node for all columns of a subdomain. It proves N to be
definite; where it fails, or meets a pivot near zero, there is none.
"""

from __future__ import annotations

from contextlib import suppress

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.errors import FactorError
from dolfinx_feti.feti.coarse.group import copy_of_rows
from dolfinx_feti.feti.coarse.near import joined
from dolfinx_feti.feti.subdomain.factors.multifrontal import FrontFactor, Fronts, load_fronts_for
from dolfinx_feti.runtime.arrays import Indices, Numbers
from dolfinx_feti.runtime.collective import join, on_all
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.runtime.petsc_library import rows_of
from dolfinx_feti.torn.rounding import EPS

__all__ = ["whole_factor"]


#: Most entries of a factor that a process has for its group: 512 MiB.
MOST = 2**26


def whole_factor(
    N: PETSc.Mat, counts: Numbers, group: MPI.Comm, *, prefix: str, zero: float | None
) -> FrontFactor | None:
    """Factor a symmetric N on the first process of each group; see ``GatheredSolver``. Collective.

    Returns:
        The factor, without entries where another process has them; None if N is not positive
        definite, or too large, or the options name a solver.

    Raises:
        MemoryError: There is not enough memory; on all processes.
    """
    comm, total = N.comm.tompi4py(), N.getSize()[0]
    code = load_fronts_for(prefix, comm)
    if code is None or PETSc.Options(prefix).hasName("ksp_type") or not total:
        return None
    size, ptr, adjacent = _nodes(N, counts)
    rows = np.arange(total, dtype=np.int32)
    graph, none = (ptr, adjacent), np.zeros(len(size), dtype=bool)
    fronts = on_all(lambda: Fronts(code, rows, rows, size, graph, none), comm)
    if fronts.entries > MOST:
        return None
    least = (EPS * total if zero is None else zero) * N.norm(PETSc.NormType.INFINITY)
    first = group.rank == 0

    def factor() -> FrontFactor | None:
        if not first:
            return FrontFactor(fronts, np.zeros(0))
        with suppress(FactorError), rows_of(matrix) as of_N:
            factored = fronts.factor(of_N, np.empty(fronts.work))
            if factored is not None and factored[0].least_pivot() > least:
                return factored[0]
        return None

    with Lifetime() as owned:
        matrix = owned.own(copy_of_rows(N, slice(0, total if first else 0)))
        factored = on_all(factor, comm)
    return factored if comm.allreduce(factored is not None, op=MPI.LAND) else None


def _nodes(N: PETSc.Mat, counts: Numbers) -> tuple[Indices, Indices, Indices]:
    """Return the sizes of all subdomains that have rows, and the graph of those. Collective.

    All rows of a subdomain have the same columns, so that one of them tells its neighbours.
    """
    comm, some = N.comm.tompi4py(), counts > 0
    first = (N.getOwnershipRange()[0] + np.cumsum(counts) - counts)[some]
    starts = join(first, comm)
    near = [np.unique(np.searchsorted(starts, N.getRow(row)[0], side="right") - 1) for row in first]
    own = [there[starts[there] != row] for there, row in zip(near, first, strict=True)]
    ptr = np.cumsum(np.append(0, join([len(there) for there in own], comm)))
    arrays = join(counts[some], comm), ptr, join(joined(own, np.int64), comm)
    size, ptr, adjacent = (array.astype(np.int32) for array in arrays)
    return size, ptr, adjacent
