# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The paper's load stepping: walls up to 300 mmHg.

In the order of the data: points, run, page.
"""
