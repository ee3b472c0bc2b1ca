# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Artery walls under pressure.

In the order of the data: oracle, problem, inflated_tube, first_step.
"""
