// Copyright (C) 2026 the dolfinx_feti authors
//
// SPDX-License-Identifier: LGPL-3.0-or-later

#include <float.h>
#include <math.h>
#include <stdint.h>
#include <stdlib.h>

// A number of each of LANES cells, and a mask of them, as vectors of GCC and Clang.
enum { LANES = 8 };
typedef double V __attribute__((vector_size(64)));
typedef int64_t L __attribute__((vector_size(64)));

#define BROADCAST(x) ((x) + (V){0.0})

// x where the mask is set, else y.
static inline V choose(L mask, V x, V y) { return (V)((mask & (L)x) | (~mask & (L)y)); }

// What a tape reads of LANES cells: coordinates X of the nodes in a number of dimensions, coefficients W
// and constants c; at each point the weight, det J, and the basis functions psi of the nodes; and of each
// element, with its number of dofs, the basis functions phi and their gradients B.
typedef struct {
    int dimensions, nodes;
    const V *X, *const *W;
    const double *c, *weight;
    const V *determinant;
    const double *psi, *const *phi;
    const V *const *B;
    const int *dofs;
} Cells;

// Execute a tape at points, with registers R. It stores A, (points, width).
typedef void Run(const int *tape, const Cells *cells, int points, V *R, int width, V *A);

// The tape of each quadrature rule, what executes them, and their vectors of registers.
typedef struct {
    void *run;  // a Run
    const int *const *tape;
    const double *c;
    int vectors;
} Program;
