# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The paper's tables of the nonlinear study: iterations and seconds per Newton step.

Augustin_tab:aorta_linear and aorta_quadratic (480 subdomains on as many cores), carotis_linear
(512) and carotis_quadratic (1024).
"""

from __future__ import annotations

from typing import NamedTuple

__all__ = ["MESHES", "SOLVES", "SUBDOMAINS", "Solve"]

#: Tetrahedra and vertices of the paper's meshes, by layers: the aorta, the carotid artery.
MESHES = {1: (5_418_594, 1_055_901), 2: (9_195_336, 1_621_365)}

#: Subdomains, by layers and degree.
SUBDOMAINS = {(1, 1): 480, (1, 2): 480, (2, 1): 512, (2, 2): 1024}


class Solve(NamedTuple):
    """Iterations of a Newton step, None for more than 10 000, and its seconds."""

    iterations: int | None
    seconds: float | None


_PC = ("identity", "lumped", "dirichlet")
_MORE = (None, None)

_AORTA = {
    (1, "all_floating"): {
        10: [(1052, 57.6), (160, 31.0), (56, 22.8)],
        100: [(1879, 94.6), (305, 29.5), (85, 25.4)],
        1000: [(4122, 177.1), (681, 48.8), (209, 31.8)],
    },
    (1, "classical"): {
        10: [(2056, 98.7), (305, 35.5), (117, 27.2)],
        100: [(3711, 149.8), (540, 35.5), (144, 28.4)],
        1000: [(8245, 327.8), (1190, 60.9), (263, 32.9)],
    },
    (2, "all_floating"): {
        10: [(940, 491.1), (283, 209.5), (71, 157.3)],
        100: [(1519, 1186.4), (523, 332.0), (105, 178.1)],
        1000: [(3371, 2584.5), (1372, 746.0), (206, 282.7)],
    },
    (2, "classical"): {
        10: [(1319, 654.2), (333, 225.2), (113, 188.4)],
        100: [(2362, 1140.6), (664, 402.6), (110, 177.5)],
        1000: [(5563, 4168.3), (1742, 943.1), (204, 280.1)],
    },
}
_CAROTID = {
    (1, "all_floating"): {1000: [_MORE, (1084, 100.6), (497, 85.5)]},
    (1, "classical"): {1000: [(5130, 357.0), (1794, 200.2), (588, 97.7)]},
    (2, "all_floating"): {1000: [_MORE, (2163, 1133.9), (674, 994.6)]},
    (2, "classical"): {1000: [(6006, 2672.6), (4798, 2306.8), (764, 771.2)]},
}

#: Newton steps by layers (1, the aorta; 2, the carotid artery), degree, type, κ and preconditioner.
SOLVES = {
    (layers, degree, kind, float(kappa), pc): Solve(*values)
    for layers, tables in ((1, _AORTA), (2, _CAROTID))
    for (degree, kind), rows in tables.items()
    for kappa, row in rows.items()
    for pc, values in zip(_PC, row, strict=True)
}
