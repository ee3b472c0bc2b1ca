# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Tools for users' arguments, MPI, PETSc, compiled code and the system, all independent of FETI.

===================  ==========================================================================
tools for            files
===================  ==========================================================================
types, versions      ``arrays``, ``compat`` (dolfinx and PETSc)
arguments of users   ``values``
partitions           ``scotch``
MPI                  ``collective``, ``star_forest``
distributed vectors  ``norms``, ``anderson`` (fixed points in loading/ and problems/)
PETSc                ``lifetime``, ``events``, ``petsc_errors``, ``petsc_library``,
                     ``linear_map``, ``petsc_options``
compiled code        ``native``
operating system     ``folders``, ``cost``
===================  ==========================================================================

In the order of the data: arrays, values, compat, scotch, collective, star_forest, lifetime,
events, norms, anderson, native, petsc_errors, petsc_library, linear_map, petsc_options, folders,
cost.
"""
