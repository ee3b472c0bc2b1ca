# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The unknowns of a problem: which one is torn, and which are condensed.

In the order of the data: alternatives, mixed_of_one, block_forms, torn_unknown, nonlinear_blocks,
linear_blocks, compression.
"""
