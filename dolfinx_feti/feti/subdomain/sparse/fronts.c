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
typedef void trtri(char *, char *, int *, double *, int *, int *);
typedef void trsv(char *, char *, char *, int *, double *, int *, double *, int *);
typedef void gemv(char *, int *, int *, double *, double *, int *, double *, int *, double *,
                  double *, int *);
typedef struct {
    potrf *potrf;
    trtri *trtri;
    trsm *trsm, *trmm;
    syrk *syrk;
    gemm *gemm;
    trsv *trsv;
    gemv *gemv;
} dense;

void fronts_free(fronts *f)
{
    if (!f) return;
    void *owned[] = {f->rank, f->first, f->start, f->rows, f->inside, f->children, f->factor, f};
    for (size_t i = 0; i < sizeof(owned) / sizeof(owned[0]); ++i) free(owned[i]);
}

// --- analysis -----------------------------------------------------------------------------------

// Seconds that a front of p pivots and b border rows takes: calls, sums of what children leave, rows
// of pivots, flops.
static double seconds(double p, double b)
{
    const double flops = p * p * p / 3 + p * p * b + p * b * b;
    return 3e-6 + 1e-9 * b * b + 8e-9 * p * (p + b) + flops / 50e9;
}

static int ascending(const void *a, const void *b) { return *(const int *)a - *(const int *)b; }

// The nodes of an analysis. A node has a turn: that in the order of elimination, interface nodes
// last. What follows is given by turns; up to m_I they are those of a forest.
typedef struct {
    int m, m_I;      // nodes; those of the interior
    const int *size; // dofs of each node, by its number
    int *turn, *node; // the turn of each node, by its number, and back
    int *mark;       // the last turn that has met this one
    int *begin;      // where the structure, the later turns that it touches, begins in rows
    int *pivots;     // dofs that are eliminated with it
    int *border;     // dofs that they touch later
    int *in;         // the turn that it has joined, or itself
    int *parent;     // -1 for none
    int *last;       // its last child, -1 for none
    int *before;     // the child of the same parent before it, -1 for none
    int *front;      // number of its front, if it has joined no other
    int *dofs;       // first rank of its dofs
    int *rows;       // all structures
    int *pool;       // what the arrays above but rows stand in
} forest;

static void adopt(forest *t, int parent, int child)
{
    t->parent[child] = parent;
    t->before[child] = t->last[parent];
    t->last[parent] = child;
}

// Plant the nodes, with no children yet. Returns whether there is memory.
static int plant(forest *t, int m, const int *size, int m_I, const int *order)
{
    int **arrays[] = {&t->turn,   &t->node, &t->mark,   &t->begin, &t->pivots, &t->border,
                      &t->in,     &t->parent, &t->last, &t->before, &t->front, &t->dofs};
    const int count = sizeof(arrays) / sizeof(arrays[0]);
    int next = m_I;
    t->m = m, t->m_I = m_I, t->size = size;
    t->pool = malloc(count * (size_t)(m + 1) * sizeof(int));
    if (!t->pool) return 0;
    for (size_t k = 0; k < count * (size_t)(m + 1); ++k) t->pool[k] = -1;
    for (int i = 0; i < count; ++i) *arrays[i] = t->pool + i * (size_t)(m + 1);
    for (int k = 0; k < m_I; ++k) t->turn[order[k]] = k;
    for (int v = 0; v < m; ++v) {
        if (t->turn[v] < 0) t->turn[v] = next++;
        t->node[t->turn[v]] = v;
    }
    return 1;
}

// The structure of each turn: later neighbours of its own and of its children. Its parent is the
// first of them. Returns whether there is memory.
static int find_structures(forest *t, const int *ptr, const int *adjacent)
{
    int64_t room = 64 * (int64_t)(t->m + 1), used = 0;
    t->rows = malloc(room * sizeof(int));
    if (!t->rows) return 0;
    for (int k = 0; k < t->m_I; ++k) {
        if (used + t->m > room) {
            room = 2 * room + t->m;
            int *more = realloc(t->rows, room * sizeof(int));
            if (!more) return 0;
            t->rows = more;
        }
        const int v = t->node[k];
        int first = t->m_I;
        t->begin[k] = (int)used;
        for (int e = ptr[v]; e < ptr[v + 1]; ++e) {
            int j = t->turn[adjacent[e]];
            if (j <= k || t->mark[j] == k) continue;
            t->mark[j] = k;
            t->rows[used++] = j;
        }
        for (int c = t->last[k]; c >= 0; c = t->before[c])
            for (int e = t->begin[c]; e < t->begin[c + 1]; ++e) {
                int j = t->rows[e];
                if (j <= k || t->mark[j] == k) continue;
                t->mark[j] = k;
                t->rows[used++] = j;
            }
        t->begin[k + 1] = (int)used;
        t->pivots[k] = t->size[v];
        t->border[k] = 0;
        t->in[k] = k;
        for (int e = t->begin[k]; e < used; ++e) {
            if (t->rows[e] < first) first = t->rows[e];
            t->border[k] += t->size[t->node[t->rows[e]]];
        }
        if (first < t->m_I) adopt(t, first, k);
    }
    return 1;
}

// A child joins its parent where that saves time: both have the parent's border then.
static void merge(forest *t)
{
    for (int k = 0; k < t->m_I; ++k) {
        int child = t->last[k];
        t->last[k] = -1;
        for (int before; child >= 0; child = before) {
            before = t->before[child];
            const int p = t->pivots[k] + t->pivots[child], b = t->border[k];
            double apart = seconds(t->pivots[child], t->border[child]) + seconds(t->pivots[k], b);
            if (seconds(p, b) > apart) {
                adopt(t, k, child);
                continue;
            }
            t->in[child] = k;
            t->pivots[k] = p;
            for (int c = t->last[child], then; c >= 0; c = then) {
                then = t->before[c];
                adopt(t, k, c);
            }
        }
    }
}

// Number the fronts, children before parents; path has room for a way from a root to a leaf. The
// children are lost on the way. Returns the number of fronts.
static int number_fronts(forest *t, int *path)
{
    int count = 0;
    for (int root = t->m_I - 1; root >= 0; --root) {
        if (t->in[root] != root || t->parent[root] >= 0) continue;
        int depth = 0;
        path[0] = root;
        while (depth >= 0) {
            int k = path[depth], child = t->last[k];
            if (child >= 0) {
                t->last[k] = t->before[child];
                path[++depth] = child;
            } else {
                t->front[k] = count++;
                --depth;
            }
        }
    }
    return count;
}

// Sizes of the fronts. Returns whether there is memory.
static int measure(const forest *t, fronts *f, int count)
{
    f->count = count;
    f->first = calloc(count + 1, sizeof(int));
    f->start = calloc(count + 1, sizeof(int));
    f->inside = calloc(count + 1, sizeof(int));
    f->children = calloc(count + 1, sizeof(int));
    f->factor = calloc(count + 1, sizeof(int64_t));
    if (!f->first || !f->start || !f->inside || !f->children || !f->factor) return 0;
    for (int k = 0; k < t->m_I; ++k) {
        if (t->in[k] != k) continue;
        f->first[t->front[k] + 1] = t->pivots[k];
        f->start[t->front[k] + 1] = t->border[k];
        if (t->parent[k] >= 0) ++f->children[t->front[t->parent[k]]];
    }
    for (int i = 0; i < count; ++i) {
        f->first[i + 1] += f->first[i];
        f->start[i + 1] += f->start[i];
    }
    f->n_I = f->first[count];
    for (int v = 0; v < t->m; ++v) f->n += t->size[v];
    f->rows = malloc((f->start[count] + 1) * sizeof(int));
    f->rank = malloc((f->n + 1) * sizeof(int));
    return f->rows && f->rank;
}

// Ranks of the dofs, and the borders by ranks; given has room for count + 1.
static void give_ranks(const forest *t, fronts *f, int *given)
{
    int next = f->n_I;
    memcpy(given, f->first, (f->count + 1) * sizeof(int));
    for (int k = 0; k < t->m; ++k) {
        int top = k;
        while (k < t->m_I && t->in[top] != top) top = t->in[top];
        int *from = k < t->m_I ? given + t->front[top] : &next;
        t->dofs[k] = *from;
        *from += t->size[t->node[k]];
    }
    for (int v = 0, i = 0; v < t->m; ++v)
        for (int j = 0; j < t->size[v]; ++j) f->rank[i++] = t->dofs[t->turn[v]] + j;
    for (int k = 0; k < t->m_I; ++k) {
        if (t->in[k] != k) continue;
        int i = t->front[k], at = f->start[i];
        for (int e = t->begin[k]; e < t->begin[k + 1]; ++e)
            for (int j = 0; j < t->size[t->node[t->rows[e]]]; ++j)
                f->rows[at++] = t->dofs[t->rows[e]] + j;
        qsort(f->rows + f->start[i], at - f->start[i], sizeof(int), ascending);
        for (int e = f->start[i]; e < at; ++e) f->inside[i] += f->rows[e] < f->n_I;
    }
}

// Room for the factor, and for what waits on a stack for its parent; waiting has room for count.
static void make_room(fronts *f, int *waiting)
{
    int64_t stack = 0;
    int depth = 0;
    for (int i = 0; i < f->count; ++i) {
        int64_t p = f->first[i + 1] - f->first[i], b = f->start[i + 1] - f->start[i];
        f->factor[i + 1] = f->factor[i] + p * (p + f->inside[i]);
        f->seconds += seconds(p, b);
        if (b > f->widest) f->widest = (int)b;
        if (stack + p * (p + b) + b * b > f->work) f->work = stack + p * (p + b) + b * b;
        for (int c = 0; c < f->children[i]; ++c) {
            int64_t w = waiting[--depth];
            stack -= w * w;
        }
        if (f->inside[i]) {
            waiting[depth++] = (int)b;
            stack += b * b;
        }
    }
}

// Find the fronts for m nodes of size[v] consecutive dofs, their graph, and the m_I nodes of the
// interior in their order. Returns NULL where memory ends; fronts_free frees the result.
fronts *fronts_analyse(int m, const int *size, const int *ptr, const int *adjacent, int m_I,
                       const int *order)
{
    forest t = {0};
    fronts *f = calloc(1, sizeof(fronts));
    int *list = malloc((m + 1) * sizeof(int));
    int ok = f && list && plant(&t, m, size, m_I, order) && find_structures(&t, ptr, adjacent);
    if (ok) merge(&t);
    ok = ok && measure(&t, f, number_fronts(&t, list));
    if (ok) give_ranks(&t, f, list);
    if (ok) make_room(f, list);
    free(list), free(t.rows), free(t.pool);
    if (ok) return f;
    fronts_free(f);
    return NULL;
}

// --- factorisation ------------------------------------------------------------------------------

// Where entry (i, j) of the lower triangle of order n stands in packed format
static int64_t packed(int64_t n, int64_t i, int64_t j) { return j * n - j * (j + 1) / 2 + i; }

// Pivots whose triangle is inverted at once
enum { NARROW = 48 };

// Overwrite W, (p, b), with U⁻ᵀ W. BLAS multiplies with a narrow triangle in a third of the time
// that it takes to divide by one, so the triangles on the diagonal are inverted.
static void divide_border(int p, int b, double *U, double *W, const dense *blas)
{
    double one = 1.0, minus = -1.0, inverse[NARROW * NARROW];
    for (int r = 0; r < p; r += NARROW) {
        int m = p - r < NARROW ? p - r : NARROW, info;
        double *above = U + (int64_t)p * r, *U_r = above + r;
        for (int j = 0; j < m; ++j)
            memcpy(inverse + m * j, U_r + (int64_t)p * j, (j + 1) * sizeof(double));
        if (r) blas->gemm("T", "N", &m, &b, &r, &minus, above, &p, W, &p, &one, W + r, &p);
        blas->trtri("U", "N", &m, inverse, &m, &info);
        blas->trmm("L", "U", "T", "N", &m, &b, &one, inverse, &m, W + r, &p);
    }
}

// Factor K, (n, n): the rows of a matrix that are named, and the columns with a number that is not
// negative, both triangles; held, (p, p), is added to the p pivots of the last front, unless NULL.
// L takes the rows of U and of W inside the interior; S, packed, comes as zeros. work has room for
// f->work, place, dof and at for n, waiting for count. Returns 0, or the rank + 1 of a pivot that
// is not positive.
int fronts_factor(const fronts *f, const int *rows, const int *indptr, const int *indices,
                  const int *number, const double *values, const double *held, double *L,
                  double *S, double *work, int *place, int *dof, int *at, int *waiting,
                  const dense *blas)
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
        for (int64_t j = 0; held && i == f->count - 1 && j < (int64_t)p * p; ++j) P[j] += held[j];
        double *W = P + (int64_t)p * p;
        int info = 0;
        blas->potrf("U", &p, P, &p, &info); // Uᵀ U
        if (info) return first + (info > 0 ? info : 1);
        if (b) {
            divide_border(p, b, P, W, blas);                          // U⁻ᵀ W
            blas->syrk("L", "T", &b, &p, &minus, W, &p, &one, C, &b); // C − Wᵀ W
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

// Overwrite k columns y, (p, k) of n rows, with U⁻¹ y or, transposed, U⁻ᵀ y.
static void divide(char *transposed, int p, int k, double *U, double *y, int n, const dense *blas)
{
    double one = 1.0;
    int each = 1;
    if (k == 1)
        blas->trsv("U", transposed, "N", &p, U, &p, y, &each);
    else
        blas->trsm("L", "U", transposed, "N", &p, &k, &one, U, &p, y, &n);
}

// Z = a W X + c Z or, transposed, a Wᵀ X + c Z, for W, (p, b), and k columns of n and m rows.
static void multiply(char *transposed, double a, int p, int b, int k, double *W, double *X, int n,
                     double c, double *Z, int m, const dense *blas)
{
    int each = 1, rows = *transposed == 'T' ? b : p, inner = *transposed == 'T' ? p : b;
    if (k == 1)
        blas->gemv(transposed, &p, &b, &a, W, &p, X, &each, &c, Z, &each);
    else
        blas->gemm(transposed, "N", &rows, &k, &inner, &a, W, &p, X, &n, &c, Z, &m);
}

// Overwrite k columns Y, (n_I, k), by their ranks, with K_II⁻¹ Y; work has room for f->widest k.
void fronts_solve(const fronts *f, const double *L, int k, double *Y, double *work,
                  const dense *blas)
{
    const int n = f->n_I;
    for (int i = 0; i < f->count; ++i) { // U⁻ᵀ
        const int *border = f->rows + f->start[i];
        const int p = f->first[i + 1] - f->first[i], b = f->inside[i];
        double *U = (double *)L + f->factor[i], *W = U + (int64_t)p * p, *y = Y + f->first[i];
        divide("T", p, k, U, y, n, blas);
        if (b) multiply("T", 1.0, p, b, k, W, y, n, 0.0, work, b, blas);
        for (int c = 0; c < k; ++c)
            for (int j = 0; j < b; ++j) Y[(int64_t)n * c + border[j]] -= work[(int64_t)b * c + j];
    }
    for (int i = f->count - 1; i >= 0; --i) { // U⁻¹
        const int *border = f->rows + f->start[i];
        const int p = f->first[i + 1] - f->first[i], b = f->inside[i];
        double *U = (double *)L + f->factor[i], *W = U + (int64_t)p * p, *y = Y + f->first[i];
        for (int c = 0; c < k; ++c)
            for (int j = 0; j < b; ++j) work[(int64_t)b * c + j] = Y[(int64_t)n * c + border[j]];
        if (b) multiply("N", -1.0, p, b, k, W, work, b, 1.0, y, n, blas);
        divide("N", p, k, U, y, n, blas);
    }
}
