# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The kernel of a subdomain: its rigid body modes, less those that Dirichlet dofs hold.

The local solutions of the paper (eq. 39, Augustin_eq:localSolutions) are

.. math:: u_i = K_i^†(f_i - B_i^⊤ λ) + R_i α_i, \qquad K_i R_i = 0.

All-floating subdomains keep all candidates (six rigid body modes in 3-D, three in 2-D, the
constant of a scalar problem). A classical subdomain keeps those that vanish on its Dirichlet dofs:
six, five, … or none, whether it touches the boundary in a vertex, an edge or in some components.

Under prestress the rotations leave the kernel: for a frame-indifferent energy
:math:`K(ω × x) = ω × f_{int}` with the deformed coordinates x. The modes then stay *candidates*
that the coarse problem carries, and the defect :math:`K R` is accounted for exactly (``coarse``).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy.linalg

__all__ = ["kernel_basis", "orthonormal"]

Array = npt.NDArray[np.float64]

#: A mode of size one counts as zero on the Dirichlet dofs below this.
TOLERANCE = 1e-8


def kernel_basis(modes: Array, fixed: npt.NDArray[np.bool_]) -> Array:
    """Combine the candidates that vanish on the fixed dofs.

    Args:
        modes: Candidates on the dofs of one subdomain, (n_i, n_modes).
        fixed: Dofs whose value is prescribed in the local matrix, (n_i,).

    Returns:
        Orthonormal basis R on the free dofs, (n_free, k) with 0 ≤ k ≤ n_modes.

    Note:
        With the thin SVD :math:`Z = U Σ V^⊤` of all candidates, the combinations U c with
        :math:`U_D c = 0` are read off the singular vectors of the fixed rows :math:`U_D`.
    """
    if modes.shape[0] == 0 or np.all(fixed):
        return np.zeros((np.count_nonzero(~fixed), 0))
    U, sigma, _ = scipy.linalg.svd(modes, full_matrices=False)
    U = U[:, sigma > TOLERANCE * sigma[0]]
    if np.any(fixed):
        _, sigma, Vt = scipy.linalg.svd(U[fixed], full_matrices=True)
        rank = np.count_nonzero(sigma > TOLERANCE)
        U = U @ Vt[rank:].T  # U_D c = 0
    return np.ascontiguousarray(U[~fixed])


def orthonormal(R: Array) -> Array:
    """Return an orthonormal basis of the columns of R, (n, k), without those that depend."""
    if R.size == 0:
        return R[:, :0]
    U, sigma, _ = scipy.linalg.svd(R, full_matrices=False)
    return np.ascontiguousarray(U[:, sigma > TOLERANCE * sigma[0]])
