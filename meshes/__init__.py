# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Generators of artery walls; they need numpy and scipy, no FEniCSx and no Gmsh. See README.md."""
