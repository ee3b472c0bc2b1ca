# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Rounding errors of the forces of a contact."""

from __future__ import annotations

import numpy as np

from dolfinx_feti.contact.evaluation import ContactEvaluation
from dolfinx_feti.contact.traces import Traces

__all__ = ["force_rounding"]

#: Step of the second differences of g that measure its rounding, over the size of the smallest
#: cell. The curvature of a tool as small as a cell adds the square of it, 1e-14, which is below the
#: rounding of a body of a hundred cells. At 1e-9 the step itself is rounded.
ROUNDING_STEP = 1e-7


def force_rounding(evaluation: ContactEvaluation, traces: Traces) -> float:
    """Return the norm of the rounding errors of the contact's forces on nodes. Collective.

    g may be a small difference of large lengths such as a radius. Its rounding error is measured by
    second differences over a step so short that curvature does not contribute. u is moved during
    the call, and restored before it returns.

    Args:
        evaluation: Values at the points of the surface.
        traces: Basis functions of the displacement there.
    """
    comm = evaluation.surface.mesh.comm
    u = evaluation.law.u.x.array
    step = ROUNDING_STEP * evaluation.surface.min_cell_size
    before = u.copy()
    gaps = []
    try:
        for shift in (0.0, step, -step):
            u[:] = before + shift
            gaps.append(evaluation.gap())
    finally:
        u[:] = before
    difference = gaps[1] - 2.0 * gaps[0] + gaps[2]
    squares = np.array([difference @ difference, len(difference)])
    total, count = comm.allreduce(squares)
    error = np.sqrt(total / count / 6.0)  # the variance is that of 1 + 4 + 1 errors
    is_touching = evaluation.pressure() > 0.0
    forces = traces.nodal_forces(is_touching * evaluation.penalty() * error)
    return float(np.sqrt(comm.allreduce(float(forces @ forces))))
