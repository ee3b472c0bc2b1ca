// Copyright (C) 2026 the dolfinx_feti authors
//
// SPDX-License-Identifier: LGPL-3.0-or-later
//
// Blocks of symmetric matrices on b of their rows: the lower triangle of the block, row by row,
// (b (b + 1) / 2).

#include <stddef.h>

// Copy a block of S.
//   n:      order of S
//   S:      its lower triangle column by column, LAPACK's packed format, (n (n + 1) / 2)
//   b:      number of rows
//   rows:   rows of S, in any order, (b)
//   block:  the block on these rows, output, (b (b + 1) / 2)
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

// Add a block to the lower triangle of A, diagonal included.
//   n:      order of A
//   A:      the matrix column by column, (n, n)
//   b:      number of rows
//   rows:   rows of A, ascending, (b)
//   block:  the block on these rows, (b (b + 1) / 2)
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
