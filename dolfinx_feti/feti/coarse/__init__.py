# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What the coarse problems of both methods share.

In the order of the data: fields, near, group, gathered, space.
"""
