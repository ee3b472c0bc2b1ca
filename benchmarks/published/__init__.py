# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Numbers that others have published, computed again.

In the order of the data: body, mumps, ellipsoid, revolved, stressed_tube, cases, run, result_file,
page.
"""
