// Copyright (C) 2026 the dolfinx_feti authors
//
// SPDX-License-Identifier: LGPL-3.0-or-later
//
// Sum of element matrices in a block matrix; data types: assembly.h.

#include <stdint.h>

#include "assembly.h"

// A += element. The blocks of the element matrix, and the adjacent blocks of each block of A, have
// to ascend: one pass over both finds the place of each sub-matrix. Returns 0, or 1 if two blocks
// of the element matrix are not adjacent in A; then a part of it has been added.
int add_element(const element_matrix *element, const block_matrix *A)
{
    const double *entries = element->values;
    for (int s = 0; s < element->count; ++s) {
        const int row_block = element->blocks[s];
        const int rows = A->width[row_block];
        const int64_t row_length = (A->start[row_block + 1] - A->start[row_block]) / rows;
        for (int i = 0; i < rows; ++i) {
            double *const row = A->values + A->start[row_block] + i * row_length;
            int pair = A->ptr[row_block];
            for (int t = 0; t < element->count; ++t) {
                const int column_block = element->blocks[t];
                const int columns = A->width[column_block];
                while (pair < A->ptr[row_block + 1] && A->adjacent[pair] != column_block) ++pair;
                if (pair == A->ptr[row_block + 1]) return 1;
                double *const target = row + A->column[pair];
                for (int j = 0; j < columns; ++j) target[j] += entries[j];
                entries += columns;
            }
        }
    }
    return 0;
}
