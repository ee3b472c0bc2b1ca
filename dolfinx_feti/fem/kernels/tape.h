// Copyright (C) 2026 the dolfinx_feti authors
//
// SPDX-License-Identifier: LGPL-3.0-or-later

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

// A number of each of LANES cells, and a mask of them, as vectors of GCC and Clang.
enum { LANES = 8 };
typedef double V __attribute__((vector_size(64)));
typedef int64_t L __attribute__((vector_size(64)));

#define BROADCAST(x) ((x) + (V){0.0})

// x where the mask is set, else y.
static inline V choose(L mask, V x, V y) { return (V)((mask & (L)x) | (~mask & (L)y)); }

// What a tape reads at a number of points, constants and inputs, (·, points); and A, (·, points), which it
// stores.
typedef struct {
    ptrdiff_t points;
    const double *constants;
    const V *inputs;
    V *A;
} Data;

// An instruction of a tape, whose numbers are at p, with registers R, from the point q on.
typedef void Instruction(const int *p, V *R, const Data *data, ptrdiff_t q);

// Execute a tape.
typedef void Run(const int *tape, V *R, const Data *data);

// The tape of each quadrature rule, what executes it, and the vectors of their inputs and registers.
typedef struct {
    void *const *run;  // of a Run each
    const int *const *tape;
    const double *constants;
    int vectors;
} Program;
