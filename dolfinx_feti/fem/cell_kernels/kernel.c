// Copyright (C) 2026 the dolfinx_feti authors
//
// SPDX-License-Identifier: LGPL-3.0-or-later

// Cell integrals of the forms of a program, see program.h. A visit is CELLS cells: GROUPS groups of LANES cells.

// kernel.py replaces the next line by the text of a program: the constants GDIM, N and GROUPS (program.py), and the
// names of instructions and functions (tape.py).
/* generated */
#include <stdint.h>
#include "../csr_matrix.h"
#include "program.h"
#include "tape.h"

enum { CELLS = LANES * GROUPS };

// to[node, component] ← dofs of function f on the LANES cells of one group. to is the first vector of the group in
// (nodes, components, GROUPS), so that its stride is GROUPS.
static inline void gather(const Program *program, int f, const int64_t *cell, V *to)
{
    const int nodes = program->nodes[program->element[f]];
    const int components = program->components[f];
    const double *const values = program->values[f];
    const int *const dofmap = program->dofmap[f];
    for (int a = 0; a < nodes; ++a) {
        const double *from[LANES];
        for (int l = 0; l < LANES; ++l)
            from[l] = values + (int64_t)dofmap[cell[l] * nodes + a] * components;
        for (int i = 0; i < components; ++i) {
            V x;
            for (int l = 0; l < LANES; ++l)
                x[l] = from[l][i];
            *to = x;
            to += GROUPS;
        }
    }
}

// K ← J⁻¹ by cofactors; returns det J, with J = ∂x/∂ξ in a cell. In one or two dimensions J is padded to 3 × 3 by ones
// on the diagonal, which do not change its determinant.
static inline V inverse(const V J[3][3], V K[3][3])
{
    UNROLL for (int i = 0; i < 3; ++i)
        UNROLL for (int j = 0; j < 3; ++j) {
            const int row_1 = (i + 1) % 3; // the rows and columns other than i and j, in cyclic order
            const int row_2 = (i + 2) % 3;
            const int column_1 = (j + 1) % 3;
            const int column_2 = (j + 2) % 3;
            K[j][i] = J[row_1][column_1] * J[row_2][column_2] - J[row_1][column_2] * J[row_2][column_1];
        }
    const V determinant = J[0][0] * K[0][0] + J[0][1] * K[1][0] + J[0][2] * K[2][0];
    const V reciprocal = 1.0 / determinant;
    UNROLL for (int i = 0; i < 9; ++i)
        K[i / 3][i % 3] *= reciprocal;
    return determinant;
}

// J ← ∂x/∂ξ = Σ_a x_a ∂ψ_a/∂ξ, (GDIM, GDIM), at point q of the rule, in the cells of group g. dolfinx stores three
// coordinates x_a of a node in any dimension.
static inline void jacobian(const Program *program, int q, int g, const V *R, V J[3][3])
{
    const int nodes = program->nodes[0];
    const double *const psi = program->table + q * nodes * (1 + GDIM);
    const V *const x = R + program->dofs_at[0] + g;
    for (int i = 0; i < GDIM; ++i)
        for (int j = 0; j < GDIM; ++j) {
            V sum = {0.0};
            for (int a = 0; a < nodes; ++a)
                sum += x[(a * 3 + i) * GROUPS] * psi[a * (1 + GDIM) + 1 + j];
            J[i][j] = sum;
        }
}

// to[node, derivative] ← φ and ∂φ/∂X = Kᵀ ∂φ/∂ξ of element e at point q of the rule, with K = ∂ξ/∂X. to is the vector
// of the point in the basis of the element, (nodes, 1 + GDIM, POINTS), so that the stride of derivatives is POINTS.
static inline void tabulate_element(const Program *program, int e, int q, const V K[3][3], V *to)
{
    const double *phi = program->table + program->table_start[e] + q * program->nodes[e] * (1 + GDIM);
    for (int a = 0; a < program->nodes[e]; ++a) {
        to[0] = BROADCAST(phi[0]);
        for (int i = 0; i < GDIM && program->has_gradients[e]; ++i) {
            V sum = {0.0};
            for (int j = 0; j < GDIM; ++j)
                sum += phi[1 + j] * K[j][i];
            to[(1 + i) * POINTS] = sum;
        }
        phi += 1 + GDIM;
        to += NODE_STRIDE;
    }
}

// Compute det ∂x/∂ξ, the weights, and the basis functions of all elements, at the points of a chunk. The first two
// registers of the tape are reserved for determinant and weight (RESERVED_REGISTERS in tape.py).
static void tabulate(const Program *program, int chunk, V *R)
{
    V *const determinant = R;
    V *const weight = R + POINTS;
    V K[3][3] = {{{0.0}}};
    V J[3][3] = {{{0.0}}};
    for (int i = GDIM; i < 3; ++i)
        J[i][i] = BROADCAST(1.0);
    for (int k = 0; k < POINTS; ++k) {
        const int g = k / N;
        const int q = chunk * N + k % N;
        if (k % N == 0 || !program->is_affine) { // in an affine cell, J and K of the group's first point serve all
            jacobian(program, q, g, R, J);
            determinant[k] = inverse(J, K);
        } else {
            determinant[k] = determinant[k - 1];
        }
        weight[k] = BROADCAST(program->weight[q]);
        for (int e = 0; e < program->elements; ++e)
            tabulate_element(program, e, q, K, R + program->basis_at[e] + k);
    }
}

// The entries of one pair of components of a form: K[a, b] += Σ_t Σ_q T_t[a] ∂_t φ_b with T_t[a] = Σ_s A_st ∂_s φ_a.
// program.py writes, for each pair of components:
//   this struct,
//   the derivatives t of columns, (directions,),
//   for each t: the number of derivatives s of rows, and as many pairs (s, offset of the factor A_st in bytes).
// The entry of row node a and column node b is first + a row_stride + b column_stride.
typedef struct {
    int row_element;
    int column_element;
    int first;
    int mirrored; // first entry of the mirrored pair of a symmetric form; −1 for another form
    int row_stride;
    int column_stride;
    int directions;
} Contraction;

enum { CONTRACTION_INTS = sizeof(Contraction) / sizeof(int) };

// Return 1 if a form is symmetric and both components are one, so that the pair is its own mirror image; else 0.
// Without symmetry, mirrored is −1, which no first entry is.
static inline int is_diagonal(const Contraction *pair)
{
    return pair->mirrored == pair->first;
}

// Operands of multiply(): T, (rows, directions, POINTS), and φ, (columns, 1 + GDIM, POINTS), at the points of a group.
typedef struct {
    int directions;       // number of derivatives t
    const int *direction; // t: 0 for the value, 1 + j for ∂_j, (directions,)
    const V *T;
    const V *phi;
} Factors;

// Size of a tile of entries that multiply() computes at once. 2 · 10 sums stay in the 32 registers of AVX-512, and ten
// columns are the nodes of a quadratic tetrahedron. contract() has a case for each number of rows and columns.
enum { ROWS = 2, COLUMNS = 10 };

// s[a, b] ← Σ_t Σ_q T_t[a, q] ∂_t φ_b[q]. The sums stay in the processor's registers, as rows and columns are constants.
static inline __attribute__((always_inline)) void multiply(int rows, int columns, const Factors *factors,
                                                           V s[ROWS][COLUMNS])
{
    const int directions = factors->directions;
    V sum[ROWS][COLUMNS];
    UNROLL for (int a = 0; a < rows; ++a)
        UNROLL for (int b = 0; b < columns; ++b)
            sum[a][b] = (V){0.0};
    for (int t = 0; t < directions; ++t) {
        const V *const T = factors->T + t * POINTS;
        const V *const phi = factors->phi + factors->direction[t] * POINTS;
        for (int q = 0; q < N; ++q)
            UNROLL for (int b = 0; b < columns; ++b)
                UNROLL for (int a = 0; a < rows; ++a)
                    sum[a][b] += T[a * directions * POINTS + q] * phi[b * NODE_STRIDE + q];
    }
    UNROLL for (int a = 0; a < rows; ++a)
        UNROLL for (int b = 0; b < columns; ++b)
            s[a][b] = sum[a][b];
}

// T_t[a] ← Σ_s A_st ∂_s φ_a for each derivative t of columns and node a of rows. For each t, p has the number of pairs
// and the pairs: s[0] is the derivative s, s[1] the offset of A_st. Returns the position after the last pair, where the
// next contraction begins. Offsets of factors are in bytes, as those of registers on the tape; others are in vectors.
static const int *multiply_rows(const Program *program, const Contraction *pair, const int *p, V *R)
{
    const int nodes = program->nodes[pair->row_element];
    const V *const basis = R + program->basis_at[pair->row_element];
    for (int t = 0; t < pair->directions; ++t) {
        const int *const end = p + 1 + 2 * *p;
        for (int a = 0; a < nodes; ++a) {
            V *const T = R + program->products_at + (a * pair->directions + t) * POINTS;
            V sum[POINTS];
            FOR_POINTS(k) sum[k] = (V){0.0};
            for (const int *s = p + 1; s < end; s += 2) {
                const V *const phi = basis + a * NODE_STRIDE + s[0] * POINTS;
                const V *const A = (const V *)((const char *)R + s[1]);
                FOR_POINTS(k) sum[k] += A[k] * phi[k];
            }
            FOR_POINTS(k) T[k] = sum[k];
        }
        p = end;
    }
    return p;
}

// Add a tile s, of rows from a on and columns from b up to end, to the entries, and to the mirrored ones of a symmetric
// form. If both components are one, only the entries on and above the diagonal are used.
static inline void add_tile(const Contraction *pair, int a, int rows, int b, int end, const V s[ROWS][COLUMNS],
                            V *entries)
{
    const int diagonal = is_diagonal(pair);
    for (int i = a; i < a + rows; ++i)
        for (int j = diagonal && i > b ? i : b; j < end; ++j) {
            entries[pair->first + i * pair->row_stride + j * pair->column_stride] += s[i - a][j - b];
            if (pair->mirrored >= 0 && (!diagonal || i != j))
                entries[pair->mirrored + j * pair->row_stride + i * pair->column_stride] += s[i - a][j - b];
        }
}

// s ← a tile of entries, of 1 or 2 rows and 1 to COLUMNS columns: a copy of multiply() for each size.
static inline void multiply_tile(int rows, int columns, const Factors *factors, V s[ROWS][COLUMNS])
{
#define CASE(n)                                   \
    case n: multiply(1, n, factors, s); break;    \
    case COLUMNS + n: multiply(2, n, factors, s); break;
    _Static_assert(ROWS == 2 && COLUMNS == 10, "a case for each size of a tile");
    switch ((rows - 1) * COLUMNS + columns) {
        CASE(1) CASE(2) CASE(3) CASE(4) CASE(5) CASE(6) CASE(7) CASE(8) CASE(9) CASE(10)
    }
#undef CASE
}

// Add the entries of one pair of components, in tiles. p is at its Contraction; returns where the next one begins.
static const int *contract(const Program *program, const int *p, V *R)
{
    const Contraction *const pair = (const Contraction *)p;
    const int *const direction = p + CONTRACTION_INTS;
    const int *const next = multiply_rows(program, pair, direction + pair->directions, R);
    const int diagonal = is_diagonal(pair);
    const int n_rows = program->nodes[pair->row_element];
    const int n_columns = program->nodes[pair->column_element];
    for (int g = 0; g < GROUPS; ++g) {
        const V *const products = R + program->products_at + g * N;
        const V *const basis = R + program->basis_at[pair->column_element] + g * N;
        V *const entries = R + program->entries_at + g * program->entries;
        for (int b = 0; b < n_columns; b += COLUMNS) {
            const int end_column = n_columns - b < COLUMNS ? n_columns : b + COLUMNS;
            const int end_row = diagonal ? end_column : n_rows;
            for (int a = 0; a < end_row; a += ROWS) {
                const int start = diagonal && a > b ? a : b;
                const int rows = end_row - a < ROWS ? 1 : ROWS;
                const Factors factors = {
                    .directions = pair->directions,
                    .direction = direction,
                    .T = products + a * pair->directions * POINTS,
                    .phi = basis + start * NODE_STRIDE,
                };
                V s[ROWS][COLUMNS];
                multiply_tile(rows, end_column - start, &factors, s);
                add_tile(pair, a, rows, start, end_column, s, entries);
            }
        }
    }
    return next;
}

// Integrate all forms over the next CELLS cells of the call, from index first on. cell ← their numbers; if there are
// fewer, the last cell fills up the lanes.
static void visit(const Program *program, int first, V *R, int64_t *cell)
{
    for (int c = 0; c < CELLS; ++c) {
        const int index = first + c < program->n_cells ? first + c : program->n_cells - 1;
        cell[c] = program->cells ? program->cells[index] : index;
    }
    for (int g = 0; g < GROUPS; ++g)
        for (int f = 0; f < program->functions; ++f)
            gather(program, f, cell + g * LANES, R + program->dofs_at[f] + g);
    for (int i = 0; i < GROUPS * program->entries; ++i)
        R[program->entries_at + i] = (V){0.0};
    for (int chunk = 0; chunk < program->chunks; ++chunk) {
        tabulate(program, chunk, R);
        instructions[*program->tape](program->tape + 1, R, program);
        const int *p = program->contractions;
        while (*p >= 0) // −1 is no element
            p = contract(program, p, R);
    }
}

// Return the work space of a visit, or NULL without memory.
static V *create_work_space(const Program *program)
{
    return aligned_alloc(sizeof(V), program->work_size * sizeof(V));
}

int evaluate(const Program *program, double *const *out)
{
    const int n_cells = program->n_cells;
    int64_t cell[CELLS];
    V *const R = create_work_space(program);
    if (!R)
        return 1;
    for (int first = 0; first < n_cells; first += CELLS) {
        visit(program, first, R, cell);
        for (int f = 0; f < program->forms; ++f) {
            const int begin = program->first_entry[f];
            const int size = program->first_entry[f + 1] - begin;
            double *to = out[f] + (int64_t)first * size;
            for (int c = 0; c < CELLS && first + c < n_cells; ++c) {
                const V *const from = R + program->entries_at + c / LANES * program->entries + begin;
                for (int i = 0; i < size; ++i)
                    to[i] = from[i][c % LANES];
                to += size;
            }
        }
    }
    free(R);
    return 0;
}

// Add the entries of the first cells of a group, (nodes bs, nodes bs) each, to a matrix. bs is matrix->bs; for a
// displacement it is passed as the constant GDIM, so that the compiler unrolls the inner loop.
static inline __attribute__((always_inline)) void scatter(const CsrMatrix *matrix, int bs, const int64_t *cell,
                                                          int lanes, const V *entries)
{
    const int nodes = matrix->nodes;
    for (int i = 0; i < nodes; ++i)
        for (int r = 0; r < bs; ++r) {
            for (int l = 0; l < lanes; ++l) {
                const int64_t at = cell[l] * nodes + i;
                const int *const offset = matrix->offsets + at * nodes;
                double *const row = matrix->values + matrix->indptr[(int64_t)matrix->cell_nodes[at] * bs + r];
                for (int j = 0; j < nodes; ++j)
                    UNROLL for (int s = 0; s < bs; ++s)
                        row[offset[j] + s] += entries[j * bs + s][l];
            }
            entries += nodes * bs;
        }
}

int add_to_matrix(const Program *program, const CsrMatrix *matrix)
{
    int64_t cell[CELLS];
    V *const R = create_work_space(program);
    if (!R)
        return 1;
    for (int first = 0; first < program->n_cells; first += CELLS) {
        visit(program, first, R, cell);
        for (int g = 0; g < GROUPS; ++g) {
            const int remaining = program->n_cells - first - g * LANES; // not positive after the last group
            const int lanes = remaining < LANES ? remaining : LANES;
            const V *const entries = R + program->entries_at + g * program->entries;
            if (matrix->bs == GDIM)
                scatter(matrix, GDIM, cell + g * LANES, lanes, entries);
            else
                scatter(matrix, matrix->bs, cell + g * LANES, lanes, entries);
        }
    }
    free(R);
    return 0;
}
