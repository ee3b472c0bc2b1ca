# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Mechanics of arterial walls in UFL: kinematics, materials, loads, supports, residual stress.

In the order of the data: values, kinematics, residual_stress, materials, memory,
loads, supports.
"""
