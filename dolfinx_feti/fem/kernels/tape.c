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
static M (*many_exp)(M), (*many_log)(M), (*many_pow)(M, M);

static void find_functions(void)
{
#if defined __AVX2__ || defined __AVX512F__
    void *const library = dlopen("libmvec.so.1", RTLD_NOW);
    if (!library) return;
    *(void **)&many_exp = dlsym(library, NAME(v, exp));
    *(void **)&many_log = dlsym(library, NAME(v, log));
    *(void **)&many_pow = dlsym(library, NAME(vv, pow));
#endif
}

// Σ a b − Σ a b + Σ c − Σ c at n points, whose sums are in the processor's registers.
static inline __attribute__((always_inline)) void sum(const int *p, int K, V *R, int n)
{
#define FOR for (int k = 0; k < n; ++k)
#define OF(i) R[(ptrdiff_t)K * p[i] + k]
    V *const to = R + (ptrdiff_t)K * p[0], s[4] = {{0.0}};
    const int *const end[] = {p + 5 + p[1], end[0] + p[2], end[1] + p[3], end[2] + p[4]};
    for (p += 5; p < end[0]; p += 2) FOR s[k] += OF(0) * OF(1);
    for (; p < end[1]; p += 2) FOR s[k] -= OF(0) * OF(1);
    for (; p < end[2]; ++p) FOR s[k] += OF(0);
    for (; p < end[3]; ++p) FOR s[k] -= OF(0);
    FOR to[k] = s[k];
}

// Execute instructions at K points, from the point q on.
static inline __attribute__((always_inline)) void at_points(const int *p, const Cells *cells, int q,
                                                            int K, V *R, int width, V *A)
{
#define EACH for (int k = 0; k < K; ++k)
#define AT(i) (R + (ptrdiff_t)K * p[i])
#define NUMBERS(i) ((double *)AT(i))
#define CASE(name, count, result)  \
    case name: {                   \
        V *const to = AT(0);       \
        EACH to[k] = (V)(result);  \
        p += count;                \
        break;                     \
    }
#define MANY(name, function)                                                                           \
    case name:                                                                                         \
        for (int l = 0; l < LANES * K; l += WIDE)                                                      \
            if (many_##function)                                                                       \
                *(M *)(NUMBERS(0) + l) = many_##function(*(M *)(NUMBERS(1) + l));                      \
            else                                                                                       \
                for (int i = l; i < l + WIDE; ++i) NUMBERS(0)[i] = function(NUMBERS(1)[i]);            \
        p += 2;                                                                                        \
        break;
#define x AT(1)[k]
#define y AT(2)[k]
#define z AT(3)[k]
#define t AT(4)[k]
    for (;;) switch (*p++) {
            case STORE:
                EACH A[(q + k) * width + p[1]] = p[2] ? -AT(0)[k] : AT(0)[k];
                p += 3;
                break;
            case NUMBER: {
                double number;
                memcpy(&number, p + 1, sizeof number);
                EACH AT(0)[k] = BROADCAST(number);
                p += 3;
                break;
            }
                CASE(CONSTANT, 2, BROADCAST(cells->c[p[1]]))
                CASE(WEIGHT, 1, BROADCAST(cells->weight[q + k]))
                CASE(DETERMINANT, 1, cells->determinant[q + k])
            case COORDINATE: {
                const int n = cells->nodes, d = cells->dimensions;
                EACH {
                    V s = {0.0};
                    for (int a = 0; a < n; ++a) s += cells->X[a * d + p[1]] * cells->psi[(q + k) * n + a];
                    AT(0)[k] = s;
                }
                p += 2;
                break;
            }
            case VALUE: {
                const int n = cells->dofs[p[4]];
                const V *const w = cells->W[p[1]] + p[2];
                EACH {
                    V s = {0.0};
                    for (int a = 0; a < n; ++a) s += w[a * p[3]] * cells->phi[p[4]][(q + k) * n + a];
                    AT(0)[k] = s;
                }
                p += 5;
                break;
            }
            case GRADIENT: {
                const int n = cells->dofs[p[4]], d = cells->dimensions, step = n * d;
                const V *const w = cells->W[p[1]] + p[2], *B = cells->B[p[4]] + q * step + p[5];
                int k = 0;
                for (; k + 4 <= K; k += 4, B += 4 * step) {  // four sums hide the time of an addition
                    V s[4] = {{0.0}};
                    for (int a = 0; a < n; ++a)
                        for (int i = 0; i < 4; ++i) s[i] += w[a * p[3]] * B[i * step + a * d];
                    for (int i = 0; i < 4; ++i) AT(0)[k + i] = s[i];
                }
                for (; k < K; ++k, B += step) {
                    V s = {0.0};
                    for (int a = 0; a < n; ++a) s += w[a * p[3]] * B[a * d];
                    AT(0)[k] = s;
                }
                p += 6;
                break;
            }
            case SUM: {
                int k = 0;
                for (; k + 4 <= K; k += 4) sum(p, K, R + k, 4);
                if (K - k == 3) sum(p, K, R + k, 3);
                else if (K - k == 2) sum(p, K, R + k, 2);
                else if (K - k == 1) sum(p, K, R + k, 1);
                p += 5 + p[1] + p[2] + p[3] + p[4];
                break;
            }
                CASE(ADD, 3, x + y)
                CASE(SUBTRACT, 3, x - y)
                CASE(MULTIPLY_ADD, 4, x * y + z)
                CASE(MULTIPLY_SUBTRACT, 4, x * y - z)
                CASE(SUBTRACT_PRODUCT, 4, z - x * y)
                CASE(PRODUCT_SUM, 5, x * y + z * t)
                CASE(PRODUCT_DIFFERENCE, 5, x * y - z * t)
                CASE(PRODUCT, 3, x * y)
                CASE(TRIPLE, 4, x * y * z)
                CASE(QUADRUPLE, 5, x * y * (z * t))
                CASE(QUOTIENT, 3, x / y)
                CASE(LT, 3, x < y)
                CASE(GT, 3, x > y)
                CASE(LE, 3, x <= y)
                CASE(GE, 3, x >= y)
                CASE(EQ, 3, x == y)
                CASE(NE, 3, x != y)
                CASE(AND, 3, (L)x & (L)y)
                CASE(OR, 3, (L)x | (L)y)
                CASE(NOT, 2, ~(L)x)
                CASE(CHOOSE, 4, choose((L)x, y, z))
                MANY(EXP, exp)
                MANY(LOG, log)
            case POWER:
                for (int l = 0; l < LANES * K; l += WIDE)
                    if (many_pow)
                        *(M *)(NUMBERS(0) + l) = many_pow(*(M *)(NUMBERS(1) + l), *(M *)(NUMBERS(2) + l));
                    else
                        for (int i = l; i < l + WIDE; ++i)
                            NUMBERS(0)[i] = pow(NUMBERS(1)[i], NUMBERS(2)[i]);
                p += 3;
                break;
            case FABS:
                for (int l = 0; l < LANES * K; ++l) NUMBERS(0)[l] = fabs(NUMBERS(1)[l]);
                p += 2;
                break;
            case SQRT:
                for (int l = 0; l < LANES * K; ++l) NUMBERS(0)[l] = sqrt(NUMBERS(1)[l]);
                p += 2;
                break;
            case FUNCTION:
                for (int l = 0; l < LANES * K; ++l) NUMBERS(0)[l] = functions[p[2]](NUMBERS(1)[l]);
                p += 3;
                break;
            case END: return;
            default: __builtin_unreachable();
        }
}

static void execute(const int *tape, const Cells *cells, int points, V *R, int width, V *A)
{
    for (int q = 0; q < points; q += *tape) {
        const int K = points - q < *tape ? points - q : *tape;
        if (K == 1)  // no loops over points
            at_points(tape + 1, cells, q, 1, R, width, A);
        else
            at_points(tape + 1, cells, q, K, R, width, A);
    }
}

// Return a Run.
void *interpreter(void)
{
    find_functions();
    return (void *)execute;
}
