# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Mechanics of an artery's wall, in UFL alone: kinematics, materials and loads.

In the order of the data: kinematics, materials, loads.
"""
