# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The equations of a problem at a state: residual and torn tangent.

In the order of the data: dirichlet, state, torn_dofs, deformation_gradient, tangent, system.
"""
