// Copyright (C) 2026 the dolfinx_feti authors
//
// SPDX-License-Identifier: LGPL-3.0-or-later

// A matrix in compressed rows, and where the entries of cells are in it. A cell has `nodes` nodes, a node bs dofs.
// Include <stdint.h> before: cffi reads this file, too, and takes no directives.
typedef struct {
    int cells;
    int nodes; // of a cell
    int bs;
    const int *cell_nodes; // (cells, nodes)
    const int *offsets;    // offset of the columns of node j in each row of node i, (cells, nodes, nodes)
    const int64_t *indptr; // start of each row in values, (rows + 1,)
    double *values;
} CsrMatrix;
