// Copyright (C) 2026 the dolfinx_feti authors
//
// SPDX-License-Identifier: LGPL-3.0-or-later

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
