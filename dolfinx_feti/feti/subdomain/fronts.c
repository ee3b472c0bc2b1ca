// Copyright (C) 2026 the dolfinx_feti authors
//
// SPDX-License-Identifier: LGPL-3.0-or-later
//
// Cholesky's factorisation of a sparse matrix that stops at the interface, front by front:
//
//     K = ( K_II  K_IΓ ) = ( Uᵀ     ) ( U  W ),   U upper triangular,   S = K_ΓΓ − Wᵀ W.
//         ( K_ΓI  K_ΓΓ )   ( Wᵀ   I ) ( 0  S )
//
// fronts.py tells what is what. Dofs are numbered by their rank in the elimination, those of the
// interface last. Matrices are stored column by column.

#include <stdint.h>
#include <stdlib.h>
#include <string.h>

typedef struct {
    int n;             // dofs
    int n_I;           // dofs of the interior, which are eliminated
    int count;         // fronts, children before parents
    int *rank;         // rank of each dof, (n)
    int *first;        // rank of the first pivot of each front, (count + 1)
    int *start;        // where the border of each front begins in rows, (count + 1)
    int *rows;         // ranks of the borders, each ascending
    int *inside;       // border rows of each front that are of the interior, (count)
    int *children;     // number of children of each front, (count)
    int64_t *factor;   // where the rows of each front begin in the factor of K_II, (count + 1)
    int64_t work;      // doubles of work space of a factorisation
    int widest;        // longest border
    double seconds;    // estimate of the time of a factorisation
} fronts;

// BLAS and LAPACK, as Fortran has them
typedef void potrf(char *, int *, double *, int *, int *);
typedef void trsm(char *, char *, char *, char *, int *, int *, double *, double *, int *, double *,
                  int *);
typedef void syrk(char *, char *, int *, int *, double *, double *, int *, double *, double *,
                  int *);
typedef void gemm(char *, char *, int *, int *, int *, double *, double *, int *, double *, int *,
                  double *, double *, int *);
typedef struct {
    potrf *potrf;
    trsm *trsm;
    syrk *syrk;
    gemm *gemm;
} dense;

void fronts_free(fronts *t)
{
    if (!t) return;
    free(t->rank);
    free(t->first);
    free(t->start);
    free(t->rows);
    free(t->inside);
    free(t->children);
    free(t->factor);
    free(t);
}

// --- analysis -----------------------------------------------------------------------------------

// Seconds that a front of p pivots and b border rows takes: calls, sums of entries, flops.
static double seconds(double p, double b)
{
    return 3e-6 + 1.5e-9 * (p * (p + b) + b * b) + (p * p * p / 3 + p * p * b + p * b * b) / 35e9;
}

static int ascending(const void *a, const void *b) { return *(const int *)a - *(const int *)b; }

// A tree: the parent of each, its last child, and the child of the same parent before it.
typedef struct {
    int *parent, *last, *before;
} family;

static void adopt(family *t, int parent, int child)
{
    t->parent[child] = parent;
    t->before[child] = t->last[parent];
    t->last[parent] = child;
}

// Find the fronts for m nodes of size[v] consecutive dofs, their graph, and the m_I nodes of the
// interior in their order. Returns NULL where memory ends; fronts_free frees the result.
fronts *fronts_analyse(int m, const int *size, const int *ptr, const int *adjacent, int m_I,
                       const int *order)
{
    int *turn = malloc((m + 1) * sizeof(int));    // the turn of each node; interface nodes last
    int *node = malloc((m + 1) * sizeof(int));    // and back
    int *mark = malloc((m + 1) * sizeof(int));    // the last turn that has met a node
    int *begin = malloc((m_I + 1) * sizeof(int)); // where the structure of a turn begins in rows
    int *pivots = calloc(m_I + 1, sizeof(int));   // dofs that are eliminated together
    int *border = calloc(m_I + 1, sizeof(int));   // dofs that they touch later
    int *in = malloc((m_I + 1) * sizeof(int));    // the turn that a turn has joined, or itself
    int *front = malloc((m_I + 1) * sizeof(int)); // number of the front
    int *dofs = malloc((m + 1) * sizeof(int));    // first rank of the dofs
    int *held = NULL;                             // ranks that are given, in each front
    int *list = malloc((m_I + 1) * sizeof(int));
    family t = {malloc((m_I + 1) * sizeof(int)), malloc((m_I + 1) * sizeof(int)),
                malloc((m_I + 1) * sizeof(int))};
    fronts *f = calloc(1, sizeof(fronts));
    int64_t room = 64 * (int64_t)m + 64, used = 0;
    int *rows = malloc(room * sizeof(int));
    int ok = turn && node && mark && begin && pivots && border && in && dofs && list && front
             && t.parent && t.last && t.before && f && rows;

    // 1. the structure of each turn: later neighbours of its own and of its children
    if (ok) {
        int next = m_I;
        for (int v = 0; v < m; ++v) turn[v] = -1;
        for (int k = 0; k < m_I; ++k) turn[order[k]] = k;
        for (int v = 0; v < m; ++v) {
            if (turn[v] < 0) turn[v] = next++;
            node[turn[v]] = v;
            mark[v] = -1;
        }
        for (int k = 0; k <= m_I; ++k) t.parent[k] = t.last[k] = t.before[k] = -1;
    }
    for (int k = 0; ok && k < m_I; ++k) {
        if (used + m > room) {
            room = 2 * room + m;
            int *more = realloc(rows, room * sizeof(int));
            if (!(ok = more != NULL)) break;
            rows = more;
        }
        int v = node[k], parent = m_I;
        begin[k] = (int)used;
        mark[k] = k;
        for (int e = ptr[v]; e < ptr[v + 1]; ++e) {
            int j = turn[adjacent[e]];
            if (j <= k || mark[j] == k) continue;
            mark[j] = k;
            rows[used++] = j;
        }
        for (int c = t.last[k]; c >= 0; c = t.before[c])
            for (int e = begin[c]; e < begin[c + 1]; ++e) {
                int j = rows[e];
                if (mark[j] == k) continue;
                mark[j] = k;
                rows[used++] = j;
            }
        begin[k + 1] = (int)used;
        for (int e = begin[k]; e < used; ++e) {
            if (rows[e] < parent) parent = rows[e];
            border[k] += size[node[rows[e]]];
        }
        pivots[k] = size[v];
        in[k] = k;
        if (parent < m_I) adopt(&t, parent, k);
    }

    // 2. a child joins its parent where that saves time: both have the parent's border then
    for (int k = 0; ok && k < m_I; ++k) {
        int children = t.last[k];
        t.last[k] = -1;
        for (int c = children, before; c >= 0; c = before) {
            before = t.before[c];
            double apart = seconds(pivots[c], border[c]) + seconds(pivots[k], border[k]);
            if (seconds(pivots[c] + pivots[k], border[k]) > apart) {
                adopt(&t, k, c);
                continue;
            }
            in[c] = k;
            pivots[k] += pivots[c];
            for (int g = t.last[c], then; g >= 0; g = then) {
                then = t.before[g];
                adopt(&t, k, g);
            }
        }
    }

    // 3. fronts, children before parents; ranks and borders; room for what waits for its parent
    if (ok) {
        int top = 0, count = 0;
        for (int k = 0; k < m_I; ++k) front[k] = -1;
        for (int k = m_I - 1; k >= 0; --k) {
            if (in[k] != k || t.parent[k] >= 0) continue;
            int c = k; // down to a leaf; a turn gets its number after all its children
            list[top = 0] = c;
            while (top >= 0) {
                c = list[top];
                int child = t.last[c];
                if (child >= 0) {
                    t.last[c] = t.before[child];
                    list[++top] = child;
                } else {
                    front[c] = count++;
                    --top;
                }
            }
        }
        f->count = count;
        f->first = calloc(count + 1, sizeof(int));
        f->start = calloc(count + 1, sizeof(int));
        f->inside = calloc(count + 1, sizeof(int));
        f->children = calloc(count + 1, sizeof(int));
        f->factor = calloc(count + 1, sizeof(int64_t));
        ok = f->first && f->start && f->inside && f->children && f->factor;
    }
    if (ok) {
        int64_t total = 0;
        for (int k = 0; k < m_I; ++k) {
            if (in[k] != k) continue;
            f->first[front[k] + 1] = pivots[k];
            f->start[front[k] + 1] = border[k];
            if (t.parent[k] >= 0) ++f->children[front[t.parent[k]]];
        }
        for (int i = 0; i < f->count; ++i) {
            f->first[i + 1] += f->first[i];
            total += f->start[i + 1];
            f->start[i + 1] += f->start[i];
        }
        f->n_I = f->first[f->count];
        for (int v = 0; v < m; ++v) f->n += size[v];
        f->rows = malloc((total + 1) * sizeof(int));
        f->rank = malloc((f->n + 1) * sizeof(int));
        held = malloc((f->count + 1) * sizeof(int));
        ok = f->rows && f->rank && held;
    }
    if (ok) {
        int next = f->n_I;
        memcpy(held, f->first, (f->count + 1) * sizeof(int));
        for (int k = 0; k < m; ++k) {
            if (k < m_I) {
                int top = k;
                while (in[top] != top) top = in[top];
                dofs[k] = held[front[top]];
                held[front[top]] += size[node[k]];
            } else {
                dofs[k] = next;
                next += size[node[k]];
            }
        }
        for (int v = 0, i = 0; v < m; ++v)
            for (int j = 0; j < size[v]; ++j) f->rank[i++] = dofs[turn[v]] + j;
        for (int k = 0; k < m_I; ++k) {
            if (in[k] != k) continue;
            int i = front[k], at = f->start[i];
            for (int e = begin[k]; e < begin[k + 1]; ++e)
                for (int j = 0; j < size[node[rows[e]]]; ++j) f->rows[at++] = dofs[rows[e]] + j;
            qsort(f->rows + f->start[i], at - f->start[i], sizeof(int), ascending);
            for (int e = f->start[i]; e < at; ++e) f->inside[i] += f->rows[e] < f->n_I;
        }
        int64_t stack = 0;
        int depth = 0;
        for (int i = 0; i < f->count; ++i) {
            int64_t p = f->first[i + 1] - f->first[i], b = f->start[i + 1] - f->start[i];
            f->factor[i + 1] = f->factor[i] + p * (p + f->inside[i]);
            f->seconds += seconds(p, b);
            if (b > f->widest) f->widest = (int)b;
            if (stack + p * (p + b) + b * b > f->work) f->work = stack + p * (p + b) + b * b;
            for (int c = 0; c < f->children[i]; ++c) {
                int64_t w = list[--depth];
                stack -= w * w;
            }
            if (f->inside[i]) {
                list[depth++] = (int)b;
                stack += b * b;
            }
        }
    }
    free(turn); free(node); free(mark); free(begin); free(pivots); free(border); free(in);
    free(dofs); free(list); free(front); free(held); free(rows);
    free(t.parent); free(t.last); free(t.before);
    if (!ok) {
        fronts_free(f);
        return NULL;
    }
    return f;
}

// --- factorisation ------------------------------------------------------------------------------

// Where entry (i, j) of the lower triangle of order n stands in packed format
static int64_t packed(int64_t n, int64_t i, int64_t j) { return j * n - j * (j + 1) / 2 + i; }

// Factor K, (n, n): the rows of a matrix that are named, and the columns with a number that is not
// negative, both triangles. L takes the rows of U and of W inside the interior; S, its packed lower
// triangle, comes as zeros. work has room for f->work, place,
// dof and at for n, waiting for count. Returns 0, or the rank + 1 of a pivot that is not positive.
int fronts_factor(const fronts *f, const int *rows, const int *indptr, const int *indices,
                  const int *number, const double *values, double *L, double *S, double *work,
                  int *place, int *dof, int *at, int *waiting, const dense *blas)
{
    const int n_Gamma = f->n - f->n_I;
    double *top = work, one = 1.0, minus = -1.0;
    int depth = 0;
    for (int i = 0; i < f->n; ++i) dof[f->rank[i]] = i;
    for (int r = f->n_I; r < f->n; ++r) // K_ΓΓ
        for (int row = rows[dof[r]], e = indptr[row]; e < indptr[row + 1]; ++e) {
            int j = number[indices[e]], s = j < 0 ? -1 : f->rank[j];
            if (s >= r) S[packed(n_Gamma, s - f->n_I, r - f->n_I)] += values[e];
        }
    for (int i = 0; i < f->count; ++i) {
        const int first = f->first[i], last = f->first[i + 1], *border = f->rows + f->start[i];
        int p = last - first, b = f->start[i + 1] - f->start[i];
        double *P = top, *C = top + (int64_t)p * (p + b); // rows of U and W; what is left
        memset(P, 0, (int64_t)p * (p + b) * sizeof(double));
        for (int j = 0; j < b; ++j) memset(C + (int64_t)j * b + j, 0, (b - j) * sizeof(double));
        for (int j = 0; j < p; ++j) place[first + j] = j;
        for (int j = 0; j < b; ++j) place[border[j]] = p + j;
        for (int r = first; r < last; ++r) // K
            for (int row = rows[dof[r]], e = indptr[row]; e < indptr[row + 1]; ++e) {
                int j = number[indices[e]], s = j < 0 ? -1 : f->rank[j];
                if (s >= r) P[r - first + (int64_t)p * place[s]] += values[e];
            }
        double *child = top;
        for (int c = 0; c < f->children[i]; ++c) { // what the children left
            const int k = waiting[--depth], w = f->start[k + 1] - f->start[k];
            const int *late = f->rows + f->start[k];
            child -= (int64_t)w * w;
            for (int j = 0; j < w; ++j) at[j] = place[late[j]];
            for (int j = 0; j < w; ++j) {
                const double *restrict column = child + (int64_t)w * j;
                if (at[j] < p) {
                    double *restrict to = P + at[j];
                    for (int l = j; l < w; ++l) to[(int64_t)p * at[l]] += column[l];
                } else {
                    double *restrict to = C + (int64_t)b * (at[j] - p) - p;
                    for (int l = j; l < w; ++l) to[at[l]] += column[l];
                }
            }
        }
        double *W = P + (int64_t)p * p;
        int info = 0;
        blas->potrf("U", &p, P, &p, &info); // Uᵀ U
        if (info) return first + (info > 0 ? info : 1);
        if (b) {
            blas->trsm("L", "U", "T", "N", &p, &b, &one, P, &p, W, &p); // U⁻ᵀ W
            blas->syrk("L", "T", &b, &p, &minus, W, &p, &one, C, &b);   // C − Wᵀ W
        }
        memcpy(L + f->factor[i], P, (f->factor[i + 1] - f->factor[i]) * sizeof(double));
        if (b && border[0] < f->n_I) {
            memmove(child, C, (int64_t)b * b * sizeof(double));
            top = child + (int64_t)b * b;
            waiting[depth++] = i;
        } else { // a root: what is left belongs to S
            top = child;
            for (int j = 0; j < b; ++j) {
                double *to = S + packed(n_Gamma, 0, border[j] - f->n_I) - f->n_I;
                for (int l = j; l < b; ++l) to[border[l]] += C[(int64_t)b * j + l];
            }
        }
    }
    return 0;
}

// Overwrite k columns Y, (n_I, k), by their ranks, with K_II⁻¹ Y; work has room for f->widest k.
void fronts_solve(const fronts *f, const double *L, int k, double *Y, double *work,
                  const dense *blas)
{
    double one = 1.0, minus = -1.0, zero = 0.0;
    int n = f->n_I;
    for (int i = 0; i < f->count; ++i) { // U⁻ᵀ
        const int *border = f->rows + f->start[i];
        int p = f->first[i + 1] - f->first[i], b = f->inside[i];
        double *U = (double *)L + f->factor[i], *W = U + (int64_t)p * p, *y = Y + f->first[i];
        blas->trsm("L", "U", "T", "N", &p, &k, &one, U, &p, y, &n);
        if (!b) continue;
        blas->gemm("T", "N", &b, &k, &p, &one, W, &p, y, &n, &zero, work, &b);
        for (int c = 0; c < k; ++c)
            for (int j = 0; j < b; ++j) Y[(int64_t)n * c + border[j]] -= work[(int64_t)b * c + j];
    }
    for (int i = f->count - 1; i >= 0; --i) { // U⁻¹
        const int *border = f->rows + f->start[i];
        int p = f->first[i + 1] - f->first[i], b = f->inside[i];
        double *U = (double *)L + f->factor[i], *W = U + (int64_t)p * p, *y = Y + f->first[i];
        for (int c = 0; c < k; ++c)
            for (int j = 0; j < b; ++j) work[(int64_t)b * c + j] = Y[(int64_t)n * c + border[j]];
        if (b) blas->gemm("N", "N", &p, &k, &b, &minus, W, &p, work, &b, &one, y, &n);
        blas->trsm("L", "U", "N", "N", &p, &k, &one, U, &p, y, &n);
    }
}
