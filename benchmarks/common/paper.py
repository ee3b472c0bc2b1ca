# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The paper's tables, as printed; ``paper.json`` beside this file holds the numbers.

The linear study has the table Augustin_tab:cube512_linear. The nonlinear study has aorta_linear and
aorta_quadratic (480 subdomains on as many cores), carotis_linear (512) and carotis_quadratic
(1024), with iterations and seconds per Newton step. Strong scaling has aorta_scaling and
carotis_scaling. Keys have the number of layers: 1 for the aorta, 2 for the carotid artery.
"""

from __future__ import annotations

import json
from pathlib import Path

_PRINTED = json.loads(Path(__file__).with_suffix(".json").read_text(encoding="utf-8"))

#: Iterations and condition numbers of the cube by type, preconditioner and level.
LINEAR = {
    (kind, pc, level): tuple(values)
    for kind, by_pc in _PRINTED["linear"].items()
    for pc, column in by_pc.items()
    for level, values in enumerate(column, start=1)
}

#: L2 errors by type and level. The paper does not give the source point.
L2_ERRORS = {
    (kind, level): error
    for kind, column in _PRINTED["l2_errors"].items()
    for level, error in enumerate(column, start=1)
}

#: Iterations of a Newton step, None for more than 10 000, and its seconds, by layers, degree, type,
#: κ and preconditioner.
NONLINEAR = {
    (int(layers), int(degree), kind, float(kappa), pc): tuple(values)
    for layers, by_degree in _PRINTED["nonlinear"].items()
    for degree, by_type in by_degree.items()
    for kind, by_kappa in by_type.items()
    for kappa, row in by_kappa.items()
    for pc, values in zip(("identity", "lumped", "dirichlet"), row, strict=True)
}

#: Seconds of a load step in strong scaling: assembly and factorisations, Krylov method, all of the
#: program. 512 subdomains, κ = 100 kPa, lumped preconditioner, five Newton steps: the aorta
#: by all-floating FETI, 324 iterations, the carotid artery by classical, 674. By layers, processes.
TIMES = {
    int(layers): {
        int(processes): dict(zip(("local", "krylov", "total"), row, strict=True))
        for processes, row in rows.items()
    }
    for layers, rows in _PRINTED["times"].items()
}

#: Tetrahedra of the paper's meshes, by layers, and dofs, by layers and degree: of linear elements
#: three for each vertex, of quadratic ones as printed.
CELLS = {1: 5_418_594, 2: 9_195_336}
DOFS = {(1, 1): 3 * 1_055_901, (2, 1): 3 * 1_621_365, (1, 2): 23_031_620, (2, 2): 36_527_435}

#: Subdomains, by layers and degree.
SUBDOMAINS = {(1, 1): 480, (1, 2): 480, (2, 1): 512, (2, 2): 1024}

#: Processes that the efficiency refers to.
FIRST = 16
