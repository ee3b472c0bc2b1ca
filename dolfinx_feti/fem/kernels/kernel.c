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

// J ← ∂x/∂ξ of nodes x, (n, d), with ∂ψ/∂ξ, (n, d).
static inline void jacobian(int n, int d, const V *x, const double *dpsi, V *J)
{
    for (int i = 0; i < d; ++i)
        for (int j = 0; j < d; ++j) {
            V sum = {0.0};
            for (int a = 0; a < n; ++a) sum += x[a * d + i] * dpsi[a * d + j];
            J[i * d + j] = sum;
        }
}

// B ← ∂φ/∂X = Kᵀ ∂φ/∂ξ of n basis functions, (n, d).
__attribute__((unused)) static inline void gradients(int n, int d, const double *dphi, const V *K, V *B)
{
    for (int a = 0; a < n; ++a)
        for (int i = 0; i < d; ++i) {
            V sum = {0.0};
            for (int j = 0; j < d; ++j) sum += dphi[a * d + j] * K[j * d + i];
            B[a * d + i] = sum;
        }
}

static V v_fabs(V x) { return choose(x < 0.0, -x, x); }

static V v_sqrt(V x)
{
    for (int l = 0; l < LANES; ++l) x[l] = sqrt(x[l]);
    return x;
}

// The greatest |A_i| at all points, of factors A, (points, width).
static V greatest(int points, int width, const V *A, int i)
{
    V most = {0.0};
    for (int q = 0; q < points; ++q) {
        const V a = v_fabs(A[q * width + i]);
        most = choose(a > most, a, most);
    }
    return most;
}

// Whether A_st = A_ts, to rounding, for n pairs of the factors, (points, width). A pair names A_st,
// A_ts, A_ss, A_tt, or -1 for a factor that is zero: rounding errors are a share of |A_st| or of
// |A_ss A_tt|^½, which have one unit, whatever the units of the slots s and t.
__attribute__((unused)) static int symmetric(int points, int width, const V *A, int n,
                                             const int (*pair)[4])
{
    for (int i = 0; i < n; ++i, ++pair) {
        V difference = {0.0}, size = greatest(points, width, A, (*pair)[0]);
        for (int q = 0; q < points; ++q)
            difference += v_fabs(A[q * width + (*pair)[0]] - A[q * width + (*pair)[1]]);
        if ((*pair)[2] >= 0 && (*pair)[3] >= 0)
            size += v_sqrt(greatest(points, width, A, (*pair)[2])) *
                    v_sqrt(greatest(points, width, A, (*pair)[3]));
        for (int l = 0; l < LANES; ++l)
            if (!(difference[l] <= 64 * DBL_EPSILON * size[l])) return 0;
    }
    return 1;
}

// The code that kernel.py generates has its place here: NODES of a cell's geometry in GDIM
// dimensions; a number of COEFFICIENTS, with NODES_OF a cell and BLOCK_OF components; FORMS, each of
// which begins at FIRST among the SIZE entries of a cell; dofs in a BLOCK_OF_ROWS of the first form;
// and tabulate(), which adds to these entries what follows from the factors that tapes compute.
/* generated */

// What LANES cells gather, and the entries of their forms.
typedef struct {
    V *x, *w[COEFFICIENTS + 1], *out, *registers;
} Lanes;

static int create_lanes(Lanes *lanes, const Program *program)
{
    size_t n = NODES * GDIM + SIZE + program->vectors;
    for (int f = 0; f < COEFFICIENTS; ++f) n += NODES_OF[f] * BLOCK_OF[f];
    lanes->x = aligned_alloc(sizeof(V), n * sizeof(V));
    if (!lanes->x) return 1;
    V *next = lanes->x + NODES * GDIM;
    for (int f = 0; f < COEFFICIENTS; next += NODES_OF[f] * BLOCK_OF[f], ++f) lanes->w[f] = next;
    lanes->out = next;
    lanes->registers = next + SIZE;
    return 0;
}

// Tabulate cells from place first on, of m places in all, and return them; the last one fills up the
// lanes. The cells are all from 0 on, or those of a list.
static void visit(const Lanes *lanes, int first, int m, const int *list, const double *x,
                  const int *node, const double *const *w, const int *const *dof, const Program *program, int64_t *cells)
{
    for (int l = 0; l < LANES; ++l) {
        const int place = first + l < m ? first + l : m - 1;
        const int64_t cell = cells[l] = list ? list[place] : place;
        for (int n = 0; n < NODES; ++n)
            for (int i = 0; i < GDIM; ++i)
                lanes->x[n * GDIM + i][l] = x[3 * (int64_t)node[cell * NODES + n] + i];
        for (int f = 0; f < COEFFICIENTS; ++f)
            for (int n = 0; n < NODES_OF[f]; ++n)
                for (int i = 0, bs = BLOCK_OF[f]; i < bs; ++i)
                    lanes->w[f][n * bs + i][l] = w[f][(int64_t)dof[f][cell * NODES_OF[f] + n] * bs + i];
    }
    for (int i = 0; i < SIZE; ++i) lanes->out[i] = (V){0.0};
    tabulate(lanes->x, (const V *const *)lanes->w, program, lanes->registers, lanes->out);
}

// out[f] ← the entries of form f in m cells, cell by cell, with the coordinates x, (·, 3), the
// coefficients w. The cells are the first ones, or those of a list, if there is
// one. Returns 0, or 1 without memory.
int evaluate(int m, const int *list, const double *x, const int *node, const double *const *w, const int *const *dof,
             const Program *program, double *const *out)
{
    Lanes lanes;
    int64_t cell[LANES];
    if (create_lanes(&lanes, program)) return 1;
    for (int first = 0; first < m; first += LANES) {
        visit(&lanes, first, m, list, x, node, w, dof, program, cell);
        for (int f = 0; f < FORMS; ++f) {
            const int size = FIRST[f + 1] - FIRST[f];
            double *to = out[f] + (int64_t)first * size;
            for (int l = 0; l < LANES && first + l < m; ++l, to += size)
                for (int i = 0; i < size; ++i) to[i] = lanes.out[FIRST[f] + i][l];
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
    int64_t cell[LANES];
    if (create_lanes(&lanes, program)) return 1;
    for (int first = 0; first < m; first += LANES) {
        visit(&lanes, first, m, list, x, node, w, dof, program, cell);
        const V *k = lanes.out;
        for (int i = 0; i < n; ++i)
            for (int p = 0; p < BS; ++p, k += n * BS)
                for (int l = 0; l < LANES && first + l < m; ++l) {
                    const int64_t at = cell[l] * n + i;
                    double *const row = values + indptr[(int64_t)block[at] * BS + p];
                    for (int j = 0; j < n; ++j)
                        for (int s = 0; s < BS; ++s) row[place[at * n + j] + s] += k[j * BS + s][l];
                }
    }
    free(lanes.x);
    return 0;
}
