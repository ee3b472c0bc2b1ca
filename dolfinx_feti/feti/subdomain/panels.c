// Copyright (C) 2026 the dolfinx_feti authors
//
// SPDX-License-Identifier: LGPL-3.0-or-later
//
// Products of block-sparse columns W = (W_1, W_2, …), (n, c). Panel p has count[p] columns, nonzero
// on the rows row[first[p]], …, row[first[p + 1] − 1], each row once; there its values stand row by
// row, and those of the next panel behind them.

#include <stddef.h>
#include <string.h>

typedef void (*dgemm)(char *, char *, int *, int *, int *, double *, double *, int *, double *,
                      int *, double *, double *, int *);

// Yᵀ = (S W)ᵀ, (c, n) row by row, for a symmetric S, (n, n); work has room for n² entries.
void panels_product(int n, int panels, const int *first, const int *row, const int *count,
                    const double *values, const double *S, double *Y, double *work, dgemm gemm)
{
    double one = 1.0, zero = 0.0;
    for (int p = 0; p < panels; Y += (size_t)n * count[p++]) {
        int m = first[p + 1] - first[p], k = count[p];
        if (!m || !k) {
            memset(Y, 0, sizeof(double) * (size_t)n * k);
            continue;
        }
        for (int e = 0; e < m; ++e)
            memcpy(work + (size_t)n * e, S + (size_t)n * row[first[p] + e], sizeof(double) * n);
        double *W = (double *)values;
        gemm("N", "T", &n, &k, &m, &one, work, &n, W, &k, &zero, Y, &n); // S[:, r_p] (W_p)_r
        values += (size_t)m * k;
    }
}

// E = Wᵀ Y, (c, r) row by row, for Yᵀ, (r, n) row by row; work has room for n r entries. If E is
// symmetric, what is above the diagonal blocks is copied from below.
void panels_overlap(int n, int panels, const int *first, const int *row, const int *count,
                    const double *values, int r, const double *Y, double *E, double *work,
                    int symmetric, dgemm gemm)
{
    double one = 1.0, zero = 0.0;
    for (int p = 0, c = 0; p < panels; E += (size_t)r * count[p++]) {
        int m = first[p + 1] - first[p], k = count[p], before = c, columns = r;
        c += k;
        if (symmetric) columns = c;
        if (m && k && columns) {
            const int *rows = row + first[p];
            for (int j = 0; j < columns; ++j)
                for (int e = 0; e < m; ++e) work[(size_t)m * j + e] = Y[(size_t)n * j + rows[e]];
            double *W = (double *)values;
            gemm("T", "T", &columns, &k, &m, &one, work, &m, W, &k, &zero, E, &r); // (W_p)_rᵀ Y_r
            values += (size_t)m * k;
        } else
            memset(E, 0, sizeof(double) * (size_t)r * k);
        double *const whole = E - (ptrdiff_t)r * before;
        for (int j = 0; symmetric && j < before; ++j)
            for (int l = before; l < c; ++l)
                whole[(ptrdiff_t)r * j + l] = whole[(ptrdiff_t)r * l + j];
    }
}

// e = Y z for Y, (c, n) row by row in single precision; the sums are in double precision.
void rows_product(int c, int n, const float *Y, const double *z, double *e)
{
    for (; c > 0; --c, Y += n) {
        double sum = 0.0;
#pragma omp simd reduction(+ : sum)
        for (int i = 0; i < n; ++i) sum += Y[i] * z[i];
        *e++ = sum;
    }
}
