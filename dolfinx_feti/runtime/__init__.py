# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What all other folders use: processes, compiled code, PETSc, versions.

In the order of the data: arrays, compat, collective, lifetime, events, native,
petsc_errors, petsc_library, petsc_options, folders, connectivity, tables, cost.
"""
