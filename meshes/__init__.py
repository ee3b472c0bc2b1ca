# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Short names of two commands of :mod:`dolfinx_feti.meshes`.

In the order of the data: tube, vessel.
"""
