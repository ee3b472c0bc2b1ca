# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Finite elements: a mesh cut into subdomains, and forms assembled on them.

In the order of the data: elements, quadrature, nodes, compiler, facets, decomposition, kernels,
regions, assembly, near_kernel, tensors, condensation, internal_variables, checks,
content.

Cells are integrated in two ways: ``assembly`` adds one form to a matrix, a vector or a number,
``tensors`` returns an array of each of several forms, cell by cell, which ``condensation`` solves.
"""
