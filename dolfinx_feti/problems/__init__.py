# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Linear and nonlinear problems with dolfinx's signatures; Newton's method.

In the order of the data: arguments, history, solvers, forms, system, torn_problem,
linear_problem, line_search, derivative, newton, multipliers, nonlinear_problem.
"""
