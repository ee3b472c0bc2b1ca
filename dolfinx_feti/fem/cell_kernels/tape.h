// Copyright (C) 2026 the dolfinx_feti authors
//
// SPDX-License-Identifier: LGPL-3.0-or-later

// The instructions of tape.py. A register has POINTS vectors: one for each of N points in each of GROUPS groups of cells.
// The C library's headers of kernel.c, too, are included here.

#include <dlfcn.h>
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

enum { LANES = 8, POINTS = N * GROUPS };

// A vector, a number of each of LANES cells, and a mask of them.
typedef double V __attribute__((vector_size(64)));
typedef int64_t L __attribute__((vector_size(64)));

#define BROADCAST(x) ((x) + (V){0.0})
#define UNROLL _Pragma("GCC unroll 32")
#define EACH UNROLL for (int k = 0; k < POINTS; ++k)

// Vectors of a node in φ, ∂φ/∂X of an element, (nodes, 1 + GDIM, POINTS).
enum { NODE = (1 + GDIM) * POINTS };

// An instruction with its operands at p; operands that are registers are offsets in bytes from R. It calls the next
// instruction, as its last statement. gcc and clang turn such a call into a jump from -O2 on. With a compiler that does
// not, the stack would grow with the length of the tape.
typedef void Instruction(const int *p, V *R, const Program *program);
static Instruction INSTRUCTIONS;
static Instruction *const instructions[] = {INSTRUCTIONS};

#define INSTRUCTION(name) static void do_##name(const int *p, V *R, const Program *program)
#define NEXT(n) instructions[p[n]](p + (n) + 1, R, program)
#define AT(i) ((V *)((char *)R + p[i]))
#define NUMBERS(i) ((double *)AT(i))

// x where the mask is set, else y.
static inline V choose(L mask, V x, V y)
{
    return (V)((mask & (L)x) | (~mask & (L)y));
}

// An instruction that computes vector k of its result from vector k of its operands x, y, z. `count` is the number of
// its operands, the result included. x, y and z are macros, which contain k and p of the instruction.
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

// The last instruction.
INSTRUCTION(end)
{
    (void)p;
    (void)R;
    (void)program;
}

// Σ_a w[a, component] ∂_d φ_a. Operands: result, function, component, number of components of the function, element,
// derivative d (0 for the value), nodes of the element.
INSTRUCTION(interpolate)
{
    V *const to = AT(0);
    const V *const w = R + program->dofs_at[p[1]] + p[2] * GROUPS;
    const V *const phi = R + program->basis_at[p[4]] + p[5] * POINTS;
    const int components = p[3];
    const int nodes = p[6];
    V sum[POINTS];
    EACH sum[k] = (V){0.0};
    for (int a = 0; a < nodes; ++a)
        EACH sum[k] += w[a * components * GROUPS + k / N] * phi[a * NODE + k];
    EACH to[k] = sum[k];
    NEXT(7);
}

// Σ a b − Σ a b + Σ c − Σ c, in the processor's registers. Operands: result, the numbers of values of the four sums (a
// product has two), and the values, one sum after the other. p moves along the values, so AT(0) is the present one.
INSTRUCTION(sum)
{
    V *const to = AT(0);
    V s[POINTS];
    EACH s[k] = (V){0.0};
    const int *const end_of_added_products = p + 5 + p[1];
    const int *const end_of_subtracted_products = end_of_added_products + p[2];
    const int *const end_of_added = end_of_subtracted_products + p[3];
    const int *const end_of_subtracted = end_of_added + p[4];
    p += 5;
    for (; p < end_of_added_products; p += 2)
        EACH s[k] += AT(0)[k] * AT(1)[k];
    for (; p < end_of_subtracted_products; p += 2)
        EACH s[k] -= AT(0)[k] * AT(1)[k];
    for (; p < end_of_added; ++p)
        EACH s[k] += AT(0)[k];
    for (; p < end_of_subtracted; ++p)
        EACH s[k] -= AT(0)[k];
    EACH to[k] = s[k];
    NEXT(0);
}

INSTRUCTION(sqrt)
{
    for (int l = 0; l < LANES * POINTS; ++l)
        NUMBERS(0)[l] = sqrt(NUMBERS(1)[l]);
    NEXT(2);
}

// Vector functions of glibc's libmvec for WIDE numbers; NULL if this machine has none: then one number after the other.
// PREFIX is that of glibc's names: "e" for AVX-512 or "d" for AVX2, "N" without a mask, and the number of doubles; "v" or
// "vv" for one or two vectors follows. Their errors are up to 4 units in the last place, those of libm below 1.
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
static M (*vector_functions[sizeof names / sizeof *names])(M);
static M (*vector_power)(M, M);

// Look the vector functions up when the library is loaded.
__attribute__((constructor)) static void find_functions(void)
{
#ifdef __AVX2__
    void *const library = dlopen("libmvec.so.1", RTLD_NOW);
    if (!library)
        return;
    for (size_t i = 0; i < sizeof names / sizeof *names; ++i)
        *(void **)&vector_functions[i] = dlsym(library, names[i]);
    *(void **)&vector_power = dlsym(library, PREFIX "vv_pow");
#endif
}

// An instruction that computes WIDE numbers from l on by a vector function, or each number i if there is none. The last
// two arguments are expressions in l or i, and in p.
#define BY_VECTORS(name, count, vector_function, of_vector, of_number) \
    INSTRUCTION(name)                                                  \
    {                                                                  \
        for (int l = 0; l < LANES * POINTS; l += WIDE)                 \
            if (vector_function)                                       \
                *(M *)(NUMBERS(0) + l) = of_vector;                    \
            else                                                       \
                for (int i = l; i < l + WIDE; ++i)                     \
                    NUMBERS(0)[i] = of_number;                         \
        NEXT(count);                                                   \
    }
#define VECTOR(i) *(M *)(NUMBERS(i) + l)
BY_VECTORS(function, 3, vector_functions[p[2]], vector_functions[p[2]](VECTOR(1)), functions[p[2]](NUMBERS(1)[i]))
BY_VECTORS(power, 3, vector_power, vector_power(VECTOR(1), VECTOR(2)), pow(NUMBERS(1)[i], NUMBERS(2)[i]))
