# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Linear and nonlinear problems with dolfinx's signatures; Newton's method.

The user's arguments become forms on one unknown that is torn (``unknowns``, ``forms``), and these
become equations (``equations``). ``TornProblem`` is what both problem classes share. Then follow
the linear problem; Newton's method with its parts (``iteration``); and the nonlinear problem.
*The paper* in this folder is Augustin, Holzapfel and Steinbach (2014), see docs/equations.md.

In the order of the data: unknowns, arguments, forms, boundary, equations, incompressible,
multipliers, volume_multipliers, contacts, reactions, solver_options, solvers, torn_problem,
history, linear_problem, hooks, iteration, newton, nonlinear_problem.
"""
