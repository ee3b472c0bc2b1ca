# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The paper's strong scaling, Augustin_tab:aorta_scaling and Augustin_tab:carotis_scaling.

512 subdomains, κ = 100 kPa, lumped preconditioner, five Newton steps. The aorta with all-floating
FETI took 324 iterations on average, the carotid artery with classical FETI 674.
"""

from __future__ import annotations

from typing import NamedTuple

__all__ = ["DOFS", "FIRST", "TIMES", "Times"]


class Times(NamedTuple):
    """Seconds of a load step: assembly and factorisations, Krylov method, all of the program."""

    local: float
    krylov: float
    total: float


#: Displacement dofs of the two meshes, by layers: three for each vertex.
DOFS = {1: 3 * 1_055_901, 2: 3 * 1_621_365}

#: Processes that the efficiency refers to.
FIRST = 16

#: Times by layers (1, the aorta; 2, the carotid artery) and processes.
TIMES = {
    1: {
        16: Times(407.7, 1311.7, 2028.6),
        32: Times(203.1, 666.4, 1054.2),
        64: Times(101.7, 345.4, 562.0),
        128: Times(50.5, 184.7, 316.7),
        256: Times(25.3, 103.8, 192.8),
        512: Times(12.7, 67.6, 161.0),
    },
    2: {
        16: Times(726.0, 4725.8, 6519.7),
        32: Times(351.3, 2368.2, 3497.0),
        64: Times(170.5, 1262.9, 1991.2),
        128: Times(90.7, 694.5, 1194.1),
        256: Times(47.3, 443.6, 914.4),
        512: Times(23.9, 297.2, 667.4),
    },
}
