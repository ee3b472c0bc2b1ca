# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The dofs of each subdomain: fixed ones, the interface Γ and the interior I.

In classical FETI the dofs with a prescribed value are *fixed* in the local matrices; all-floating
FETI has none that are. The others are free, and either in B, on the interface, or inside.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_feti.runtime.arrays import Indices, Mask
from dolfinx_feti.torn.matrix import Torn

__all__ = ["Dofs", "sort_dofs"]


@dataclass(frozen=True, slots=True)
class Dofs:
    """The torn dofs of each subdomain of this process, ascending.

    Attributes:
        fixed: Mask of the torn dofs that are fixed in the local matrices, (n,).
        glued: Mask of the interface, (n,).
        free: Free dofs of each subdomain.
        interface: Γ of each subdomain.
        interior: I of each subdomain.
        on_interface: Mask of Γ among the free dofs of each subdomain.
    """

    fixed: Mask
    glued: Mask
    free: list[Indices]
    interface: list[Indices]
    interior: list[Indices]
    on_interface: list[Mask]


def sort_dofs(torn: Torn, glued: Indices, *, all_floating: bool) -> Dofs:
    """Sort the dofs of each subdomain into fixed, glued (those that occur in B), and inside."""
    fixed = torn.dirichlet & (not all_floating)
    mask = np.zeros(torn.n, dtype=bool)
    mask[glued] = True
    free = [rows[~fixed[rows]] for rows in torn.subdomains]
    on = [mask[rows] for rows in free]
    return Dofs(
        fixed=fixed,
        glued=mask,
        free=free,
        interface=[rows[is_glued] for rows, is_glued in zip(free, on, strict=True)],
        interior=[rows[~is_glued] for rows, is_glued in zip(free, on, strict=True)],
        on_interface=on,
    )
