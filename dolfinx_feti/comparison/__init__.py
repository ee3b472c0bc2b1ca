# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""FETI and other solvers compared: on the same linear system, with the same measure of cost.

A new solver is an entry of ``SOLVERS``, or of the dict that a user gives to ``compare``: a name and
PETSc's options. An entry of ``SOLVERS`` is also part of each comparison with the default solvers,
which docs/comparing.md lists. If it needs a package of PETSc, that is a name in ``PACKAGES``. If it
uses the torn matrix, as BDDC does, ``Solver.kind`` and ``create_solver`` change, too.

In the order of the data: solvers, run.
"""

from dolfinx_feti.comparison.run import Comparison, SolverResult, compare

# Parts of ``compare``, for scripts that compare in another way; not in __all__.
from dolfinx_feti.comparison.solvers import SOLVERS as SOLVERS
from dolfinx_feti.comparison.solvers import assembled_system as assembled_system
from dolfinx_feti.comparison.solvers import create_solver as create_solver
from dolfinx_feti.comparison.solvers import relative_difference as relative_difference
from dolfinx_feti.comparison.solvers import relative_residual as relative_residual
from dolfinx_feti.runtime.cost import Cost as Cost
from dolfinx_feti.runtime.cost import PeakMemory as PeakMemory
from dolfinx_feti.runtime.cost import measure as measure
from dolfinx_feti.runtime.cost import timed_solve as timed_solve

__all__ = ["Comparison", "SolverResult", "compare"]
