# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Is the assembled matrix singular? Both methods ask.

In the order of the data: motions, singularity.
"""
