# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The modes R of the subdomains, the regularised kernels E and the defects D, for one matrix.

``pseudoinverse`` finds them (eq. 39, Augustin_eq:localSolutions), and the coarse problem and the
preconditioner are made from them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_feti.feti.subdomain.orthonormal import null_combinations, orthonormal
from dolfinx_feti.runtime.arrays import Array, Mask

#: A mode of size one that is smaller than this on Dirichlet dofs vanishes there: the square root of
#: rounding.
UNSUPPORTED = 1e-8


@dataclass(frozen=True, slots=True)
class SubdomainModes:
    """The modes of one subdomain for one matrix, on the dofs of its matrix.

    Attributes:
        R: Orthonormal modes, (n_i, k).
        E: The kernel, regularised, (n_i, k).
        D: Defect of the kernel, (k, k); zero while K R = 0.
        stabilisation: Columns Z of K₊ = K + Z Zᵀ, (n_i, negative eigenvalues of D).
        exact: Whether K R = 0 holds.
        softened: Whether stress softens the rigid motions by a noticeable share of the stiffness.
        rho: The stiffness ρ.
        kernel: Number of modes that are not elastic, the first ones of R: rigid ones, null vectors.
        null: Number of null vectors that are not rigid.
        soft: Number of soft modes, the last ones.
    """

    R: Array
    E: Array
    D: Array
    stabilisation: Array
    exact: bool
    softened: bool
    rho: float
    kernel: int
    null: int
    soft: int

    @property
    def Y(self) -> Array:
        """The soft modes, (n_i, soft)."""
        return self.R[:, self.R.shape[1] - self.soft :]

    @property
    def E_Y(self) -> Array:
        """E of the soft modes, (n_i, soft)."""
        return self.E[:, self.E.shape[1] - self.soft :]


def kernel_basis(modes: Array, fixed: Mask) -> Array:
    """Combine candidates, (n_i, n_modes), that vanish on fixed dofs, orthonormal: (n_free, k)."""
    if np.all(fixed):
        return np.zeros((0, 0))
    U = orthonormal(modes)
    U = U @ null_combinations(U[fixed], UNSUPPORTED)  # U_D c = 0
    return np.ascontiguousarray(U[~fixed])
