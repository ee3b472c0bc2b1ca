# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Finite elements: a mesh cut into subdomains, and forms assembled on them.

In the order of the data: elements, quadrature, nodes, compiler, facets, decomposition, kernels,
assembly, near_kernel, condensation, internal_variables, checks, content.
"""
