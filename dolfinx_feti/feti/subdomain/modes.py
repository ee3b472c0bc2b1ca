# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The modes of one subdomain for one matrix: R and Y, the displacements E, and the defect D.

.. math:: K_ρ = K + ρ\, R R^⊤, \quad K^+ = (K_ρ + ρ\, Y Y^⊤)^{-1}, \quad
          E = ρ\, K^+ (R, Y), \quad D = ρ\, (I - (R, Y)^⊤ E)

(eq. 39 of the paper: E = R and D = 0 if K R = 0 and there is no Y). R consists of rigid modes, null
vectors and buckling modes, which are part of the factored :math:`K_ρ`. Y consists of soft modes,
which are not. The columns of E span the coarse displacements of the dual form; restricted to the
interface, they are columns of the primal one. ``mode_search`` computes all of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_feti.feti.subdomain.kernel_detection import MAX_NORM_ON_FIXED_DOFS
from dolfinx_feti.feti.subdomain.orthonormal import null_combinations, orthonormal
from dolfinx_feti.runtime.arrays import Array, Mask


@dataclass(frozen=True, slots=True)
class SubdomainModes:
    """The modes of one subdomain for one matrix K_i, (n_i, n_i), or S_i, with n_{Γ,i} for n_i.

    Attributes:
        R: Modes of K_ρ, (n_i, k): rigid modes, then null vectors, then buckling modes. They are
            orthonormal; in a scaled matrix (``scaled``) s times orthonormal.
        Y: Soft modes, (n_i, k_Y), orthogonal to R in the same sense.
        E: ρ K⁺ (R, Y), (n_i, k + k_Y). It replaces the kernel. If K R = 0, its first k columns
            span the kernel.
        D: Its defect, (k + k_Y, k + k_Y); zero if K R = 0 and there are no soft modes.
        stabilisation: Columns Z of K₊ = K + Z Zᵀ, (n_i, negative eigenvalues of D).
        is_exact: Whether K R = 0, and there are no soft modes. Then D = 0, and E = R (in a scaled
            matrix, E = s⁻² R).
        is_softened: Whether stress softens the subdomain: D has a negative eigenvalue that is not
            small compared with the stiffness of the interface (``mode_search.MIN_SOFTENING``).
        rho: The stiffness ρ.
        n_rigid: Number of rigid modes.
        n_null: Number of null vectors that are not rigid.
    """

    R: Array
    Y: Array
    E: Array
    D: Array
    stabilisation: Array
    is_exact: bool
    is_softened: bool
    rho: float
    n_rigid: int
    n_null: int

    @property
    def n_soft(self) -> int:
        """Number of soft modes."""
        return self.Y.shape[1]

    @property
    def n_buckling(self) -> int:
        """Number of buckling modes."""
        return self.R.shape[1] - self.n_rigid - self.n_null

    @property
    def E_Y(self) -> Array:
        """E of the soft modes, its last columns, (n_i, k_Y)."""
        return self.E[:, self.E.shape[1] - self.n_soft :]


def rigid_modes(near_kernel: Array, is_fixed: Mask) -> Array:
    """Return the combinations of the near kernel that vanish on the fixed dofs.

    Args:
        near_kernel: The near kernel on all dofs of a subdomain, (n_all, r).
        is_fixed: Mask of the fixed ones among them, (n_all,).

    Returns:
        Orthonormal rigid modes on the free dofs, (n_i, k). K R = 0 need not hold.
    """
    if np.all(is_fixed):
        return np.zeros((0, 0))
    U = orthonormal(near_kernel)
    U = U @ null_combinations(U[is_fixed], MAX_NORM_ON_FIXED_DOFS)  # U_D c = 0
    return np.ascontiguousarray(U[~is_fixed])
