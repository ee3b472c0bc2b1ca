# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What the coarse fields prove of the assembled matrix, against dense matrices."""

from __future__ import annotations

import numpy as np
import pytest
from collective import agree
from hand_torn import softened, unsymmetric

GRID = {"subdomains": (3, 2), "cells": (3, 3), "components": 2}

every_type = pytest.mark.parametrize("kind", ["all_floating", "classical"])
every_interior = pytest.mark.parametrize("interior", ["keep", "eliminate"])


@every_type
@every_interior
@pytest.mark.parametrize("share", [0.0, 0.002, 0.004, 0.01, 0.05, 0.2])
def test_what_is_proved_is_there(kind, interior, share, torn_grid, parts):
    """Never more negative eigenvalues than A has, and some wherever it has many."""
    problem = torn_grid(change=softened(share), **GRID)
    there = np.count_nonzero(np.linalg.eigvalsh(problem.free_matrix) < 0.0)
    for pc_type in ("dirichlet", "lumped", "identity"):
        system = parts(problem.A, type=kind, interior=interior, pc_type=pc_type)
        proved = system.inertia.assembled
        if proved is None:  # K_II is factored for the Dirichlet preconditioner, or eliminated
            agree(interior == "keep" and pc_type != "dirichlet" and share > 0.0)
            continue
        agree(0 <= proved <= there, (proved, there))
        agree(proved > 0 or there <= 1 or pc_type != "dirichlet", (proved, there))
        agree(share > 0.0 or system.inertia.dual == 0)


@every_type
def test_unsymmetric_matrix_has_no_inertia(kind, torn_grid, parts):
    problem = torn_grid(change=unsymmetric(0.01), **GRID)
    agree(parts(problem.A, type=kind).inertia.assembled is None)
