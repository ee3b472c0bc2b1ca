// Copyright (C) 2026 the dolfinx_feti authors
//
// SPDX-License-Identifier: LGPL-3.0-or-later

#include <float.h>
#include <math.h>
#include <stdint.h>

// The graph of m nodes, groups of consecutive rows: two are coupled if any of their rows are.
//
// The matrix, (n, n), is given row by row. k of its rows count, ascending, and the columns with a
// number that is not negative: rows[number[column]] is the column, node[i] the node of the i-th
// row, ascending from 0 to m − 1. ptr has room for m + 1, adjacent for as many entries as these
// rows have, mark for m. Returns the number of entries of the graph, or −1 if rows, columns, numbers
// or nodes are not as described.
int couple_nodes(int n, int k, const int *rows, const int *indptr, const int *indices,
                 const int *number, const int *node, int m, int *ptr, int *adjacent, int *mark)
{
    int entries = 0, v = -1;
    for (int i = 0; i < k; ++i) {
        if (rows[i] < 0 || rows[i] >= n || (i && rows[i] <= rows[i - 1])) return -1;
        if (node[i] != v && (node[i] != v + 1 || node[i] >= m)) return -1;
        v = node[i];
    }
    if (v != m - 1) return -1;
    for (int w = 0; w < m; ++w) mark[w] = -1;
    v = -1;
    for (int i = 0; i < k; ++i) {
        if (node[i] != v) ptr[v = node[i]] = entries;
        for (int e = indptr[rows[i]]; e < indptr[rows[i] + 1]; ++e) {
            if (indices[e] < 0 || indices[e] >= n) return -1;
            const int j = number[indices[e]];
            if (j < 0) continue;
            if (j >= k || rows[j] != indices[e]) return -1;
            const int w = node[j];
            if (mark[w] == v) continue;
            mark[w] = v;
            adjacent[entries++] = w;
        }
    }
    ptr[m] = entries;
    return entries;
}

// Where a column stands in a row with ascending columns; −1 if it does not
static int find(int column, const int *indices, int first, int end)
{
    int last = end;
    while (first < last) {
        const int middle = first + (last - first) / 2;
        if (indices[middle] < column)
            first = middle + 1;
        else
            last = middle;
    }
    return first < end && indices[first] == column ? first : -1;
}

// Where the entries on the diagonal of a matrix, (n, n), stand among all of its entries; −1 for a row
// without one. They are found fast in rows with ascending columns. place has room for n entries.
void find_diagonal(int n, const int *indptr, const int *indices, int *place)
{
    for (int i = 0; i < n; ++i) {
        place[i] = find(i, indices, indptr[i], indptr[i + 1]);
        for (int e = indptr[i]; e < indptr[i + 1] && place[i] < 0; ++e)
            if (indices[e] == i) place[i] = e;
    }
}

// A number that looks random, of either sign and a size from 1 to 2 (the end of SplitMix64)
static double random_number(uint64_t k)
{
    k = (k + 1) * 0x9e3779b97f4a7c15u;
    k = (k ^ (k >> 30)) * 0xbf58476d1ce4e5b9u;
    k = (k ^ (k >> 27)) * 0x94d049bb133111ebu;
    const double size = 1.0 + (double)(k >> 12) * 0x1p-52;
    return k & 1 ? size : -size;
}

// Whether a matrix A, (n, n), with ascending columns in each row is symmetric up to rounding:
//
//     |a_ij − a_ji| ≤ tolerance s_i s_j,  s_i² = |a_ii|, and no less than 1e-8 max_j |a_ij|.
//
// An entry that has no counterpart stands beside a zero. Entries are compared in the rows where
//
//     |Σ_j (a_ij − a_ji) y_j| > tolerance s_i,  |y_j| ≥ 1 / s_j,
//
// with random y: in the others none is off by more, unless several cancel. place has room for n
// entries, work for 3 n. Returns 1 if it is, 0 if it is not, or −1 if the columns do not ascend
// below n.
int is_symmetric(int n, const int *indptr, const int *indices, const double *a, double tolerance,
                 int *place, double *work)
{
    double *const s = work, *const y = work + n, *const z = y + n;
    find_diagonal(n, indptr, indices, place);
    for (int i = 0; i < n; ++i) {
        s[i] = place[i] < 0 ? 0.0 : fabs(a[place[i]]);
        for (int e = indptr[i]; e < indptr[i + 1] && s[i] == 0.0; ++e) s[i] = 1e-8 * fabs(a[e]);
        y[i] = random_number(i) / sqrt(fmax(s[i], DBL_MIN));
        z[i] = 0.0;
    }
    for (int i = 0; i < n; ++i) {
        double most = 0.0, sum = 0.0;
        int last = -1;
        for (int e = indptr[i]; e < indptr[i + 1]; last = indices[e++]) {
            const int j = indices[e];
            if (j <= last || j >= n) return -1;
            if (fabs(a[e]) > most) most = fabs(a[e]);
            sum += a[e] * y[j];
            z[j] -= a[e] * y[i];
        }
        z[i] += sum;
        s[i] = sqrt(fmax(s[i], 1e-8 * most));
    }
    for (int i = 0; i < n; ++i) {
        if (fabs(z[i]) <= tolerance * s[i]) continue;
        for (int e = indptr[i]; e < indptr[i + 1]; ++e) {
            const int j = indices[e], m = find(i, indices, indptr[j], indptr[j + 1]);
            const double skew = m < 0 ? a[e] : a[e] - a[m];
            if (!(fabs(skew) <= tolerance * s[i] * s[j])) return 0;
        }
    }
    return 1;
}
