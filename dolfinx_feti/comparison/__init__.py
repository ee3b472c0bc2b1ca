# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""FETI and other solvers compared: on the same linear system, with the same measure of cost.

FETI solves with the torn matrix, other solvers with the assembled matrix that PETSc converts it to.

Example::

    problem = dolfinx_feti.LinearProblem(a, L, bcs=[bc], subdomains=64, …)
    u = problem.solve()
    K, f = assembled_system(problem.A, problem.b)
    cost, x = measure(lambda: create_mumps(K), f)

In the order of the data: assembled, cost.
"""

from dolfinx_feti.comparison.assembled import assembled_system, create_mumps, relative_residual
from dolfinx_feti.comparison.cost import Cost, PeakMemory, measure, record_cost

__all__ = [
    "Cost",
    "PeakMemory",
    "assembled_system",
    "create_mumps",
    "measure",
    "record_cost",
    "relative_residual",
]
