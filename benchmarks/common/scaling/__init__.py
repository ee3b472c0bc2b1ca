# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Strong scaling: separate runs for each number of processes, their messages, and a model of both.

In the order of the data: traffic, worker, model.
"""
