// Copyright (C) 2026 the dolfinx_feti authors
//
// SPDX-License-Identifier: LGPL-3.0-or-later

#include <math.h>

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

// Where the entries on the diagonal of a matrix, (n, n), stand among all of its entries; −1 for a row
// without one. They are found fast in rows with ascending columns. place has room for n entries.
void find_diagonal(int n, const int *indptr, const int *indices, int *place)
{
    for (int i = 0; i < n; ++i) {
        int first = indptr[i], last = indptr[i + 1];
        while (first < last) {
            const int middle = first + (last - first) / 2;
            if (indices[middle] < i)
                first = middle + 1;
            else
                last = middle;
        }
        place[i] = first < indptr[i + 1] && indices[first] == i ? first : -1;
        for (int e = indptr[i]; e < indptr[i + 1] && place[i] < 0; ++e)
            if (indices[e] == i) place[i] = e;
    }
}

// Whether a matrix, (n, n), with ascending columns in each row is symmetric up to rounding:
//
//     |a_ij − a_ji| ≤ tolerance √(s_i s_j),  s_i = |a_ii|, and no less than 1e-8 max_j |a_ij|.
//
// An entry that has no counterpart stands beside a zero. next has room for n entries, s for n.
// Rows are read in order: what is next in row j is the entry that row i < j has to be compared
// with; it is fetched some entries ahead. Returns 1 if it is, 0 if it is not, or −1 if the columns do
// not ascend below n.
int is_symmetric(int n, const int *indptr, const int *indices, const double *a, double tolerance,
                 int *next, double *s)
{
    enum { AHEAD = 24 };
    for (int i = 0; i < n; ++i) {
        double most = 0.0, diagonal = 0.0;
        int last = -1;
        for (int e = indptr[i]; e < indptr[i + 1]; last = indices[e++]) {
            if (indices[e] <= last || indices[e] >= n) return -1;
            if (fabs(a[e]) > most) most = fabs(a[e]);
            if (indices[e] == i) diagonal = fabs(a[e]);
        }
        s[i] = sqrt(fmax(diagonal, 1e-8 * most));
        next[i] = indptr[i];
    }
    for (int i = 0; i < n; ++i) {
        for (int e = next[i]; e < indptr[i + 1]; ++e) {
            const int j = indices[e];
            if (e + AHEAD < indptr[n]) {
                const int m = next[indices[e + AHEAD]];
                __builtin_prefetch(indices + m), __builtin_prefetch(a + m);
            }
            if (j < i) {  // row j has no entry for it
                if (!(fabs(a[e]) <= tolerance * s[i] * s[j])) return 0;
                continue;
            }
            if (j == i) continue;
            int m = next[j];
            for (; m < indptr[j + 1] && indices[m] < i; ++m)
                if (!(fabs(a[m]) <= tolerance * s[j] * s[indices[m]])) return 0;
            const int both = m < indptr[j + 1] && indices[m] == i;
            next[j] = m + both;
            const double skew = both ? a[e] - a[m] : a[e];
            if (!(fabs(skew) <= tolerance * s[i] * s[j])) return 0;
        }
    }
    return 1;
}
