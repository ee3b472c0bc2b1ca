# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The interface Γ: which dofs have copies, the weights of the copies, and the jumps between them.

``scaling`` computes the weights for both formulations. ``gluing`` has the interface dofs of both,
and the jumps of the dual formulation. ``copies`` works with vectors on these dofs and with these
weights, for the primal formulation and the coarse spaces. Equations "(eq. 34)" are those of
Augustin, Holzapfel, Steinbach 2014.

In the order of the data: scaling, gluing, copies.
"""
