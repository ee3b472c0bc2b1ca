# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Artery walls under pressure: the tube with its semi-analytical solution, and the vessel.

In the order of the data: supports, problem, oracle, tube, inflated_tube, vessel, points, volume,
rims, newton_case, parallel_run.
"""
