# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The dofs of one subdomain: all, the free ones, its interface Γ and its interior I.

They depend only on the pattern of the matrix. The Schur complement S_i (``schur``) and the
generalised inverse K_i⁺ (``generalized_inverse``) of a subdomain refer to its ``Subdomain``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_feti.runtime.arrays import Indices, Mask, concatenate, consecutive_slices
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.torn.matrix import Torn


@dataclass(frozen=True, slots=True, eq=False)
class Subdomain:
    """The dofs of one subdomain, as torn dofs of this process in ascending order.

    Attributes:
        number: Number of the subdomain over all processes.
        all_dofs: All dofs, (n_all,).
        free_dofs: Dofs that are not fixed in the local matrix, (n_i,).
        interface: Γ, the free dofs that are glued, (n_{Γ,i},).
        interior: I, the other free dofs, (n_{I,i},).
        is_on_interface: Mask of Γ among the free dofs, (n_i,).
        interface_rows: Rows of Γ in an interface vector, (n_Γ,). Such a vector has the values on Γ
            of all subdomains of this process, one after the other.
    """

    number: int
    all_dofs: Indices
    free_dofs: Indices
    interface: Indices
    interior: Indices
    is_on_interface: Mask
    interface_rows: slice


def create_subdomains(torn: Torn, glued: Indices, fixed: Mask) -> list[Subdomain]:
    """Sort the dofs of the subdomains of this process into fixed, interface, and interior dofs.

    Collective.

    Args:
        torn: The torn matrix.
        glued: Torn dofs that occur in the jump operator B.
        fixed: Mask of the torn dofs that are fixed in the local matrices, (n,).
    """
    return on_all(lambda: _create_subdomains(torn, glued, fixed), torn.comm)


def _create_subdomains(torn: Torn, glued: Indices, fixed: Mask) -> list[Subdomain]:
    """Create the subdomains of this process; see :func:`create_subdomains`."""
    is_glued = np.zeros(torn.n, dtype=bool)
    is_glued[glued] = True
    free = [dofs[~fixed[dofs]] for dofs in torn.subdomains]
    interface_rows = consecutive_slices([int(np.count_nonzero(is_glued[dofs])) for dofs in free])
    subdomains = []
    for i, dofs in enumerate(torn.subdomains):
        is_on_interface = is_glued[free[i]]
        subdomains.append(
            Subdomain(
                number=torn.first_subdomain + i,
                all_dofs=dofs,
                free_dofs=free[i],
                interface=free[i][is_on_interface],
                interior=free[i][~is_on_interface],
                is_on_interface=is_on_interface,
                interface_rows=interface_rows[i],
            )
        )
    return subdomains


def interface_dofs(subdomains: list[Subdomain]) -> Indices:
    """Return Γ of all subdomains of this process, one after the other, (n_Γ,)."""
    return concatenate([s.interface for s in subdomains], np.int32)
