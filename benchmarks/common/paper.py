# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The paper's tables, as printed.

Of the linear study Augustin_tab:cube512_linear; of the nonlinear one aorta_linear and
aorta_quadratic (480 subdomains on as many cores), carotis_linear (512) and carotis_quadratic
(1024), iterations and seconds per Newton step; of strong scaling aorta_scaling, carotis_scaling.
"""

from __future__ import annotations

from typing import NamedTuple

__all__ = [
    "DOFS",
    "FIRST",
    "L2_ERRORS",
    "LINEAR",
    "MESHES",
    "NONLINEAR",
    "SUBDOMAINS",
    "TIMES",
    "NewtonSolve",
    "Solve",
    "Times",
]

_PC = ("identity", "lumped", "dirichlet")


class Solve(NamedTuple):
    """Iterations and condition number of a solve."""

    iterations: int
    condition_number: float


_ROWS = {
    "all_floating": {
        "identity": [(61, 53.6), (71, 70.0), (88, 108.8), (119, 216.8), (160, 432.7)],
        "lumped": [(27, 10.3), (38, 19.7), (45, 26.1), (62, 53.2), (91, 126.2)],
        "dirichlet": [(21, 7.6), (26, 10.4), (27, 9.7), (32, 13.1), (37, 16.8)],
    },
    "classical": {
        "identity": [(80, 98.2), (105, 161.4), (140, 295.7), (188, 580.9), (251, 1150.3)],
        "lumped": [(35, 14.1), (58, 41.9), (85, 105.9), (125, 252.1), (179, 555.7)],
        "dirichlet": [(29, 10.0), (37, 16.4), (46, 25.4), (54, 35.8), (60, 46.3)],
    },
}

#: Solves of the cube by type, preconditioner and level.
LINEAR = {
    (kind, pc, level): Solve(*values)
    for kind, by_pc in _ROWS.items()
    for pc, column in by_pc.items()
    for level, values in enumerate(column, start=1)
}

#: L2 errors by type and level; the source point is not given.
L2_ERRORS = {
    (kind, level): error
    for kind, column in {
        "all_floating": [1.42e-4, 3.71e-5, 9.40e-6, 2.37e-6, 5.96e-7],
        "classical": [1.47e-4, 3.72e-5, 9.41e-6, 2.37e-6, 5.96e-7],
    }.items()
    for level, error in enumerate(column, start=1)
}


#: Tetrahedra and vertices of the paper's meshes, by layers: the aorta, the carotid artery.
MESHES = {1: (5_418_594, 1_055_901), 2: (9_195_336, 1_621_365)}

#: Subdomains, by layers and degree.
SUBDOMAINS = {(1, 1): 480, (1, 2): 480, (2, 1): 512, (2, 2): 1024}


class NewtonSolve(NamedTuple):
    """Iterations of a Newton step, None for more than 10 000, and its seconds."""

    iterations: int | None
    seconds: float | None


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
NONLINEAR = {
    (layers, degree, kind, float(kappa), pc): NewtonSolve(*values)
    for layers, tables in ((1, _AORTA), (2, _CAROTID))
    for (degree, kind), rows in tables.items()
    for kappa, row in rows.items()
    for pc, values in zip(_PC, row, strict=True)
}


#: Displacement dofs of the two meshes, by layers: three for each vertex.
DOFS = {1: 3 * 1_055_901, 2: 3 * 1_621_365}

#: Processes that the efficiency refers to.
FIRST = 16


class Times(NamedTuple):
    """Seconds of a load step: assembly and factorisations, Krylov method, all of the program."""

    local: float
    krylov: float
    total: float


#: Strong scaling, 512 subdomains, κ = 100 kPa, lumped preconditioner, five Newton steps: the aorta
#: by all-floating FETI, 324 iterations, the carotid artery by classical, 674. By layers, processes.
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
