# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The null space of a coarse matrix N, if one is attached to A (``torn.null_space``).

.. math:: N Z_c = 0, \quad Z_c^⊤ e = 0, \quad (N + θ I_k)\, s = e \; ⟹ \; I_k s = 0, \; N s = e

with k columns Z_c, which represent the null vectors of A. :math:`I_k` is the identity on k coarse
unknowns on which Z_c is regular, and zero on the others: :math:`N + θ I_k` is regular, and s solves
the original system.
"""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import scipy.linalg

from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.runtime.lifetime import Lifetime

#: Largest ‖N z‖/(‖N‖‖z‖) of a coarse null vector z. It is larger than the tolerance of the null
#: vectors of A, because z and N contain the errors of the factors of the subdomains.
COARSE_NULL_RTOL = 1e-8


def fix_null_space(N: PETSc.Mat, Z_c: Array) -> bool:
    """Add θ I_k to a coarse matrix if N Z_c = 0, so that it is regular. Collective.

    Args:
        N: Coarse matrix, (N_c, N_c), changed in place if the result is True.
        Z_c: Vectors that should be null vectors, rows of this process, (n_c, k).

    Returns:
        Whether N Z_c = 0; always without columns.
    """
    if not Z_c.shape[1]:
        return True
    if not _annihilates(N, Z_c):
        return False
    comm = N.comm.tompi4py()
    first = N.getOwnershipRange()[0]
    Z_all = np.vstack(comm.allgather(Z_c))
    pivots = on_all(lambda: scipy.linalg.qr(Z_all.T, mode="r", pivoting=True)[1], comm)
    chosen = pivots[: Z_c.shape[1]] - first
    θ = N.norm() or 1.0
    diagonal = np.where(np.isin(np.arange(len(Z_c)), chosen), θ, 0.0)
    rows = np.arange(len(Z_c) + 1, dtype=PETSc.IntType)
    csr = (rows, first + rows[:-1], diagonal)
    added = PETSc.Mat().createAIJ(N.getSizes(), csr=csr, comm=N.comm)
    N.axpy(1.0, added, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)  # N + θ I_k
    added.destroy()
    return True


def _annihilates(N: PETSc.Mat, Z_c: Array) -> bool:
    """Return True if N Z_c = 0 up to rounding, for Z_c, (n_c, k). Collective."""
    scale = N.norm() or 1.0
    is_null = True
    with Lifetime() as owned:
        z, force = map(owned.own, N.createVecs())
        for column in Z_c.T:
            z.array[:] = column
            N.mult(z, force)
            is_null = is_null and force.norm() <= COARSE_NULL_RTOL * scale * z.norm()
    return is_null
