# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""FETI compared with MUMPS, GAMG and others on the same matrices.

In the order of the data: geometries, opponents, path, tables.
"""
