# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Point springs of a floating body against dense algebra."""

import numpy as np
from cases import case
from collective import equal, whole

from dolfinx_feti.scalars.border import Border
from dolfinx_feti.scalars.springs import PointSprings

GRID = case((3, 2), (3, 3), 2)


def test_forces_of_springs_need_no_solve(torn_grid):
    """X = −A⁻¹ E with the springs in A: the copies of a motion count once in its assembled dofs."""
    problem = torn_grid(fixed=lambda x: np.zeros(len(x), dtype=bool), **GRID)
    first, end = problem.A.getOwnershipRange()
    springs = PointSprings(problem.A)
    no_columns = np.zeros((end - first, 0))
    border = springs.extend(Border(no_columns, no_columns, np.zeros((0, 0))))
    E = -whole(border.B)
    κ = 1.0 / np.diag(border.D)
    A = problem.matrix + E * κ @ E.T
    equal(A @ whole(springs.X), -E, 1e-9)
