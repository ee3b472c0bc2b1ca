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
