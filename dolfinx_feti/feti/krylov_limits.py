# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Limits of the Krylov methods of both formulations."""

from __future__ import annotations

#: Directions of GMRES between two of its own restarts: in the primal form, and by default in the
#: dual one (``ksp_gmres_restart``). It bounds the memory: a direction takes one vector, and two in
#: the primal form or with FGMRES. Neither half nor twice of it changes a dual solve on grids of 6
#: and 20 subdomains with jumps of up to 10⁶ in the stiffness.
GMRES_DIRECTIONS = 200

#: Iterations without a new smallest residual after which a solve ends for a fresh start. It guards
#: against endless solves. Neither half nor twice of it changes a solve with CG on the same grids,
#: which takes up to 1109 iterations.
STAGNATION_ITERATIONS = 200
