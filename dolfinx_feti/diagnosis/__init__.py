# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Diagnosis of a problem: what a solver built, where its time went, and what would help.

In the order of the data: advice, cell_volumes, cell_check, run.
"""
