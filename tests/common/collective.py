# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What tests on several processes need: asserts that fail on all, whole matrices, what is left."""

from __future__ import annotations

import ctypes
import os
import re
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

COMM = MPI.COMM_WORLD


def agree(ok: object, what: object = "") -> None:
    """Assert on all processes that ``ok`` holds on each: no process goes on alone."""
    said = COMM.allgather(None if ok else str(what))
    wrong = {rank: text for rank, text in enumerate(said) if text is not None}
    assert not wrong, wrong


def small(error: float, tolerance: float) -> None:
    """Assert on all processes that an error is below a tolerance on each; NaN is not."""
    agree(abs(error) <= tolerance, f"{error} > {tolerance}")


def equal(actual: npt.ArrayLike, expected: npt.ArrayLike, tolerance: float = 0.0) -> None:
    """Assert on all processes that arrays agree to a tolerance relative to the largest entry."""
    actual, expected = np.asarray(actual, dtype=float), np.asarray(expected, dtype=float)
    agree(actual.shape == expected.shape, f"shapes {actual.shape} and {expected.shape}")
    scale = np.abs(expected).max(initial=0.0) if tolerance else 1.0
    error = np.abs(actual - expected).max(initial=0.0)
    agree(error <= tolerance * max(scale, 1e-300), f"{error} with a scale of {scale}")


def uniform(values: npt.ArrayLike, value: float, tolerance: float) -> None:
    """Assert on all processes that all entries have one value, to an absolute tolerance."""
    error = np.abs(np.asarray(values) - value).max(initial=0.0)
    agree(error <= tolerance, f"{error} > {tolerance}")


@contextmanager
def raises(kind: type[Exception], match: str) -> Iterator[None]:
    """Assert that every process raises this error with a message that fits."""
    caught: Exception | None = None
    try:
        yield
    except Exception as error:  # another kind is reported, and not on one process alone
        caught = error
    agree(
        isinstance(caught, kind) and re.search(match, str(caught)),
        f"{caught!r} instead of {kind.__name__} with '{match}'",
    )


def random_part(n: int, columns: int | None = None, *, seed: int = 1993) -> Array:
    """Return own rows, (n,) or (n, columns), of what is the same on any number of processes."""
    shape = (COMM.allreduce(n),) if columns is None else (COMM.allreduce(n), columns)
    last = COMM.scan(n)
    return np.random.default_rng(seed).standard_normal(shape)[last - n : last]


def norm(local: Array) -> float:
    """Norm of a vector of which each process has a part."""
    return float(np.sqrt(COMM.allreduce(float(local.ravel() @ local.ravel()))))


def whole(local: npt.NDArray[np.generic]) -> npt.NDArray[np.generic]:
    """Join the parts of all processes, on all of them."""
    return np.concatenate(COMM.allgather(local))


def lu_solve(A: PETSc.Mat, b: PETSc.Vec) -> Array:
    """Solve A x = b with MUMPS and one step of refinement; return the owned values."""
    ksp = PETSc.KSP().create(A.comm)
    ksp.setOperators(A)
    ksp.setType(PETSc.KSP.Type.PREONLY)
    ksp.getPC().setType(PETSc.PC.Type.LU)
    ksp.getPC().setFactorSolverType(PETSc.Mat.SolverType.MUMPS)
    x, dx, r = A.createVecRight(), A.createVecRight(), b.copy()
    for _ in range(2):
        ksp.solve(r, dx)
        x.axpy(1.0, dx)
        A.mult(x, r)
        r.aypx(-1.0, b)
    values = x.array_r.copy()
    for owned in (ksp, x, dx, r):
        owned.destroy()
    return values


def dense(M: PETSc.Mat) -> Array:
    """Bring a distributed matrix to all processes."""
    indptr, indices, values = M.getValuesCSR()
    rows = np.zeros((len(indptr) - 1, M.getSize()[1]))
    np.add.at(rows, (np.repeat(np.arange(len(rows)), np.diff(indptr)), indices), values)
    return whole(rows)


def matrix_of_map(apply: Callable[[Array], Array], n: int) -> Array:
    """Bring the matrix of a map of local parts to all processes; n is the size of this one's."""
    last = COMM.scan(n)
    mine = np.arange(last - n, last)
    columns = [apply((mine == j).astype(np.float64)) for j in range(COMM.allreduce(n))]
    return whole(np.column_stack(columns))


def garbage(comm: MPI.Comm) -> str:
    """Return PETSc's own list of objects that processes have to end together; empty without any."""
    sys.stdout.flush()
    with tempfile.TemporaryFile() as file:
        screen = os.dup(1)
        os.dup2(file.fileno(), 1)
        try:
            PETSc.garbage_view(comm)
            PETSc.Sys.syncFlush(comm)
            ctypes.CDLL(None).fflush(None)
        finally:
            os.dup2(screen, 1)
            os.close(screen)
        file.seek(0)
        text = file.read().decode()
    text = comm.bcast(text)
    entries = sum(map(int, re.findall(r"Total entries: (\d+)", text)))
    return text if entries else ""
