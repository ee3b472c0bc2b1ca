// Copyright (C) 2026 the dolfinx_feti authors
//
// SPDX-License-Identifier: LGPL-3.0-or-later
//
// Declarations of assembled_product.c, which cffi parses, too: hence no include guard.
//
// A block of a symmetric matrix on b of its rows is stored as its lower triangle, row by row,
// (b (b + 1) / 2).

// Copy a block of S.
//   n:      order of S
//   S:      its lower triangle column by column, LAPACK's packed format, (n (n + 1) / 2)
//   b:      number of rows
//   rows:   rows of S, in any order, (b)
//   block:  the block on these rows, output, (b (b + 1) / 2)
void copy_block(int n, const double *S, int b, const int *rows, double *block);

// Add a block to the lower triangle of A, diagonal included.
//   n:      order of A
//   A:      the matrix column by column, (n, n)
//   b:      number of rows
//   rows:   rows of A, ascending, (b)
//   block:  the block on these rows, (b (b + 1) / 2)
void add_block(int n, float *A, int b, const int *rows, const double *block);
