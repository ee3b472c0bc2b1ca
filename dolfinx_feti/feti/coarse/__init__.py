# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The coarse problem: the projection, its solver, and what it tells of the assembled matrix.

In the order of the data: columns, near, fields, weighted, gathered, coarse, bodies, motions,
singularity, stability, adaptive, averaged.
"""
