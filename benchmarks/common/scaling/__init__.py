# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Strong scaling: runs on processes of their own, what they send, and a model of both.

In the order of the data: traffic, worker, model.
"""
