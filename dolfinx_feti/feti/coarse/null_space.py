# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The null space of a coarse matrix N, if one is attached to A (``torn.null_space``).

.. math:: N Z_c = 0, \quad Z_c^⊤ e = 0, \quad (N + θ I_k)\, s = e \; ⟹ \; I_k s = 0, \; N s = e

with k columns Z_c, (N_c, k), which represent the null vectors of A. :math:`I_k` is the identity on
k coarse unknowns on which Z_c is regular, and zero on the others. Then :math:`N + θ I_k` is
regular, and s solves the original system. N is either coarse matrix; for A₀ the sizes are n_0 and
N_0 in place of n_c and N_c.
"""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import scipy.linalg
import scipy.sparse

from dolfinx_feti.feti.subdomain.block_diagonal import distributed_block_diagonal
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.runtime.lifetime import Lifetime

#: Largest ‖N z‖/(‖N‖‖z‖) of a coarse null vector z. It is larger than the tolerance of the null
#: vectors of A, because z and N contain the errors of the factors of the subdomains.
COARSE_NULL_RTOL = 1e-8


def is_null_space(N: PETSc.Mat, Z_c: Array) -> bool:
    """Return True if N Z_c = 0 up to rounding, or if Z_c has no columns. Collective.

    Args:
        N: Coarse matrix, (N_c, N_c).
        Z_c: Vectors, rows of this process, (n_c, k).
    """
    if not Z_c.shape[1]:
        return True
    scale = N.norm() or 1.0  # any number will do for N = 0
    is_null = True
    with Lifetime() as owned:
        z, force = map(owned.own, N.createVecs())
        for column in Z_c.T:
            z.array[:] = column
            N.mult(z, force)
            is_null = is_null and force.norm() <= COARSE_NULL_RTOL * scale * z.norm()
    return is_null


def make_regular(N: PETSc.Mat, Z_c: Array) -> None:
    """Add θ I_k to a coarse matrix, with N Z_c = 0, so that it is regular. Collective.

    Args:
        N: Coarse matrix, (N_c, N_c), changed in place.
        Z_c: Its null vectors, rows of this process, (n_c, k).
    """
    if not Z_c.shape[1]:
        return
    comm = N.comm.tompi4py()
    first = N.getOwnershipRange()[0]
    Z_all = np.vstack(comm.allgather(Z_c))
    pivots = on_all(lambda: scipy.linalg.qr(Z_all.T, mode="r", pivoting=True)[1], comm)
    chosen = pivots[: Z_c.shape[1]] - first
    θ = N.norm() or 1.0  # positive also for N = 0
    dofs = np.arange(len(Z_c))
    diagonal = np.where(np.isin(dofs, chosen), θ, 0.0)  # θ I_k on this process
    block = scipy.sparse.csr_array((diagonal, (dofs, dofs)), shape=(len(dofs), len(dofs)))
    added = distributed_block_diagonal(block, N.comm)
    N.axpy(1.0, added, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)  # N + θ I_k
    added.destroy()
