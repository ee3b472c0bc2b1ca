// Copyright (C) 2026 the dolfinx_feti authors
//
// SPDX-License-Identifier: LGPL-3.0-or-later

#include <stdint.h>

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

// Where the columns of node j begin in the rows of node i, for the n nodes of each of m cells.
//
// The matrix is given row by row, with ascending columns, for N nodes with bs dofs each; node is
// (m, n), place (m, n, n). Returns 0, or 1 if there is no place for all of a pair of nodes, or the
// rows of a node differ.
int locate(int m, int n, int bs, int N, const int *node, const int64_t *indptr, const int *indices,
           int *place)
{
    for (int64_t at = 0; at < (int64_t)m * n; ++at) {
        const int i = node[at];
        if (i < 0 || i >= N) return 1;
        const int64_t *const row = indptr + (int64_t)i * bs;
        for (int p = 1; p < bs; ++p)
            if (row[p + 1] - row[p] != row[1] - row[0]) return 1;
        const int *const first = indices + row[0], *const last = indices + row[1];
        for (int j = 0; j < n; ++j) {
            const int64_t column = (int64_t)node[at / n * n + j] * bs;
            const int *const found = find(first, last, column);
            if (last - found < bs || found[0] != column || found[bs - 1] != column + bs - 1) return 1;
            *place++ = (int)(found - first);
        }
    }
    return 0;
}
