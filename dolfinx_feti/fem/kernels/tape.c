// Copyright (C) 2026 the dolfinx_feti authors
//
// SPDX-License-Identifier: LGPL-3.0-or-later

#include <dlfcn.h>
#include <string.h>
#include "tape.h"
/* generated */

// exp, log and pow of WIDE numbers at once, which glibc's libmvec has, or NULL.
#ifdef __AVX512F__
enum { WIDE = 8 };
#define NAME(arguments, name) "_ZGVeN8" #arguments "_" #name
#else
enum { WIDE = 4 };
#define NAME(arguments, name) "_ZGVdN4" #arguments "_" #name
#endif
typedef double M __attribute__((vector_size(8 * WIDE)));
static M (*many_exp)(M), (*many_log)(M), (*many_power)(M, M);

static void find_functions(void)
{
#if defined __AVX2__ || defined __AVX512F__
    void *const library = dlopen("libmvec.so.1", RTLD_NOW);
    if (!library) return;
    *(void **)&many_exp = dlsym(library, NAME(v, exp));
    *(void **)&many_log = dlsym(library, NAME(v, log));
    *(void **)&many_power = dlsym(library, NAME(vv, pow));
#endif
}

#define AT(i) ((V *)((char *)R + p[i]))
#define NUMBERS(i) ((double *)AT(i))
#define EACH _Pragma("GCC unroll 32") for (int k = 0; k < POINTS; ++k)

// An instruction at POINTS. It calls the next one, which has no frame of its own on the stack.
#define INSTRUCTION(name) static void do_##name(const int *p, V *R, const Data *data, ptrdiff_t q)
#define NEXT(n) instructions[p[n]](p + (n) + 1, R, data, q)

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
#define t AT(4)[k]
SIMPLE(constant, 2, BROADCAST(data->constants[p[1]]))
SIMPLE(input, 2, data->inputs[p[1] * data->points + q + k])
SIMPLE(add, 3, x + y)
SIMPLE(subtract, 3, x - y)
SIMPLE(multiply_add, 4, x * y + z)
SIMPLE(multiply_subtract, 4, x * y - z)
SIMPLE(subtract_product, 4, z - x * y)
SIMPLE(product_sum, 5, x * y + z * t)
SIMPLE(product_difference, 5, x * y - z * t)
SIMPLE(product, 3, x * y)
SIMPLE(quotient, 3, x / y)
SIMPLE(lt, 3, x < y)
SIMPLE(gt, 3, x > y)
SIMPLE(le, 3, x <= y)
SIMPLE(ge, 3, x >= y)
SIMPLE(eq, 3, x == y)
SIMPLE(ne, 3, x != y)
SIMPLE(and, 3, (L)x & (L)y)
SIMPLE(or, 3, (L)x | (L)y)
SIMPLE(not, 2, ~(L)x)
SIMPLE(choose, 4, choose((L)x, y, z))
#undef x
#undef y
#undef z
#undef t

INSTRUCTION(end) { (void)p, (void)R, (void)data, (void)q; }

INSTRUCTION(store)
{
    V *const to = data->A + p[1] * data->points + q;
    if (p[2])
        EACH to[k] = -AT(0)[k];
    else
        EACH to[k] = AT(0)[k];
    NEXT(3);
}

INSTRUCTION(number)
{
    double x;
    memcpy(&x, p + 1, sizeof x);
    EACH AT(0)[k] = BROADCAST(x);
    NEXT(3);
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

#define WIDELY(name, count, many, one)                                              \
    INSTRUCTION(name)                                                               \
    {                                                                               \
        for (int l = 0; l < LANES * POINTS; l += WIDE)                              \
            if (many_##name)                                                        \
                *(M *)(NUMBERS(0) + l) = many;                                      \
            else                                                                    \
                for (int i = l; i < l + WIDE; ++i) NUMBERS(0)[i] = one;             \
        NEXT(count);                                                                \
    }
#define MANY(i) *(M *)(NUMBERS(i) + l)
WIDELY(exp, 2, many_exp(MANY(1)), exp(NUMBERS(1)[i]))
WIDELY(log, 2, many_log(MANY(1)), log(NUMBERS(1)[i]))
WIDELY(power, 3, many_power(MANY(1), MANY(2)), pow(NUMBERS(1)[i], NUMBERS(2)[i]))

#define SINGLY(name, count, one)                                              \
    INSTRUCTION(name)                                                         \
    {                                                                         \
        for (int l = 0; l < LANES * POINTS; ++l) NUMBERS(0)[l] = one;         \
        NEXT(count);                                                          \
    }
SINGLY(fabs, 2, fabs(NUMBERS(1)[l]))
SINGLY(sqrt, 2, sqrt(NUMBERS(1)[l]))
SINGLY(function, 3, functions[p[2]](NUMBERS(1)[l]))

static void execute(const int *tape, V *R, const Data *data)
{
    for (ptrdiff_t q = 0; q < data->points; q += POINTS) instructions[*tape](tape + 1, R, data, q);
}

// Return a Run.
void *interpreter(void)
{
    find_functions();
    return (void *)execute;
}
