# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Star forests (PetscSF): roots on their owners, leaves that refer to roots of any process.

For a torn matrix the roots are the owned dofs of the assembled problem, the leaves their copies.
Floating-point numbers travel as MPI_DOUBLE, integers as MPI_INT64_T.
"""

from __future__ import annotations

from typing import TypeVar

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx_feti.runtime.arrays import Integers

Value = TypeVar("Value", np.float64, np.int64)


def create_star_forest(root_of_leaf: Integers, n_roots: int, comm: MPI.Comm) -> PETSc.SF:
    """Create a star forest. Collective.

    Args:
        root_of_leaf: Number of the root of each leaf of this process, over all processes,
            (n_leaves,).
        n_roots: Number of roots of this process. Roots are numbered process by process.
        comm: The processes.

    Returns:
        The star forest; the caller destroys it.
    """
    first_root = np.concatenate(([0], np.cumsum(comm.allgather(n_roots))))  # of each process
    rank = np.searchsorted(first_root, root_of_leaf, side="right") - 1
    remote = np.column_stack([rank, root_of_leaf - first_root[rank]]).astype(PETSc.IntType)
    forest = PETSc.SF().create(comm)
    forest.setGraph(n_roots, None, remote)
    return forest


def broadcast(
    forest: PETSc.SF, root_values: npt.NDArray[Value], n_leaves: int
) -> npt.NDArray[Value]:
    """Copy the values of the roots to their leaves. Collective.

    Args:
        forest: The star forest.
        root_values: Values of the roots of this process, (n_roots,).
        n_leaves: Number of leaves of this process.

    Returns:
        The value of each leaf's root, (n_leaves,).
    """
    values = _as_sent(root_values)
    result = np.zeros(n_leaves, dtype=values.dtype)
    mpi_type = _mpi_type(values.dtype)
    forest.bcastBegin(mpi_type, values, result, MPI.REPLACE)
    forest.bcastEnd(mpi_type, values, result, MPI.REPLACE)
    return result


def sum_leaves(
    forest: PETSc.SF, leaf_values: npt.NDArray[Value], n_roots: int
) -> npt.NDArray[Value]:
    """Sum the values of the leaves at their roots. Collective.

    Args:
        forest: The star forest.
        leaf_values: Values of the leaves of this process, (n_leaves,).
        n_roots: Number of roots of this process.

    Returns:
        The sum of each root, (n_roots,).
    """
    values = _as_sent(leaf_values)
    result = np.zeros(n_roots, dtype=values.dtype)
    mpi_type = _mpi_type(values.dtype)
    forest.reduceBegin(mpi_type, values, result, MPI.SUM)
    forest.reduceEnd(mpi_type, values, result, MPI.SUM)
    return result


def gather_leaves(
    forest: PETSc.SF, leaf_values: npt.NDArray[Value], degrees: Integers
) -> npt.NDArray[Value]:
    """Gather the values of the leaves at their roots, root after root. Collective.

    Args:
        forest: The star forest.
        leaf_values: Values of the leaves of this process, (n_leaves,).
        degrees: Number of leaves of each root of this process, (n_roots,).

    Returns:
        The values, (sum of the degrees,).
    """
    values = _as_sent(leaf_values)
    result = np.zeros(int(degrees.sum()), dtype=values.dtype)
    mpi_type = _mpi_type(values.dtype)
    forest.gatherBegin(mpi_type, values, result)
    forest.gatherEnd(mpi_type, values, result)
    return result


def _as_sent(values: npt.NDArray[Value]) -> npt.NDArray[Value]:
    """Return a contiguous array: Booleans and integers as int64, other numbers as float64."""
    dtype = np.int64 if values.dtype.kind in "biu" else np.float64
    return np.ascontiguousarray(values, dtype=dtype)


def _mpi_type(dtype: np.dtype[np.generic]) -> MPI.Datatype:
    """Return the MPI type of float64 or int64."""
    return MPI.INT64_T if dtype == np.int64 else MPI.DOUBLE
