// Copyright (C) 2026 the dolfinx_feti authors
//
// SPDX-License-Identifier: LGPL-3.0-or-later

// K ← K − Σ_τ K_up K_pp⁻¹ K_pu over the cells τ. d = nodes bs is the number of dofs of u in a cell.
//   K     the matrix on the dofs of u
//   n     number of dofs of all condensed fields in a cell, at least one
//   K_up  (cells, d, n)
//   slope K_pp⁻¹ K_pu, (cells, n, d)
void subtract_products(const CsrMatrix *K, int n, const double *K_up, const double *slope);
