// Copyright (C) 2026 the dolfinx_feti authors
//
// SPDX-License-Identifier: LGPL-3.0-or-later

#include <stdint.h>

// y ← y − s x
static void subtract(int n, double s, const double *x, double *y)
{
    for (int i = 0; i < n; ++i) y[i] -= s * x[i];
}

// K ← K − Σ_τ a b over m cells τ, each with a, (k bs, n), and b, (n, k bs), on its k nodes of bs
// dofs. The columns of node j begin at a place, (m, k, k), in the rows of node i.
void subtract_products(int m, int k, int bs, int n, const int *node, const int *place,
                       const double *a, const double *b, const int64_t *indptr, double *values)
{
    const int width = k * bs;
    double product[width];  // a row of a b
    for (int cell = 0; cell < m; ++cell, node += k, b += width * n)
        for (int i = 0; i < k; ++i, place += k)
            for (int p = 0; p < bs; ++p, a += n) {
                double *const row = values + indptr[(int64_t)node[i] * bs + p];
                for (int q = 0; q < width; ++q) product[q] = a[0] * b[q];
                for (int s = 1; s < n; ++s) subtract(width, -a[s], b + s * width, product);
                for (int j = 0; j < k; ++j) subtract(bs, 1.0, product + j * bs, row + place[j]);
            }
}
