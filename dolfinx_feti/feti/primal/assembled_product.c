// Copyright (C) 2026 the dolfinx_feti authors
//
// SPDX-License-Identifier: LGPL-3.0-or-later
//
// Blocks of symmetric matrices on some of their rows; arguments: assembled_product.h.

#include <stddef.h>

#include "assembled_product.h"

void copy_block(int n, const double *S, int b, const int *rows, double *block)
{
    for (int k = 0; k < b; ++k) {
        for (int l = 0; l <= k; ++l) {
            const int i = rows[k] > rows[l] ? rows[k] : rows[l];
            const int j = rows[k] > rows[l] ? rows[l] : rows[k];
            const ptrdiff_t column = (ptrdiff_t)j * (2 * n - j - 1) / 2; // entry (i, j) is at column + i
            *block = S[i + column];
            ++block;
        }
    }
}

void add_block(int n, float *A, int b, const int *rows, const double *block)
{
    for (int k = 0; k < b; ++k) {
        for (int l = 0; l <= k; ++l) {
            const ptrdiff_t column = (ptrdiff_t)n * rows[l]; // entry (i, rows[l]) is at column + i
            A[rows[k] + column] += (float)*block;
            ++block;
        }
    }
}
