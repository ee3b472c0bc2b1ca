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

// K ← K + Σ_τ aᵀ b over m cells τ, each with a row a and a row b on its k nodes of bs dofs.
//
// node has the nodes of each cell, ascending, (m, k); a and b are (m, k bs). K is given row by row,
// for n nodes, with ascending columns; it has a place for all pairs of nodes of a cell, and the rows
// of a node have the same columns. Returns 0, or 1 if that does not hold; a part is added then.
int add_outer_products(int m, int k, int bs, int n, const int *node, const double *a,
                       const double *b, const int64_t *indptr, const int *indices, double *values)
{
    for (int cell = 0; cell < m; ++cell, node += k, a += k * bs, b += k * bs)
        for (int i = 0; i < k; ++i) {
            if (node[i] < 0 || node[i] >= n) return 1;
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
                for (int p = 0; p < bs; ++p) {
                    double *const entry = values + row[p] + (place - columns);
                    for (int q = 0; q < bs; ++q) entry[q] += a[i * bs + p] * b[j * bs + q];
                }
            }
        }
    return 0;
}
