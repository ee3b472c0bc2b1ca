# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Tests of a coarse matrix N or A₀: growth, accuracy of its solver, null vectors.

.. math:: \hat N = d^{-1/2} N\, d^{-1/2}, \qquad
          g = \frac{\|\hat N^{-1} \hat b\|}{\|\hat b\|}, \qquad
          e = \frac{\|b - N x\|}{\|N\|_F\, \|x\| + \|b\|}, \quad b = d^{1/2}\, \hat b

with the diagonal d of N and a random b̂. If N is nearly singular, the growth g is large; if its
solver is inaccurate, the backward error e is. Null vectors are computed by inverse iteration with a
small shift. Random vectors are the same in each run. N is either coarse matrix, (N_c, N_c).
"""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.feti.coarse.solver import CoarseSolver
from dolfinx_feti.feti.regularity.tsqr import orthonormal_columns
from dolfinx_feti.feti.subsolver_options import DirectOptions
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.lifetime import Lifetime

#: Share of the diagonal that is added to N for inverse iteration, because a singular N has no
#: factor. A choice: it has to be above the rounding errors of pivots, and below the eigenvalues of
#: the scaled N that belong to other vectors than null vectors. Half of it changes no test.
SHIFT = 1e-12

#: Rounds of inverse iteration. Each multiplies the component along an eigenvector of the scaled N
#: by SHIFT over its eigenvalue: four rounds reduce the component of an eigenvalue of 1e-10 to 1e-8,
#: two rounds to 1e-4. Half of it changes no test.
ROUNDS = 4


def growth_and_backward_error(N: PETSc.Mat, solver: CoarseSolver) -> tuple[float, float]:
    """Measure the growth g and the backward error e by one solve with N. Collective.

    Args:
        N: The coarse matrix, (N_c, N_c).
        solver: Its solver.

    Returns:
        g, infinite if there is a zero pivot, and e.
    """
    if N.getSize()[0] == 0:
        return 1.0, 0.0
    with Lifetime() as owned:
        b, x = (owned.own(vector) for vector in N.createVecs())
        r = owned.own(b.duplicate())
        root = np.sqrt(_diagonal(N))  # d^½
        b_hat = _random_columns(N, 1)[:, 0]
        b.array[:] = root * b_hat
        solver.solve(b, x)
        N.mult(x, r)
        r.axpy(-1.0, b)
        error = r.norm() / (N.norm() * x.norm() + b.norm())
        if solver.inertia().zero_pivots:
            return np.inf, error
        x.array[:] *= root  # N̂⁻¹ b̂ = d^½ x
        b.array[:] = b_hat
        growth = x.norm() / b.norm()
        return growth, error


def backward_error_in_range(A_0: PETSc.Mat, solver: CoarseSolver) -> float:
    """Return the backward error of a solve for b = A₀ x with a random x. Collective.

    Such a b is in the range of A₀, so that a solution exists even if A₀ is singular.

    Args:
        A_0: The Galerkin matrix, (N_0, N_0).
        solver: Its solver.
    """
    with Lifetime() as owned:
        x, b = (owned.own(vector) for vector in A_0.createVecs())
        r = owned.own(b.duplicate())
        solution = owned.own(x.duplicate())
        x.array[:] = _random_columns(A_0, 1)[:, 0]
        A_0.mult(x, b)
        solver.solve(b, solution)
        A_0.mult(solution, r)
        r.axpy(-1.0, b)
        return float(r.norm() / (A_0.norm() * solution.norm() + b.norm()))


def null_vectors(N: PETSc.Mat, count: int, *, options: DirectOptions) -> Array:
    """Compute approximate null vectors of N by inverse iteration. Collective.

    Args:
        N: The coarse matrix, (N_c, N_c).
        count: Number of vectors to iterate with. If the kernel of N has a smaller dimension, the
            result has further vectors, which the caller has to detect.
        options: Options of the coarse solver.

    Returns:
        Rows of this process, (n_c, ≤ count); the vectors are orthonormal after scaling by d^½. No
        columns if the solver fails: then there are no candidates for motions, and the caller
        reports the solver's backward error.
    """
    comm = N.comm.tompi4py()
    d = _diagonal(N)
    root = np.sqrt(d)
    with Lifetime() as owned:
        shifted = owned.own(N.copy())
        b, x = (owned.own(vector) for vector in N.createVecs())
        b.array[:] = SHIFT * d
        shifted.setDiagonal(b, addv=PETSc.InsertMode.ADD_VALUES)
        solver = owned.own(CoarseSolver(shifted, options=options, is_symmetric=True))
        X = _random_columns(N, min(count, N.getSize()[0]))
        for _ in range(ROUNDS):
            Y = np.empty_like(X)
            for j in range(X.shape[1]):
                b.array[:] = root * X[:, j]
                solver.solve(b, x)
                Y[:, j] = root * x.array_r
            if not comm.allreduce(bool(np.isfinite(Y).all()), op=MPI.LAND):
                return X[:, :0]
            X = orthonormal_columns(Y, comm)
    return X / root[:, None]


def _diagonal(N: PETSc.Mat) -> Array:
    """Return the absolute values of the diagonal, (n_c,), with ones in place of zeros."""
    diagonal = N.getDiagonal()
    d = np.abs(diagonal.array_r)
    diagonal.destroy()
    return np.where(d > 0.0, d, 1.0)


def _random_columns(N: PETSc.Mat, count: int) -> Array:
    """Return the rows of this process of random columns, (n_c, count), the same in each run.

    The seed is its first row, so that processes have different numbers.
    """
    first, last = N.getOwnershipRange()
    return np.random.default_rng(first).standard_normal((last - first, count))
