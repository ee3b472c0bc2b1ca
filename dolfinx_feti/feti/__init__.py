# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Classical and all-floating FETI for a torn matrix; uses PETSc, and no finite elements.

The paper: C. M. Augustin, G. A. Holzapfel, O. Steinbach, Classical and all-floating FETI methods
for the simulation of arterial tissues, International Journal for Numerical Methods in Engineering
(IJNME) 99, 2014. In all files, "(eq. n)" is an equation of the paper.

- One solve: ``solver`` (PETSc's callbacks), ``outer_loop`` (refinement on the assembled system),
  ``dual`` or ``primal`` (the two formulations, whose common interface is ``formulation``). The
  ``__init__`` of a formulation's folder has the order in which its files are called.
- Its result: ``solve_info`` (records), ``accuracy`` (estimated error), ``converged_reason``,
  ``report``.
- Its input: ``options``, ``option_checks``, ``unread_options``, ``subsolver_options``,
  ``solve_settings``, ``krylov_limits``, ``monitor``, ``lifting`` (conventions of right-hand sides).
- Set-up: ``cache`` (what is reused for later matrices), ``pattern`` (symbolic parts), ``setup``
  (numerical parts), and the folders ``interface``, ``subdomain``, ``preconditioners``, ``coarse``
  and ``regularity``.

In the order of the data: krylov_limits, solve_info, monitor, subsolver_options, option_checks,
interface, subdomain, preconditioners, options, unread_options, coarse, regularity, pattern, setup,
accuracy, dual, primal, formulation, cache, solve_settings, converged_reason, outer_loop, report,
lifting, solver.
"""

from dolfinx_feti.feti.solver import FETI

__all__ = ["FETI"]
