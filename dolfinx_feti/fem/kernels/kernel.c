// Copyright (C) 2026 the dolfinx_feti authors
//
// SPDX-License-Identifier: LGPL-3.0-or-later

/* generated */
#include "tape.h"

// CELLS are visited at a time.
enum { CELLS = LANES * GROUPS };

// to[node, component, ·] ← the values of LANES cells at their dofs, n a cell, each with bs components.
static inline void gather(int n, int bs, const double *from, const int *dof, const int64_t *cell, V *to)
{
    for (int a = 0; a < n; ++a) {
        const double *at[LANES];
        for (int l = 0; l < LANES; ++l) at[l] = from + (int64_t)dof[cell[l] * n + a] * bs;
        for (int i = 0; i < bs; ++i, to += GROUPS) {
            V x;
            for (int l = 0; l < LANES; ++l) x[l] = at[l][i];
            *to = x;
        }
    }
}

// K ← J⁻¹, (GDIM, GDIM), by the cofactors of J in a 3 × 3 matrix with ones below it; returns det J.
static inline V inverse(const V J[3][3], V K[3][3])
{
    UNROLL for (int i = 0; i < 3; ++i)
        UNROLL for (int j = 0; j < 3; ++j) {
            const int k = (i + 1) % 3, l = (i + 2) % 3, m = (j + 1) % 3, n = (j + 2) % 3;
            K[j][i] = J[k][m] * J[l][n] - J[k][n] * J[l][m];
        }
    const V det = J[0][0] * K[0][0] + J[0][1] * K[1][0] + J[0][2] * K[2][0], r = 1.0 / det;
    UNROLL for (int i = 0; i < 9; ++i) K[i / 3][i % 3] *= r;
    return det;
}

// Basis functions φ and ∂φ/∂X = Kᵀ ∂φ/∂ξ, det J, J = ∂x/∂ξ = Σ_a x_a ∂ψ_a/∂ξ, and weights, at the points of a chunk.
static void tabulate(const Program *p, int chunk, V *R)
{
    V K[3][3] = {{{0.0}}}, J[3][3] = {{{0.0}}};
    for (int i = GDIM; i < 3; ++i) J[i][i] = BROADCAST(1.0);
    for (int k = 0; k < POINTS; ++k) {
        const int q = chunk * N + k % N;
        if (k % N == 0 || !p->affine) {
            const double *psi = p->table + q * p->nodes[0] * (1 + GDIM);
            const V *x = R + p->w[0] + k / N;
            for (int i = 0; i < GDIM; ++i)
                for (int j = 0; j < GDIM; ++j) {
                    V sum = {0.0};
                    for (int a = 0; a < p->nodes[0]; ++a) sum += x[(a * 3 + i) * GROUPS] * psi[a * (1 + GDIM) + 1 + j];
                    J[i][j] = sum;
                }
            R[k] = inverse(J, K);
        } else
            R[k] = R[k - 1];
        R[POINTS + k] = BROADCAST(p->weight[q]);
        for (int e = 0; e < p->elements; ++e) {
            const double *phi = p->table + p->tables[e] + q * p->nodes[e] * (1 + GDIM);
            V *to = R + p->phi[e] + k;
            for (int a = 0; a < p->nodes[e]; ++a, phi += 1 + GDIM, to += NODE) {
                to[0] = BROADCAST(phi[0]);
                for (int i = 0; i < GDIM && p->gradients[e]; ++i) {
                    V sum = {0.0};
                    for (int j = 0; j < GDIM; ++j) sum += phi[1 + j] * K[j][i];
                    to[(1 + i) * POINTS] = sum;
                }
            }
        }
    }
}

// s[a, b] ← Σ_t Σ_q T_t[a, q] φ_b,t[q] for rows a, columns b and some directions t, in the processor's registers.
enum { COLUMNS = 10 };
static inline __attribute__((always_inline)) void multiply(int rows, int columns, int terms, const int *direction,
                                                           const V *T, const V *phi, V s[2][COLUMNS])
{
    V sum[2][COLUMNS];
    UNROLL for (int a = 0; a < rows; ++a)
        UNROLL for (int b = 0; b < columns; ++b) sum[a][b] = (V){0.0};
    for (int t = 0; t < terms; ++t) {
        const V *const left = T + t * POINTS, *const right = phi + direction[t] * POINTS;
        for (int q = 0; q < N; ++q)
            UNROLL for (int b = 0; b < columns; ++b)
                UNROLL for (int a = 0; a < rows; ++a) sum[a][b] += left[a * terms * POINTS + q] * right[b * NODE + q];
    }
    UNROLL for (int a = 0; a < rows; ++a)
        UNROLL for (int b = 0; b < columns; ++b) s[a][b] = sum[a][b];
}

// Add one block of a form, see program.py, and return what follows it: T_t[a] = Σ_s A_st ∂_s φ_a for nodes a,
// then K[a, b] += Σ_t Σ_q T_t[a] ∂_t φ_b, and where K is symmetric the mirrored block.
static const int *contract(const Program *program, const int *p, V *R)
{
    const int first = p[2], mirrored = p[3], rows = p[4], columns = p[5], terms = p[6], *const direction = p + 7;
    const int n = program->nodes[p[0]], m = program->nodes[p[1]];
    const V *const phi_v = R + program->phi[p[0]], *const phi_u = R + program->phi[p[1]];
    V *const products = R + program->products;
    p += 7 + terms;
    for (int t = 0; t < terms; ++t) {
        const int *const end = p + 1 + 2 * *p;
        for (int a = 0; a < n; ++a) {
            V sum[POINTS], *const T = products + (a * terms + t) * POINTS;
            EACH sum[k] = (V){0.0};
            for (const int *s = p + 1; s < end; s += 2) {
                const V *const phi = phi_v + a * NODE + s[0] * POINTS;
                const V *const A = (const V *)((const char *)R + s[1]);
                EACH sum[k] += A[k] * phi[k];
            }
            EACH T[k] = sum[k];
        }
        p = end;
    }
    for (int g = 0; g < GROUPS; ++g)
        for (int b = 0; b < m; b += COLUMNS) {
            const int width = m - b < COLUMNS ? m - b : COLUMNS, end = mirrored == first ? b + width : n;
            for (int a = 0; a < end; a += 2) {
                const int start = mirrored == first && a > b ? a : b, height = end - a < 2 ? 1 : 2;
                const V *const T = products + a * terms * POINTS + g * N, *const phi = phi_u + start * NODE + g * N;
                V s[2][COLUMNS];
#define CASE(n)                                                              \
    case n: multiply(1, n, terms, direction, T, phi, s); break;              \
    case COLUMNS + n: multiply(2, n, terms, direction, T, phi, s); break;
                switch ((height - 1) * COLUMNS + b + width - start) {
                    CASE(1) CASE(2) CASE(3) CASE(4) CASE(5) CASE(6) CASE(7) CASE(8) CASE(9) CASE(10)
                }
                V *const out = R + program->out + g * program->size;
                for (int i = a; i < a + height; ++i)
                    for (int j = mirrored == first && i > start ? i : start; j < b + width; ++j) {
                        out[first + i * rows + j * columns] += s[i - a][j - start];
                        if (mirrored >= 0 && (mirrored != first || i != j))
                            out[mirrored + j * rows + i * columns] += s[i - a][j - start];
                    }
            }
        }
    return p;
}

// Integrate over cells from place first on, and return them; the last one fills up the lanes.
static void visit(const Program *p, int first, V *R, int64_t *cell)
{
    for (int c = 0; c < CELLS; ++c) {
        const int place = first + c < p->m ? first + c : p->m - 1;
        cell[c] = p->cells ? p->cells[place] : place;
    }
    for (int g = 0; g < GROUPS; ++g)
        for (int f = 0; f < p->functions; ++f)
            gather(p->nodes[p->element[f]], p->block[f], p->values[f], p->dof[f], cell + g * LANES, R + p->w[f] + g);
    for (int i = 0; i < GROUPS * p->size; ++i) R[p->out + i] = (V){0.0};
    for (int chunk = 0; chunk < p->chunks; ++chunk) {
        tabulate(p, chunk, R);
        instructions[*p->tape](p->tape + 1, R, p);
        for (const int *next = p->contractions; *next >= 0;) next = contract(p, next, R);
    }
}

// out[f] ← the entries of form f, cell by cell. Returns 0, or 1 without memory.
int evaluate(const Program *program, double *const *out)
{
    const int m = program->m;
    int64_t cell[CELLS];
    V *const R = aligned_alloc(sizeof(V), program->vectors * sizeof(V));
    if (!R) return 1;
    for (int first = 0; first < m; first += CELLS) {
        visit(program, first, R, cell);
        for (int f = 0; f < program->forms; ++f) {
            const int begin = program->begin[f], size = program->begin[f + 1] - begin;
            double *to = out[f] + (int64_t)first * size;
            for (int c = 0; c < CELLS && first + c < m; ++c, to += size) {
                const V *const from = R + program->out + c / LANES * program->size + begin;
                for (int i = 0; i < size; ++i) to[i] = from[i][c % LANES];
            }
        }
    }
    free(R);
    return 0;
}

static inline __attribute__((always_inline)) void scatter(int n, int bs, int lanes, const int64_t *cell, const V *k,
                                                          const int *block, const int *place, const int64_t *indptr,
                                                          double *values)
{
    for (int i = 0; i < n; ++i)
        for (int r = 0; r < bs; ++r, k += n * bs)
            for (int l = 0; l < lanes; ++l) {
                const int64_t at = cell[l] * n + i;
                double *const row = values + indptr[(int64_t)block[at] * bs + r];
                for (int j = 0; j < n; ++j)
                    UNROLL for (int s = 0; s < bs; ++s) row[place[at * n + j] + s] += k[j * bs + s][l];
            }
}

// K ← K + Σ_τ k over cells τ, with the k of the only form. A cell has n blocks of bs dofs, (·, n); the columns of block
// j begin at a place, (·, n, n), in the rows of block i. Returns 0, or 1 without memory.
int add(const Program *program, int n, int bs, const int *block, const int *place, const int64_t *indptr, double *values)
{
    int64_t cell[CELLS];
    V *const R = aligned_alloc(sizeof(V), program->vectors * sizeof(V));
    if (!R) return 1;
    for (int first = 0; first < program->m; first += CELLS) {
        visit(program, first, R, cell);
        for (int g = 0; g < GROUPS; ++g) {
            const int rest = program->m - first - g * LANES, lanes = rest < LANES ? rest : LANES;
            const V *const k = R + program->out + g * program->size;
            if (bs == GDIM)
                scatter(n, GDIM, lanes, cell + g * LANES, k, block, place, indptr, values);
            else
                scatter(n, bs, lanes, cell + g * LANES, k, block, place, indptr, values);
        }
    }
    free(R);
    return 0;
}
