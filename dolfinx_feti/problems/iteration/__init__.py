# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The parts of Newton's method, each with one decision to take; ``newton`` has the loop.

In the order of the data: iterate, failures, convergence, state_error, rounding, early_end,
tangent_reuse, support, shifts, line, step_test, overshoots, line_search, tangent_check.
"""
