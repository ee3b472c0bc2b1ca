# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""FETI and other solvers compared: on the same linear system, with the same measure of cost.

FETI solves with the torn matrix, other solvers with the assembled matrix that PETSc converts it to.

Example::

    problem = dolfinx_feti.LinearProblem(a, L, bcs=[bc], subdomains=64, …)
    print(dolfinx_feti.compare(problem))

or, step by step::

    A, b = problem.linear_system()
    K, f = assembled_system(A, b)
    cost, x = measure(lambda: create_solver(K), f)

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
