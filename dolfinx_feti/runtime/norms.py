# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Products and norms of distributed vectors, given by the owned entries of each process."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np

from dolfinx_feti.runtime.arrays import Array


def dot(comm: MPI.Comm, a: Array, b: Array) -> float:
    """Return a·b of two vectors, (owned,); entries may be infinite or NaN. Collective."""
    with np.errstate(over="ignore", invalid="ignore"):
        return float(comm.allreduce(a @ b))


def norm(comm: MPI.Comm, r: Array) -> float:
    """Return ‖r‖ of a vector, (owned,). Collective."""
    return float(np.sqrt(dot(comm, r, r)))


def max_norm(comm: MPI.Comm, r: Array) -> float:
    """Return the largest absolute value of a vector, (owned,); zero without entries. Collective."""
    return float(comm.allreduce(float(np.abs(r).max(initial=0.0)), op=MPI.MAX))
