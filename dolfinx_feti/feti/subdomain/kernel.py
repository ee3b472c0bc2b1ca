# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The kernel of a subdomain: its rigid body modes that vanish on its Dirichlet dofs.

.. math:: u_i = K_i^†(f_i - B_i^⊤ λ) + R_i α_i, \qquad K_i R_i = 0

(eq. 39, Augustin_eq:localSolutions). All-floating subdomains keep all candidates.
"""

from __future__ import annotations

import numpy as np

from dolfinx_feti.feti.subdomain.orthonormal import null_combinations, orthonormal
from dolfinx_feti.runtime.arrays import Array, Mask

__all__ = ["UNSUPPORTED", "kernel_basis"]


#: A mode of size one that is smaller than this on Dirichlet dofs vanishes there: the square root of
#: rounding.
UNSUPPORTED = 1e-8


def kernel_basis(modes: Array, fixed: Mask) -> Array:
    """Combine candidates, (n_i, n_modes), that vanish on fixed dofs, orthonormal: (n_free, k)."""
    if np.all(fixed):
        return np.zeros((0, 0))
    U = orthonormal(modes)
    U = U @ null_combinations(U[fixed], UNSUPPORTED)  # U_D c = 0
    return np.ascontiguousarray(U[~fixed])
