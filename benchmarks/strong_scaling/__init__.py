# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The page of the scaling study: times, counts, and a model that carries them to more processes.

In the order of the data: paper, groups, model, checks, tables, plots.
"""
