// Copyright (C) 2026 the dolfinx_feti authors
//
// SPDX-License-Identifier: LGPL-3.0-or-later

// The graph of m nodes, groups of consecutive rows: two are coupled if any of their rows are.
//
// Of a matrix given row by row, the k rows named count, in this order, and the columns with a
// number that is not negative: node[number[column]] is the node of a column, node[i] that of the
// i-th row. ptr has room for m + 1, adjacent for as many entries as these rows have, mark for m.
// Returns the number of entries of the graph.
int couple_nodes(int k, const int *rows, const int *indptr, const int *indices, const int *number,
                 const int *node, int m, int *ptr, int *adjacent, int *mark)
{
    int entries = 0, v = -1;
    for (int i = 0; i < m; ++i) mark[i] = -1;
    for (int i = 0; i < k; ++i) {
        if (node[i] != v) ptr[v = node[i]] = entries;
        for (int e = indptr[rows[i]]; e < indptr[rows[i] + 1]; ++e) {
            if (number[indices[e]] < 0) continue;
            int w = node[number[indices[e]]];
            if (mark[w] == v) continue;
            mark[w] = v;
            adjacent[entries++] = w;
        }
    }
    ptr[m] = entries;
    return entries;
}
