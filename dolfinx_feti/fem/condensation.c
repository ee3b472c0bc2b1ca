// Copyright (C) 2026 the dolfinx_feti authors
//
// SPDX-License-Identifier: LGPL-3.0-or-later

#include <float.h>
#include <math.h>
#include <stdint.h>

// The greater of |x| and y; NaN if one of them is.
static double greater(double x, double y)
{
    x = fabs(x);
    return x > y || x != x ? x : y;
}

// x ← x / s
static void divide(int n, double *x, double s)
{
    for (int i = 0; i < n; ++i) x[i] /= s;
}

// y ← y − s x
static void subtract(int n, double s, const double *x, double *y)
{
    for (int i = 0; i < n; ++i) y[i] -= s * x[i];
}

static void swap(int n, double *x, double *y)
{
    for (int i = 0; i < n; ++i) {
        const double t = x[i];
        x[i] = y[i];
        y[i] = t;
    }
}

// X ← A⁻¹ X with A, (n, n), and X, (n, k), by elimination with pivots from rows and columns that are
// scaled to 1: neither the units of the unknowns nor those of the equations decide what is singular.
// scale is for n numbers. Returns the first column that depends on those before it, or -1.
static int solve_block(int n, int k, double *A, double *X, double *scale)
{
    for (int i = 0; i < n; ++i) {
        double s = 0.0;
        for (int j = 0; j < n; ++j) s = greater(A[i * n + j], s);
        if (s == 0.0) return i;
        divide(n, A + i * n, s);
        divide(k, X + i * k, s);
    }
    for (int j = 0; j < n; ++j) {
        scale[j] = 0.0;
        for (int i = 0; i < n; ++i) scale[j] = greater(A[i * n + j], scale[j]);
        if (scale[j] == 0.0) return j;
        for (int i = 0; i < n; ++i) A[i * n + j] /= scale[j];
    }
    for (int j = 0; j < n; ++j) {
        int pivot = j;
        for (int i = j + 1; i < n; ++i)
            if (fabs(A[i * n + j]) > fabs(A[pivot * n + j])) pivot = i;
        if (fabs(A[pivot * n + j]) <= 16 * n * DBL_EPSILON) return j;
        if (pivot != j) {
            swap(n, A + pivot * n, A + j * n);
            swap(k, X + pivot * k, X + j * k);
        }
        for (int i = j + 1; i < n; ++i) {
            const double s = A[i * n + j] / A[j * n + j];
            subtract(n - j, s, A + j * n + j, A + i * n + j);
            subtract(k, s, X + j * k, X + i * k);
        }
    }
    for (int j = n - 1; j >= 0; --j) {
        divide(k, X + j * k, A[j * n + j]);
        for (int i = 0; i < j; ++i) subtract(k, A[i * n + j], X + j * k, X + i * k);
        divide(k, X + j * k, scale[j]);
    }
    return -1;
}

// X ← A⁻¹ X for m cells, each with A, (n, n), which is lost, and X, (n, k); scale is for n numbers.
//
// Returns -1; or, where A is singular in a cell, n times the first such cell, plus the column of A
// that depends on those before it.
int64_t solve_blocks(int m, int n, int k, double *A, double *X, double *scale)
{
    for (int64_t cell = 0; cell < m; ++cell) {
        const int column = solve_block(n, k, A + cell * n * n, X + cell * n * k, scale);
        if (column >= 0) return cell * n + column;
    }
    return -1;
}

// The first place from first on, up to last, whose entry is not less than a column.
static const int *find(const int *first, const int *last, int64_t column)
{
    while (first < last) {
        const int *middle = first + (last - first) / 2;
        if (*middle < column)
            first = middle + 1;
        else
            last = middle;
    }
    return first;
}

// K ← K − Σ_τ a b over m cells τ, each with a, (k bs, n), and b, (n, k bs), on its k nodes of bs
// dofs.
//
// node has the nodes of each cell, ascending, (m, k). K is given row by row, for N nodes, with
// ascending columns; it has a place for all pairs of nodes of a cell, and the rows of a node have
// the same columns. Returns 0, or 1 if that does not hold; a part is subtracted then.
int subtract_products(int m, int k, int bs, int n, int N, const int *node, const double *a,
                      const double *b, const int64_t *indptr, const int *indices, double *values)
{
    for (int cell = 0; cell < m; ++cell, node += k, a += k * bs * n, b += k * bs * n)
        for (int i = 0; i < k; ++i) {
            if (node[i] < 0 || node[i] >= N) return 1;
            const int64_t *const row = indptr + (int64_t)node[i] * bs;
            const int *const columns = indices + row[0], *const last = indices + row[1];
            const int *place = columns;
            for (int p = 1; p < bs; ++p)
                if (row[p + 1] - row[p] != row[1] - row[0]) return 1;
            for (int j = 0; j < k; ++j) {
                const int64_t column = (int64_t)node[j] * bs;
                place = find(place, last, column);
                if (last - place < bs || place[0] != column || place[bs - 1] != column + bs - 1)
                    return 1;
                for (int p = 0; p < bs; ++p)
                    for (int s = 0; s < n; ++s)
                        subtract(bs, a[(i * bs + p) * n + s], b + (s * k + j) * bs,
                                 values + row[p] + (place - columns));
            }
        }
    return 0;
}
