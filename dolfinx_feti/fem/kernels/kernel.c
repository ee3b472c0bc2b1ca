// Copyright (C) 2026 the dolfinx_feti authors
//
// SPDX-License-Identifier: LGPL-3.0-or-later

#include "tape.h"

// K ← J⁻¹; returns det J.
__attribute__((unused)) static V inverse1(const V *J, V *K)
{
    K[0] = 1.0 / J[0];
    return J[0];
}

__attribute__((unused)) static V inverse2(const V *J, V *K)
{
    const V det = J[0] * J[3] - J[1] * J[2], r = 1.0 / det;
    K[0] = J[3] * r;
    K[1] = -J[1] * r;
    K[2] = -J[2] * r;
    K[3] = J[0] * r;
    return det;
}

__attribute__((unused)) static V inverse3(const V *J, V *K)
{
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) {
            const int k = (i + 1) % 3, l = (i + 2) % 3, m = (j + 1) % 3, n = (j + 2) % 3;
            K[j * 3 + i] = J[k * 3 + m] * J[l * 3 + n] - J[k * 3 + n] * J[l * 3 + m];
        }
    const V det = J[0] * K[0] + J[1] * K[3] + J[2] * K[6], r = 1.0 / det;
    for (int i = 0; i < 9; ++i) K[i] *= r;
    return det;
}

// J ← ∂x/∂ξ of nodes x, (n, d), each after a step, with ∂ψ/∂ξ, (n, d).
static inline void jacobian(int n, int d, const V *x, int step, const double *dpsi, V *J)
{
    for (int i = 0; i < d; ++i)
        for (int j = 0; j < d; ++j) {
            V sum = {0.0};
            for (int a = 0; a < n; ++a) sum += x[(a * d + i) * step] * dpsi[a * d + j];
            J[i * d + j] = sum;
        }
}

// B ← ∂φ/∂X = Kᵀ ∂φ/∂ξ of n basis functions, (n, d), each after a step.
__attribute__((unused)) static inline void gradients(int n, int d, const double *dphi, const V *K, V *B,
                                                     int step)
{
    for (int a = 0; a < n; ++a)
        for (int i = 0; i < d; ++i) {
            V sum = {0.0};
            for (int j = 0; j < d; ++j) sum += dphi[a * d + j] * K[j * d + i];
            B[(a * d + i) * step] = sum;
        }
}

// H[c, i] ← Σ_a w[a, c] B[a, i] with n basis functions, bs components, d directions; B is an expression in a
// and i. There is space for H at the points of all groups.
#define UNROLL _Pragma("GCC unroll 32")
#define INTERPOLATE(n, bs, d, w, B, H)                                      \
    do {                                                                    \
        V sum[(bs) * (d)];                                                  \
        UNROLL for (int j = 0; j < (bs) * (d); ++j) sum[j] = (V){0.0};      \
        for (int a = 0; a < (n); ++a)                                       \
            UNROLL for (int c = 0; c < (bs); ++c)                           \
                UNROLL for (int i = 0; i < (d); ++i)                        \
                    sum[c * (d) + i] += (w)[(a * (bs) + c) * GROUPS] * (B); \
        UNROLL for (int j = 0; j < (bs) * (d); ++j) (H)[j * COLUMNS] = sum[j]; \
    } while (0)

// The code that kernel.py generates has its place here: NODES of a cell's geometry in GDIM
// dimensions; a number of COEFFICIENTS, with NODES_OF a cell and BLOCK_OF components; FORMS, each of
// which begins at FIRST among the SIZE entries of a cell; dofs in a BLOCK_OF_ROWS of the first form;
// and tabulate(), which adds to these entries what follows from the factors that tapes compute.
/* generated */

// Cells that are visited at a time.
enum { CELLS = LANES * GROUPS };

// What they gather, and the entries of their forms.
typedef struct {
    V *x, *w[COEFFICIENTS + 1], *out, *registers;
} Lanes;

static int create_lanes(Lanes *lanes, const Program *program)
{
    size_t n = GROUPS * (NODES * GDIM + SIZE) + program->vectors;
    for (int f = 0; f < COEFFICIENTS; ++f) n += GROUPS * NODES_OF[f] * BLOCK_OF[f];
    lanes->x = aligned_alloc(sizeof(V), n * sizeof(V));
    if (!lanes->x) return 1;
    V *next = lanes->x + GROUPS * NODES * GDIM;
    for (int f = 0; f < COEFFICIENTS; next += GROUPS * NODES_OF[f] * BLOCK_OF[f], ++f) lanes->w[f] = next;
    lanes->out = next;
    lanes->registers = next + GROUPS * SIZE;
    return 0;
}

// to[node, component, ·] ← the values of LANES cells at their dofs, n a cell, each with components out of so
// many values.
static inline void gather(int n, int components, int values, const double *from, const int *dof,
                          const int64_t *cell, V *to)
{
    for (int a = 0; a < n; ++a) {
        const double *at[LANES];
        for (int l = 0; l < LANES; ++l) at[l] = from + (int64_t)dof[cell[l] * n + a] * values;
        for (int i = 0; i < components; ++i, to += GROUPS) {
            V x;
            for (int l = 0; l < LANES; ++l) x[l] = at[l][i];
            *to = x;
        }
    }
}

// Tabulate cells from place first on, of m places in all, and return them; the last one fills up the
// lanes. The cells are all from 0 on, or those of a list.
static void visit(const Lanes *lanes, int first, int m, const int *list, const double *x,
                  const int *node, const double *const *w, const int *const *dof, const Program *program, int64_t *cells)
{
    for (int c = 0; c < CELLS; ++c) {
        const int place = first + c < m ? first + c : m - 1;
        cells[c] = list ? list[place] : place;
    }
    for (int g = 0; g < GROUPS; ++g) {
        gather(NODES, GDIM, 3, x, node, cells + g * LANES, lanes->x + g);
        for (int f = 0; f < COEFFICIENTS; ++f)
            gather(NODES_OF[f], BLOCK_OF[f], BLOCK_OF[f], w[f], dof[f], cells + g * LANES, lanes->w[f] + g);
    }
    for (int i = 0; i < GROUPS * SIZE; ++i) lanes->out[i] = (V){0.0};
    tabulate(lanes->x, (const V *const *)lanes->w, program, lanes->registers, lanes->out);
}

// out[f] ← the entries of form f in m cells, cell by cell, with the coordinates x, (·, 3), the
// coefficients w. The cells are the first ones, or those of a list, if there is
// one. Returns 0, or 1 without memory.
int evaluate(int m, const int *list, const double *x, const int *node, const double *const *w, const int *const *dof,
             const Program *program, double *const *out)
{
    Lanes lanes;
    int64_t cell[CELLS];
    if (create_lanes(&lanes, program)) return 1;
    for (int first = 0; first < m; first += CELLS) {
        visit(&lanes, first, m, list, x, node, w, dof, program, cell);
        for (int f = 0; f < FORMS; ++f) {
            const int size = FIRST[f + 1] - FIRST[f];
            double *to = out[f] + (int64_t)first * size;
            for (int c = 0; c < CELLS && first + c < m; ++c, to += size) {
                const V *const from = lanes.out + c / LANES * SIZE + FIRST[f];
                for (int i = 0; i < size; ++i) to[i] = from[i][c % LANES];
            }
        }
    }
    free(lanes.x);
    return 0;
}

// K ← K + Σ_τ k over m cells τ, as in evaluate(), with the k of the only form. A cell has n blocks of dofs, (m, n); the
// columns of block j begin at a place, (m, n, n), in the rows of block i. Returns 0, or 1 without
// memory.
int add(int m, const int *list, const double *x, const int *node, const double *const *w, const int *const *dof,
        const Program *program, int n, const int *block, const int *place, const int64_t *indptr,
        double *values)
{
    enum { BS = BLOCK_OF_ROWS };
    Lanes lanes;
    int64_t cell[CELLS];
    if (create_lanes(&lanes, program)) return 1;
    for (int first = 0; first < m; first += CELLS) {
        visit(&lanes, first, m, list, x, node, w, dof, program, cell);
        for (int g = 0; g < GROUPS; ++g) {
            const V *k = lanes.out + g * SIZE;
            for (int i = 0; i < n; ++i)
                for (int p = 0; p < BS; ++p, k += n * BS)
                    for (int l = 0; l < LANES && first + g * LANES + l < m; ++l) {
                        const int64_t at = cell[g * LANES + l] * n + i;
                        double *const row = values + indptr[(int64_t)block[at] * BS + p];
                        for (int j = 0; j < n; ++j)
                            for (int s = 0; s < BS; ++s) row[place[at * n + j] + s] += k[j * BS + s][l];
                    }
        }
    }
    free(lanes.x);
    return 0;
}
