// Copyright (C) 2026 the dolfinx_feti authors
//
// SPDX-License-Identifier: LGPL-3.0-or-later

#include <stdint.h>
#include "../csr_matrix.h"
#include "condensation.h"

// y ← y + α x, (n,) each.
static void add_multiple(int n, double alpha, const double *x, double *y)
{
    for (int i = 0; i < n; ++i)
        y[i] += alpha * x[i];
}

// In the loops, node and offset point to those of the cell, K_up to the row of its matrix, slope to its matrix.
void subtract_products(const CsrMatrix *K, int n, const double *K_up, const double *slope)
{
    const int nodes = K->nodes;
    const int bs = K->bs;
    const int d = nodes * bs;
    const int *node = K->cell_nodes;
    const int *offset = K->offsets;
    double product[d]; // a row of K_up K_pp⁻¹ K_pu
    for (int cell = 0; cell < K->cells; ++cell) {
        for (int i = 0; i < nodes; ++i) {
            for (int r = 0; r < bs; ++r) {
                double *const row = K->values + K->indptr[(int64_t)node[i] * bs + r];
                for (int q = 0; q < d; ++q)
                    product[q] = K_up[0] * slope[q]; // dof 0 of the fields; the loop adds those of dofs 1 to n − 1
                for (int s = 1; s < n; ++s)
                    add_multiple(d, K_up[s], slope + s * d, product);
                for (int j = 0; j < nodes; ++j)
                    add_multiple(bs, -1.0, product + j * bs, row + offset[j]);
                K_up += n;
            }
            offset += nodes;
        }
        node += nodes;
        slope += d * n;
    }
}
