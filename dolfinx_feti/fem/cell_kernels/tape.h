// Copyright (C) 2026 the dolfinx_feti authors
//
// SPDX-License-Identifier: LGPL-3.0-or-later

// The instructions of tape.py. A register has POINTS vectors: one for each of N points in each of GROUPS groups of cells.
// The headers of the C library that kernel.c needs are included here, too.

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
#define FOR_POINTS(k) UNROLL for (int k = 0; k < POINTS; ++k)

// Vectors from one node to the next in φ, ∂φ/∂X of an element, (nodes, 1 + GDIM, POINTS).
enum { NODE_STRIDE = (1 + GDIM) * POINTS };

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

// An instruction without operands in registers, which computes vector k of its result. The result is an expression in k
// and in p, R and program of the instruction. `count` is the number of its words, the result's included.
#define VALUE(name, count, result)                      \
    INSTRUCTION(name)                                   \
    {                                                   \
        V *const to = AT(0);                            \
        FOR_POINTS(k)                                   \
            to[k] = result;                             \
        NEXT(count);                                    \
    }
VALUE(weight, 1, R[POINTS + k])
VALUE(determinant, 1, R[k])
VALUE(number, 2, BROADCAST(program->literals[p[1]]))
VALUE(constant, 2, BROADCAST(program->constants[p[1]]))

// An instruction of one operand or two. The result is an expression in their vectors, whose names are arguments, too.
#define UNARY(name, x, result)                          \
    INSTRUCTION(name)                                   \
    {                                                   \
        V *const to = AT(0);                            \
        const V *const operand = AT(1);                 \
        FOR_POINTS(k) {                                 \
            const V x = operand[k];                     \
            to[k] = (V)(result);                        \
        }                                               \
        NEXT(2);                                        \
    }
#define BINARY(name, x, y, result)                      \
    INSTRUCTION(name)                                   \
    {                                                   \
        V *const to = AT(0);                            \
        const V *const first = AT(1);                   \
        const V *const second = AT(2);                  \
        FOR_POINTS(k) {                                 \
            const V x = first[k];                       \
            const V y = second[k];                      \
            to[k] = (V)(result);                        \
        }                                               \
        NEXT(3);                                        \
    }
BINARY(product, x, y, x * y)
BINARY(quotient, x, y, x / y)
BINARY(lt, x, y, x < y)
BINARY(gt, x, y, x > y)
BINARY(le, x, y, x <= y)
BINARY(ge, x, y, x >= y)
BINARY(eq, x, y, x == y)
BINARY(ne, x, y, x != y)
BINARY(and_condition, x, y, (L)x & (L)y)
BINARY(or_condition, x, y, (L)x | (L)y)
UNARY(not_condition, x, ~(L)x)
UNARY(abs, x, (L)x & INT64_MAX) // without the sign bit

// x where the mask is set, else y. Operands: result, mask, x, y.
INSTRUCTION(choose)
{
    V *const to = AT(0);
    const V *const condition = AT(1);
    const V *const x = AT(2);
    const V *const y = AT(3);
    FOR_POINTS(k) {
        const L mask = (L)condition[k];
        to[k] = (V)((mask & (L)x[k]) | (~mask & (L)y[k]));
    }
    NEXT(4);
}

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
    FOR_POINTS(k) sum[k] = (V){0.0};
    for (int a = 0; a < nodes; ++a)
        FOR_POINTS(k) sum[k] += w[a * components * GROUPS + k / N] * phi[a * NODE_STRIDE + k];
    FOR_POINTS(k) to[k] = sum[k];
    NEXT(7);
}

// Σ a b − Σ a b + Σ c − Σ c, in the processor's registers. Operands: result, the numbers of values of the four sums (a
// product has two), and the values, one sum after the other. p moves along the values, so AT(0) is the present one.
INSTRUCTION(sum)
{
    V *const to = AT(0);
    V s[POINTS];
    FOR_POINTS(k) s[k] = (V){0.0};
    const int *const end_of_added_products = p + 5 + p[1];
    const int *const end_of_subtracted_products = end_of_added_products + p[2];
    const int *const end_of_added = end_of_subtracted_products + p[3];
    const int *const end_of_subtracted = end_of_added + p[4];
    p += 5;
    for (; p < end_of_added_products; p += 2)
        FOR_POINTS(k) s[k] += AT(0)[k] * AT(1)[k];
    for (; p < end_of_subtracted_products; p += 2)
        FOR_POINTS(k) s[k] -= AT(0)[k] * AT(1)[k];
    for (; p < end_of_added; ++p)
        FOR_POINTS(k) s[k] += AT(0)[k];
    for (; p < end_of_subtracted; ++p)
        FOR_POINTS(k) s[k] -= AT(0)[k];
    FOR_POINTS(k) to[k] = s[k];
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
typedef double Wide __attribute__((vector_size(8 * WIDE)));
static double (*const functions[])(double) = {FUNCTIONS};
static const char *const names[] = {NAMES};
static Wide (*vector_functions[sizeof names / sizeof *names])(Wide);
static Wide (*vector_power)(Wide, Wide);

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
                *(Wide *)(NUMBERS(0) + l) = of_vector;                 \
            else                                                       \
                for (int i = l; i < l + WIDE; ++i)                     \
                    NUMBERS(0)[i] = of_number;                         \
        NEXT(count);                                                   \
    }
#define VECTOR(i) *(Wide *)(NUMBERS(i) + l)
BY_VECTORS(function, 3, vector_functions[p[2]], vector_functions[p[2]](VECTOR(1)), functions[p[2]](NUMBERS(1)[i]))
BY_VECTORS(power, 3, vector_power, vector_power(VECTOR(1), VECTOR(2)), pow(NUMBERS(1)[i], NUMBERS(2)[i]))
