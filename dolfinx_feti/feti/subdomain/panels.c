// Copyright (C) 2026 the dolfinx_feti authors
//
// SPDX-License-Identifier: LGPL-3.0-or-later
//
// Products of block-sparse columns, see panels.h.

#include <stddef.h>
#include <string.h>

#include "panels.h"

// Y = S W: copy the columns of S that a panel needs, one after the other, and multiply. S is
// symmetric: its columns are its rows, which are contiguous.
void panels_premultiply(const panels *W, const double *S, double *Y, double *work,
                        dgemm_routine gemm)
{
    double one = 1.0;
    double zero = 0.0;
    int n = W->n;
    double *values = (double *)W->values; // BLAS reads them, but takes pointers without const
    for (int p = 0; p < W->count; ++p) {
        const int *const rows = W->rows + W->starts[p];
        int m = W->starts[p + 1] - W->starts[p]; // rows of the panel
        int k = W->widths[p];                    // its columns
        if (m && k) {
            for (int i = 0; i < m; ++i) {
                memcpy(work + (size_t)n * i, S + (size_t)n * rows[i], sizeof(double) * n);
            }
            gemm("N", "T", &n, &k, &m, &one, work, &n, values, &k, &zero, Y, &n); // S[:, r_p] W_p
        } else {
            memset(Y, 0, sizeof(double) * (size_t)n * k);
        }
        values += (size_t)m * k;
        Y += (size_t)n * k;
    }
}

// Copy the rows a, …, b − 1 of a symmetric X, (c, r) row by row, left of the diagonal block, to the
// same columns above that block: entry (j, l) = entry (l, j) for j < a ≤ l < b.
static void mirror_rows(double *X, int r, int a, int b)
{
    for (int j = 0; j < a; ++j) {
        for (int l = a; l < b; ++l) X[(size_t)r * j + l] = X[(size_t)r * l + j];
    }
}

// X = Wᵀ Y: copy the rows of Y that a panel needs, and multiply. If X is symmetric, the rows of a
// panel are computed up to its diagonal block, and mirrored.
void panels_multiply_transposed(const panels *W, int r, const double *Y, double *X, double *work,
                                int is_symmetric, dgemm_routine gemm)
{
    double one = 1.0;
    double zero = 0.0;
    double *values = (double *)W->values; // BLAS reads them, but takes pointers without const
    int begin = 0;                        // first row of X of the panel
    for (int p = 0; p < W->count; ++p) {
        const int *const rows = W->rows + W->starts[p];
        int m = W->starts[p + 1] - W->starts[p]; // rows of the panel
        int k = W->widths[p];                    // its columns, which are rows of X
        const int end = begin + k;
        int columns = is_symmetric ? end : r; // columns of X that are computed
        double *const X_p = X + (size_t)r * begin;
        if (m && k && columns) {
            for (int j = 0; j < columns; ++j) {
                for (int i = 0; i < m; ++i) work[(size_t)m * j + i] = Y[(size_t)W->n * j + rows[i]];
            }
            // (W_p)ᵀ Y[r_p, :]
            gemm("T", "T", &columns, &k, &m, &one, work, &m, values, &k, &zero, X_p, &r);
        } else {
            memset(X_p, 0, sizeof(double) * (size_t)r * k);
        }
        if (is_symmetric) mirror_rows(X, r, begin, end);
        values += (size_t)m * k;
        begin = end;
    }
}

// e = Y z with sums in double precision.
void rows_product(int c, int n, const float *Y, const double *z, double *e)
{
    for (int i = 0; i < c; ++i) {
        const float *const row = Y + (size_t)n * i;
        double sum = 0.0;
#pragma omp simd reduction(+ : sum)
        for (int j = 0; j < n; ++j) sum += row[j] * z[j];
        e[i] = sum;
    }
}
