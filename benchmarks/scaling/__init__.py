# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The paper's strong scaling: measured, counted, and carried on by a model.

In the order of the data: paper, traffic, weak, worker, model, predict, run, page.
"""
