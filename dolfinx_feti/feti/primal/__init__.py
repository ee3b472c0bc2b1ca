# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The primal formulation: a Krylov method for the displacement of the assembled interface.

In this room A, b, x, r and z belong to the assembled *interface*: A = Tᵀ S T, and a vector is
stored by its copies on the interfaces of the subdomains of a process, (n_Γ,), as
``interface/copies`` describes. Only ``formulation`` also has the assembled problem of all dofs, and
writes A_Γ and x_Γ for those of the interface. V stands for V B, with the independent combinations B
of coarse vectors (``coarse.energy``), and A₀⁻¹ e for B A₀⁻¹ Bᵀ e.

A solve begins in ``formulation`` and iterates in ``krylov`` on the operators of ``system``;
``ritz_vectors`` are then computed, by which ``deflation`` speeds up later solves. A solve without
Ritz vectors of an earlier one may be deflated by ``soft_fields``. The coarse space is in
``coarse/``.

Comments on constants name one set of measurements. The *artery path* is that of the demo's artery
(45 000 dofs, 32 subdomains) to a pressure of 10 mmHg: 36 linear solves, 466 iterations together.

In the order of the data: assembled_product, preconditioner, deflation, system, stopping, krylov,
ritz_vectors, soft_fields, formulation.
"""
