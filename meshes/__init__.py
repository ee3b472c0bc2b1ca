# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Short names of two commands of :mod:`dolfinx_feti.meshes`, which has the code.

In the order of the data: tube, vessel.
"""
