// Copyright (C) 2026 the dolfinx_feti authors
//
// SPDX-License-Identifier: LGPL-3.0-or-later

// s_i = sum over j of a_ij^2 t_j^2 for a matrix, (n, n), row by row; t and s have n entries.
void sum_squares(int n, const int *indptr, const int *indices, const double *a, const double *t,
                 double *s)
{
    for (int i = 0; i < n; ++i) {
        s[i] = 0.0;
        for (int e = indptr[i]; e < indptr[i + 1]; ++e) {
            const double product = a[e] * t[indices[e]];
            s[i] += product * product;
        }
    }
}
