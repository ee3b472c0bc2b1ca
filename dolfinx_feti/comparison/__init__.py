# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""FETI and other solvers compared: on the same linear system, with the same measure of cost.

In the order of the data: solvers, run.
"""

from dolfinx_feti.comparison.run import Comparison, SolverResult, compare
from dolfinx_feti.comparison.solvers import (
    SOLVERS,
    assembled_system,
    create_solver,
    relative_difference,
    relative_residual,
)
from dolfinx_feti.mechanics.values import type_exports
from dolfinx_feti.runtime.cost import Cost, PeakMemory, measure, timed_solve

__all__ = [
    "SOLVERS",
    "Comparison",
    "Cost",
    "PeakMemory",
    "SolverResult",
    "assembled_system",
    "compare",
    "create_solver",
    "measure",
    "relative_difference",
    "relative_residual",
    "timed_solve",
]

type_exports(globals())
