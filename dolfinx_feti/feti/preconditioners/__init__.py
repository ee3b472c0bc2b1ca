# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Preconditioners M = B_D Y B_Dᵀ of the dual formulation, a file for each Y.

They belong to the dual formulation alone, and choosing any but ``dirichlet`` by ``feti_pc_type``
selects it. The primal formulation has one preconditioner, ``primal/preconditioner``. The room comes
before ``coarse`` and ``dual`` in the order of the data because the weight Q of the dual coarse
problem contains M. Equations "(eq. 46)" are those of Augustin, Holzapfel, Steinbach 2014, who write
M⁻¹ for M.

A new preconditioner is a file like ``lumped``, a line in ``registry``, and its place in the order
below. The head of ``registry`` lists what else it needs.

In the order of the data: base, dirichlet, lumped, identity, registry.
"""
