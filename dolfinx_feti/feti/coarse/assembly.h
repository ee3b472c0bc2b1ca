// Copyright (C) 2026 the dolfinx_feti authors
//
// SPDX-License-Identifier: LGPL-3.0-or-later
//
// Declarations of assembly.c. cffi parses this file, too, which knows int64_t but no preprocessor:
// hence there is no include guard, and assembly.c includes <stdint.h>.

// A sparse matrix in dense blocks, the pattern of which is BlockPattern of assembly.py. Indices fit
// into 32 bits, as dofs do; the number of values may exceed them.
typedef struct {
    const int *width;     // number of dofs of each block, at least one, (blocks)
    const int *ptr;       // index of the first adjacent block of each block, (blocks + 1)
    const int *adjacent;  // adjacent blocks of each block, ascending, (ptr[blocks])
    const int *column;    // first column of each adjacent block within a row, (ptr[blocks])
    const int64_t *start; // index of the first value of each block, (blocks + 1)
    double *values;       // block by block, and row by row in a block, (start[blocks])
} block_matrix;

// The dense matrix of one subdomain. Its rows and columns are the dofs of some blocks.
typedef struct {
    int count;            // number of these blocks
    const int *blocks;    // the blocks, ascending, (count)
    const double *values; // row by row, (c_i, c_i)
} element_matrix;

int add_element(const element_matrix *element, const block_matrix *A);
