// Copyright (C) 2026 the dolfinx_feti authors
//
// SPDX-License-Identifier: LGPL-3.0-or-later
//
// Blocks of symmetric matrices, m rows in any order, by their lower triangle row by row.

#include <stddef.h>

// Copy a block of S, of order n, whose lower triangle stands in packed format.
void copy_block(int n, const double *S, int m, const int *rows, double *block)
{
    for (int a = 0; a < m; ++a)
        for (int b = 0; b <= a; ++b) {
            const int i = rows[a] > rows[b] ? rows[a] : rows[b], j = rows[a] + rows[b] - i;
            *block++ = S[i + (ptrdiff_t)j * (2 * n - j - 1) / 2];
        }
}

// Add a block to A, (n, n) column by column, of which the lower triangle is there; rows ascend.
void add_block(int n, float *A, int m, const int *rows, const double *block)
{
    for (int a = 0; a < m; ++a)
        for (int b = 0; b <= a; ++b) A[rows[a] + (ptrdiff_t)n * rows[b]] += (float)*block++;
}
