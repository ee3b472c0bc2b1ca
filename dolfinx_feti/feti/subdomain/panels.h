// Copyright (C) 2026 the dolfinx_feti authors
//
// SPDX-License-Identifier: LGPL-3.0-or-later
//
// Interface between panels.py, which reads this file, and panels.c.

// Block-sparse columns W = (W_1, W_2, …), (n, c). Panel p has widths[p] columns, which are zero
// outside of its rows; a panel has each row once at most.
typedef struct {
    int n;                // rows of W
    int count;            // number of panels
    const int *starts;    // place in `rows` of the first row of each panel, and end, (count + 1)
    const int *rows;      // rows of all panels, (starts[count])
    const int *widths;    // columns of each panel, (count)
    const double *values; // of each panel (its rows, its columns), row by row
} panels;

// DGEMM of BLAS, with the arguments of Fortran.
typedef void (*dgemm_routine)(char *, char *, int *, int *, int *, double *, double *, int *,
                              double *, int *, double *, double *, int *);

// Y = S W. S: (n, n), symmetric, all entries. Y: (n, c), column by column. work: (n²).
void panels_premultiply(const panels *W, const double *S, double *Y, double *work,
                        dgemm_routine gemm);

// X = Wᵀ Y. Y: (n, r), column by column. X: (c, r), row by row. work: (n r). If is_symmetric, X is
// known to be symmetric (r = c): products yield the blocks on and below the diagonal, which are
// then copied to those above.
void panels_multiply_transposed(const panels *W, int r, const double *Y, double *X, double *work,
                                int is_symmetric, dgemm_routine gemm);

// e = Y z with sums in double precision. Y: (c, n) in single precision, row by row. z: (n). e: (c).
void rows_product(int c, int n, const float *Y, const double *z, double *e);
