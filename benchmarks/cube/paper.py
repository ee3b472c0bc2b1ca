# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The paper's table of the linear study, Augustin_tab:cube512_linear: linear elements."""

from __future__ import annotations

from typing import NamedTuple

__all__ = ["L2_ERRORS", "SOLVES", "Solve"]


class Solve(NamedTuple):
    """Iterations and condition number of a solve."""

    iterations: int
    condition_number: float


_IDENTITY, _LUMPED, _DIRICHLET = "identity", "lumped", "dirichlet"
_ROWS = {
    "all_floating": {
        _IDENTITY: [(61, 53.6), (71, 70.0), (88, 108.8), (119, 216.8), (160, 432.7)],
        _LUMPED: [(27, 10.3), (38, 19.7), (45, 26.1), (62, 53.2), (91, 126.2)],
        _DIRICHLET: [(21, 7.6), (26, 10.4), (27, 9.7), (32, 13.1), (37, 16.8)],
    },
    "classical": {
        _IDENTITY: [(80, 98.2), (105, 161.4), (140, 295.7), (188, 580.9), (251, 1150.3)],
        _LUMPED: [(35, 14.1), (58, 41.9), (85, 105.9), (125, 252.1), (179, 555.7)],
        _DIRICHLET: [(29, 10.0), (37, 16.4), (46, 25.4), (54, 35.8), (60, 46.3)],
    },
}

#: Solves by type, preconditioner and level.
SOLVES = {
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
