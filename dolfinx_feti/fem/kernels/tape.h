// Copyright (C) 2026 the dolfinx_feti authors
//
// SPDX-License-Identifier: LGPL-3.0-or-later

// The instructions of tape.py, each at POINTS: N points of a cell in each of GROUPS.

#include <dlfcn.h>
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

enum { LANES = 8, POINTS = N * GROUPS };

// A number of each of LANES cells, and a mask of them.
typedef double V __attribute__((vector_size(64)));
typedef int64_t L __attribute__((vector_size(64)));

#define BROADCAST(x) ((x) + (V){0.0})
#define UNROLL _Pragma("GCC unroll 32")
#define EACH UNROLL for (int k = 0; k < POINTS; ++k)

// Of φ, ∂φ/∂X_i, (nodes, 1 + GDIM, POINTS), a node has so many vectors.
enum { NODE = (1 + GDIM) * POINTS };

// What program.py makes of forms, which have size entries a cell; form f begins at begin[f]. Function 0 is x, element 0
// that of the geometry. A call is for m cells, the first ones or those of a list, with values of the functions at dofs
// of cells. A visit of CELLS has so many vectors R: det ∂x/∂ξ and the quadrature weights, (POINTS,); the tape's
// registers; from a place on φ of each element; w of each function, (nodes, block, GROUPS); the products of
// contract(); and the entries, (GROUPS, size).
typedef struct {
    int size, forms, elements, functions, chunks, affine, vectors, products, out, m;
    const int *begin, *nodes, *gradients, *tables, *element, *block, *phi, *w, *tape, *contractions, *cells, *const *dof;
    const double *weight, *table, *literals, *constants, *const *values;
} Program;

// An instruction at p of a tape, with registers in R, which it names by bytes. It calls the next one, which has no
// frame of its own on the stack.
typedef void Instruction(const int *p, V *R, const Program *program);
static Instruction INSTRUCTIONS;
static Instruction *const instructions[] = {INSTRUCTIONS};

#define INSTRUCTION(name) static void do_##name(const int *p, V *R, const Program *program)
#define NEXT(n) instructions[p[n]](p + (n) + 1, R, program)
#define AT(i) ((V *)((char *)R + p[i]))
#define NUMBERS(i) ((double *)AT(i))

// x where the mask is set, else y.
static inline V choose(L mask, V x, V y) { return (V)((mask & (L)x) | (~mask & (L)y)); }

// The name, how many numbers follow it on the tape, and the result.
#define SIMPLE(name, count, result) \
    INSTRUCTION(name)               \
    {                               \
        V *const to = AT(0);        \
        EACH to[k] = (V)(result);   \
        NEXT(count);                \
    }
#define x AT(1)[k]
#define y AT(2)[k]
#define z AT(3)[k]
SIMPLE(weight, 1, R[POINTS + k])
SIMPLE(determinant, 1, R[k])
SIMPLE(number, 2, BROADCAST(program->literals[p[1]]))
SIMPLE(constant, 2, BROADCAST(program->constants[p[1]]))
SIMPLE(product, 3, x * y)
SIMPLE(quotient, 3, x / y)
SIMPLE(lt, 3, x < y)
SIMPLE(gt, 3, x > y)
SIMPLE(le, 3, x <= y)
SIMPLE(ge, 3, x >= y)
SIMPLE(eq, 3, x == y)
SIMPLE(ne, 3, x != y)
SIMPLE(and_condition, 3, (L)x & (L)y)
SIMPLE(or_condition, 3, (L)x | (L)y)
SIMPLE(not_condition, 2, ~(L)x)
SIMPLE(abs, 2, (L)x & INT64_MAX)
SIMPLE(choose, 4, choose((L)x, y, z))
#undef x
#undef y
#undef z

INSTRUCTION(end) { (void)p, (void)R, (void)program; }

// Σ_a w[a, c] ∂_d φ_a for a function, its component c and their number, its element, d, and the element's nodes.
INSTRUCTION(interpolate)
{
    const V *const w = R + program->w[p[1]] + p[2] * GROUPS, *const phi = R + program->phi[p[4]] + p[5] * POINTS;
    V *const to = AT(0), s[POINTS];
    EACH s[k] = (V){0.0};
    for (int a = 0; a < p[6]; ++a) EACH s[k] += w[a * p[3] * GROUPS + k / N] * phi[a * NODE + k];
    EACH to[k] = s[k];
    NEXT(7);
}

// Σ a b − Σ a b + Σ c − Σ c, in the processor's registers.
INSTRUCTION(sum)
{
    V *const to = AT(0), s[POINTS];
    EACH s[k] = (V){0.0};
    const int *const end[] = {p + 5 + p[1], end[0] + p[2], end[1] + p[3], end[2] + p[4]};
    for (p += 5; p < end[0]; p += 2) EACH s[k] += AT(0)[k] * AT(1)[k];
    for (; p < end[1]; p += 2) EACH s[k] -= AT(0)[k] * AT(1)[k];
    for (; p < end[2]; ++p) EACH s[k] += AT(0)[k];
    for (; p < end[3]; ++p) EACH s[k] -= AT(0)[k];
    EACH to[k] = s[k];
    NEXT(0);
}

INSTRUCTION(sqrt)
{
    for (int l = 0; l < LANES * POINTS; ++l) NUMBERS(0)[l] = sqrt(NUMBERS(1)[l]);
    NEXT(2);
}

// Functions of WIDE numbers at once, which glibc's libmvec has, or NULL.
#ifdef __AVX512F__
enum { WIDE = 8 };
#define PREFIX "_ZGVeN8"
#else
enum { WIDE = 4 };
#define PREFIX "_ZGVdN4"
#endif
typedef double M __attribute__((vector_size(8 * WIDE)));
static double (*const functions[])(double) = {FUNCTIONS};
static const char *const names[] = {NAMES};
static M (*many_functions[sizeof names / sizeof *names])(M), (*many_powers)(M, M);

__attribute__((constructor)) static void find_functions(void)
{
#ifdef __AVX2__
    void *const library = dlopen("libmvec.so.1", RTLD_NOW);
    if (!library) return;
    for (size_t i = 0; i < sizeof names / sizeof *names; ++i)
        *(void **)&many_functions[i] = dlsym(library, names[i]);
    *(void **)&many_powers = dlsym(library, PREFIX "vv_pow");
#endif
}

#define WIDELY(name, count, many, several, one)                         \
    INSTRUCTION(name)                                                   \
    {                                                                   \
        for (int l = 0; l < LANES * POINTS; l += WIDE)                  \
            if (many)                                                   \
                *(M *)(NUMBERS(0) + l) = several;                       \
            else                                                        \
                for (int i = l; i < l + WIDE; ++i) NUMBERS(0)[i] = one; \
        NEXT(count);                                                    \
    }
#define MANY(i) *(M *)(NUMBERS(i) + l)
WIDELY(function, 3, many_functions[p[2]], many_functions[p[2]](MANY(1)), functions[p[2]](NUMBERS(1)[i]))
WIDELY(power, 3, many_powers, many_powers(MANY(1), MANY(2)), pow(NUMBERS(1)[i], NUMBERS(2)[i]))
