// Copyright (C) 2026 the dolfinx_feti authors
//
// SPDX-License-Identifier: LGPL-3.0-or-later
//
// Multifrontal Cholesky factorisation that stops at the interface Γ (Duff and Reid 1983, Liu 1992):
//
//     K = ( K_II  K_IΓ ) = ( Uᵀ    ) ( U  W ),   U upper triangular,   S = K_ΓΓ − Wᵀ W.
//         ( K_ΓI  K_ΓΓ )   ( Wᵀ  I ) (    S )
//
// The analysis sees the graph of K only: nodes, groups of dofs that are eliminated together. The
// factorisation works on dense matrices, one front after the other. The rank of a dof is its place
// in the order of elimination; those of Γ come last. Matrices are stored column by column.

#include <limits.h>
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

// What the functions return
enum { DONE, NO_MEMORY, TOO_LARGE, INVALID, NOT_DEFINITE, NEW_PATTERN };

// A front has p pivots, dofs that are eliminated in it, and q update rows: the dofs that these are
// coupled with and that are eliminated later, or of Γ.
typedef struct {
    int first;      // rank of the first pivot
    int p, q;       // pivots, update rows
    int inside;     // update rows of the interior, which come first
    int children;   // fronts whose update matrix is added to this one
    int64_t begin;  // where the update rows begin in fronts.rows
    int64_t factor; // where U, packed, and then the rows of W in the interior begin in the factor
} front;

typedef struct {
    int n, n_I;      // dofs, dofs of the interior
    int count;       // fronts, children before parents
    int widest;      // most update rows of a front
    int thickest;    // most pivots of a front
    int last;        // rank of the first pivot of the last front
    int *rank, *dof; // rank of each dof, and back, (n)
    int *rows;       // ranks of the update rows of all fronts, ascending in each
    front *front;    // (count + 1)
    int64_t entries; // entries of the factor of K_II
    int64_t work;    // entries of the work space of a factorisation
    double flops;    // of a factorisation
} fronts;

// Routines of BLAS and LAPACK, with the arguments of Fortran
typedef struct {
    void (*potrf)(char *, int *, double *, int *, int *);
    void (*trtri)(char *, char *, int *, double *, int *, int *);
    void (*trsm)(char *, char *, char *, char *, int *, int *, double *, double *, int *, double *,
                 int *);
    void (*trmm)(char *, char *, char *, char *, int *, int *, double *, double *, int *, double *,
                 int *);
    void (*syrk)(char *, char *, int *, int *, double *, double *, int *, double *, double *,
                 int *);
    void (*gemm)(char *, char *, int *, int *, int *, double *, double *, int *, double *, int *,
                 double *, double *, int *);
    void (*tpsv)(char *, char *, char *, int *, double *, double *, int *);
    void (*gemv)(char *, int *, int *, double *, double *, int *, double *, int *, double *,
                 double *, int *);
} dense;

void fronts_free(fronts *f)
{
    if (f) free(f->rank), free(f->dof), free(f->rows), free(f->front), free(f);
}

// --- analysis -----------------------------------------------------------------------------------

// One step of the elimination, of one node. The steps of the interior form the elimination tree:
// the parent of a step is the first one of its structure.
typedef struct {
    int node;
    int p, q, inside; // of its front, see above
    int parent;       // −1 for a root
    int child;        // last child, −1 for none
    int sibling;      // child of the same parent before it, −1 for none
    int merged;       // the last step of its front
    int front;        // number of that front
    int fronts;       // fronts of its subtree
    int rank;         // rank of the first dof of the node
    int64_t begin;    // where its structure, the later steps that it is coupled with, begins in rows
} step;

typedef struct {
    int m, m_I;         // nodes, nodes of the interior
    const int *size;    // dofs of each node
    int *step_of;       // step of each node, those of Γ last
    int *mark;          // the last step with this one in its structure; then work space
    int *rows;          // all structures
    int64_t used, room; // entries of rows
    step *step;         // (m + 1)
} tree;

static double flops(double p, double q) { return p * p * p / 3 + p * p * q + p * q * q; }

// Estimated time of a front: calls, sums of update matrices, rows of the factor, flops
static double seconds(double p, double q)
{
    return 3e-6 + 1e-9 * q * q + 8e-9 * p * (p + q) + flops(p, q) / 50e9;
}

// Number the steps: the interior in its order, then Γ.
static int initialise(tree *t, const int *order)
{
    int next = t->m_I;
    t->step = calloc((size_t)t->m + 1, sizeof(step));
    t->step_of = malloc(((size_t)t->m + 1) * sizeof(int));
    t->mark = malloc(((size_t)t->m + 1) * sizeof(int));
    if (!t->step || !t->step_of || !t->mark) return NO_MEMORY;
    for (int v = 0; v < t->m; ++v) t->step_of[v] = t->mark[v] = -1;
    for (int k = 0; k < t->m_I; ++k) {
        if (order[k] < 0 || order[k] >= t->m || t->step_of[order[k]] >= 0) return INVALID;
        t->step_of[order[k]] = k;
    }
    for (int v = 0; v < t->m; ++v) {
        if (t->step_of[v] < 0) t->step_of[v] = next++;
        const int k = t->step_of[v];
        t->step[k] = (step){.node = v, .parent = -1, .child = -1, .sibling = -1, .merged = k};
    }
    return DONE;
}

static void include(tree *t, int k, int j)
{
    if (j <= k || t->mark[j] == k) return;
    t->mark[j] = k;
    t->rows[t->used++] = j;
}

// Symbolic factorisation: structure(k) = {j > k coupled with k} ∪ ⋃ structure(children of k) \ {k}
static int find_structures(tree *t, const int *ptr, const int *adjacent)
{
    step *const s = t->step;
    for (int k = 0; k < t->m_I; ++k) {
        const int v = s[k].node;
        int parent = t->m_I;
        if (t->used + t->m > t->room) {
            t->room = 2 * t->room + 64 * (int64_t)t->m;
            int *const more = realloc(t->rows, t->room * sizeof(int));
            if (!more) return NO_MEMORY;
            t->rows = more;
        }
        s[k].begin = t->used;
        for (int e = ptr[v]; e < ptr[v + 1]; ++e) {
            if (adjacent[e] < 0 || adjacent[e] >= t->m) return INVALID;
            include(t, k, t->step_of[adjacent[e]]);
        }
        for (int c = s[k].child; c >= 0; c = s[c].sibling)
            for (int64_t e = s[c].begin; e < s[c + 1].begin; ++e) include(t, k, t->rows[e]);
        s[k + 1].begin = t->used;
        s[k].p = t->size[v];
        for (int64_t e = s[k].begin; e < t->used; ++e) {
            const int j = t->rows[e], dofs = t->size[s[j].node];
            s[k].q += dofs;
            if (j < t->m_I) s[k].inside += dofs;
            if (j < parent) parent = j;
        }
        if (parent == t->m_I) continue;
        s[k].parent = parent;
        s[k].sibling = s[parent].child;
        s[parent].child = k;
    }
    return DONE;
}

// Merge a child with its parent where that saves time: the front has the parent's update rows then.
// A root without update rows, whose pivots may be asked to hold rigid modes, has more than a few.
static void merge(tree *t)
{
    enum { FEW = 64 };
    step *const s = t->step;
    for (int k = 0; k < t->m_I; ++k) {
        if (s[k].parent < 0) continue;
        step *const parent = s + s[k].parent;
        const double apart = seconds(s[k].p, s[k].q) + seconds(parent->p, parent->q);
        if (seconds(s[k].p + parent->p, parent->q) > apart) continue;
        s[k].merged = s[k].parent;
        parent->p += s[k].p;
    }
    for (int k = t->m_I - 1; k >= 0; --k) {
        s[k].merged = s[s[k].merged].merged;
        if (s[k].parent < 0) continue;
        s[k].parent = s[s[k].parent].merged;
        step *const parent = s + s[k].parent;
        if (s[k].merged != k || parent->q || parent->p >= FEW) continue;
        s[k].merged = s[k].parent;
        parent->p += s[k].p;
    }
}

// Number the fronts in postorder: those of a subtree are consecutive, its root is the last of them.
static int postorder(tree *t)
{
    step *const s = t->step;
    int count = 0, *const next = t->mark; // next number of each subtree
    for (int k = 0; k < t->m_I; ++k) {
        if (s[k].merged != k) continue;
        ++s[k].fronts;
        if (s[k].parent >= 0) s[s[k].parent].fronts += s[k].fronts;
    }
    for (int k = t->m_I - 1; k >= 0; --k) {
        int *const first = s[k].parent < 0 ? &count : next + s[k].parent;
        if (s[k].merged == k) {
            next[k] = *first;
            *first += s[k].fronts;
            s[k].front = *first - 1;
        } else
            s[k].front = s[s[k].merged].front;
    }
    return count;
}

// Sizes of the fronts, of the factor, and of the stack of update matrices that wait for the parent
static int find_sizes(tree *t, fronts *f)
{
    const int64_t most = INT64_MAX / sizeof(double);
    int64_t stack = 0;
    int depth = 0, *const waiting = t->mark;
    f->front = calloc((size_t)f->count + 1, sizeof(front));
    if (!f->front) return NO_MEMORY;
    for (int k = 0; k < t->m_I; ++k) {
        const step *const s = t->step + k;
        if (s->merged != k) continue;
        front *const F = f->front + s->front;
        F->p = s->p, F->q = s->q, F->inside = s->inside;
        if (s->parent >= 0) ++f->front[t->step[s->parent].front].children;
    }
    for (front *F = f->front; F < f->front + f->count; ++F) {
        const int64_t p = F->p, q = F->q, work = stack + p * (p + q) + q * q;
        if (work > f->work) f->work = work;
        F[1].first = F->first + F->p;
        F[1].begin = F->begin + q;
        F[1].factor = F->factor + p * (p + 1) / 2 + p * F->inside;
        if (p > f->thickest) f->thickest = p;
        if (f->work > most || F[1].factor > most) return TOO_LARGE;
        for (int c = 0; c < F->children; ++c) {
            const int64_t u = waiting[--depth];
            stack -= u * u;
        }
        if (F->inside) {
            waiting[depth++] = F->q;
            stack += q * q;
        }
        if (F->q > f->widest) f->widest = F->q;
        f->last = F->first;
        f->flops += flops(p, q);
    }
    f->n_I = f->front[f->count].first;
    f->entries = f->front[f->count].factor;
    return DONE;
}

static int ascending(const void *a, const void *b) { return *(const int *)a - *(const int *)b; }

// Ranks of the dofs and of the update rows
static int find_ranks(tree *t, fronts *f)
{
    step *const s = t->step;
    int interface = f->n_I, *const next = t->mark;
    f->rank = malloc(((size_t)f->n + 1) * sizeof(int));
    f->dof = malloc(((size_t)f->n + 1) * sizeof(int));
    f->rows = malloc((f->front[f->count].begin + 1) * sizeof(int));
    if (!f->rank || !f->dof || !f->rows) return NO_MEMORY;
    for (int i = 0; i < f->count; ++i) next[i] = f->front[i].first;
    for (int k = 0; k < t->m; ++k) {
        int *const rank = k < t->m_I ? next + s[k].front : &interface;
        s[k].rank = *rank;
        *rank += t->size[s[k].node];
    }
    for (int v = 0, i = 0; v < t->m; ++v)
        for (int j = 0; j < t->size[v]; ++j) f->rank[i++] = s[t->step_of[v]].rank + j;
    for (int i = 0; i < f->n; ++i) f->dof[f->rank[i]] = i;
    for (int k = 0; k < t->m_I; ++k) {
        if (s[k].merged != k) continue;
        const front *const F = f->front + s[k].front;
        int *row = f->rows + F->begin;
        for (int64_t e = s[k].begin; e < s[k + 1].begin; ++e) {
            const step *const later = s + t->rows[e];
            for (int j = 0; j < t->size[later->node]; ++j) *row++ = later->rank + j;
        }
        qsort(f->rows + F->begin, F->q, sizeof(int), ascending);
    }
    return DONE;
}

// Find the fronts of a graph of m nodes, of size[v] consecutive dofs each, of which m_I are
// eliminated in a given order. The result is to be freed by fronts_free; it is NULL on failure.
int fronts_analyse(int m, const int *size, const int *ptr, const int *adjacent, int m_I,
                   const int *order, fronts **result)
{
    tree t = {.m = m, .m_I = m_I, .size = size};
    int64_t n = 0;
    *result = NULL;
    if (m < 0 || m_I < 0 || m_I > m) return INVALID;
    for (int v = 0; v < m; ++v) {
        if (size[v] < 1) return INVALID;
        n += size[v];
    }
    if (n >= INT_MAX) return TOO_LARGE;
    fronts *const f = calloc(1, sizeof(fronts));
    int status = f ? initialise(&t, order) : NO_MEMORY;
    if (!status) status = find_structures(&t, ptr, adjacent);
    if (!status) {
        merge(&t);
        f->n = (int)n;
        f->count = postorder(&t);
        status = find_sizes(&t, f);
    }
    if (!status) status = find_ranks(&t, f);
    free(t.step), free(t.step_of), free(t.mark), free(t.rows);
    if (status)
        fronts_free(f);
    else
        *result = f;
    return status;
}

// --- factorisation ------------------------------------------------------------------------------

// The matrix, row by row, (N, N). The subdomain has n rows of it; number is, for each column, its
// place among them, or negative.
typedef struct {
    int N;
    const int *rows, *indptr, *indices, *number;
    const double *values;
} matrix;

// Rank of the dof that a column belongs to; −1 for none, n for a column of another subdomain
static inline int rank_of(const fronts *f, const matrix *K, int column)
{
    if (column < 0 || column >= K->N) return f->n;
    const int j = K->number[column];
    if (j < 0) return -1;
    return j < f->n && K->rows[j] == column ? f->rank[j] : f->n;
}

// Where entry (i, j) of the lower triangle of order n stands in packed format
static int64_t packed(int64_t n, int64_t i, int64_t j) { return j * n - j * (j + 1) / 2 + i; }

// S = K_ΓΓ
static int assemble_interface(const fronts *f, const matrix *K, double *S)
{
    const int n_Gamma = f->n - f->n_I;
    for (int r = f->n_I; r < f->n; ++r)
        for (int row = K->rows[f->dof[r]], e = K->indptr[row]; e < K->indptr[row + 1]; ++e) {
            const int s = rank_of(f, K, K->indices[e]);
            if (s < r) continue;
            if (s >= f->n) return NEW_PATTERN;
            S[packed(n_Gamma, s - f->n_I, r - f->n_I)] += K->values[e];
        }
    return DONE;
}

// (P, Q) = rows of the pivots of K, (p, p + q), from the diagonal on. place is where a rank stands
// in the front, negative for those that are not in it.
static int assemble(const fronts *f, const front *F, const matrix *K, const int *place, double *P)
{
    memset(P, 0, F->p * ((int64_t)F->p + F->q) * sizeof(double));
    for (int r = F->first; r < F->first + F->p; ++r)
        for (int row = K->rows[f->dof[r]], e = K->indptr[row]; e < K->indptr[row + 1]; ++e) {
            const int s = rank_of(f, K, K->indices[e]);
            if (s < r) continue;
            if (s >= f->n || place[s] < 0) return NEW_PATTERN;
            P[r - F->first + (int64_t)F->p * place[s]] += K->values[e];
        }
    return DONE;
}

// Extend-add: (P, Q; C) += the update matrix of a child, (u, u), whose rows stand at these places.
static void extend_add(int p, int q, double *restrict P, double *restrict C, int u, const int *at,
                       const double *restrict update)
{
    for (int j = 0; j < u; ++j) {
        const double *const column = update + (int64_t)u * j;
        double *const to = at[j] < p ? P + at[j] : C + (int64_t)q * (at[j] - p);
        if (at[j] < p)
            for (int l = j; l < u; ++l) to[(int64_t)p * at[l]] += column[l];
        else
            for (int l = j; l < u; ++l) to[at[l] - p] += column[l];
    }
}

// W = U⁻ᵀ Q, (p, q), in place. BLAS multiplies with a narrow triangle in a third of the time that
// it takes to solve with one, so that the triangles on the diagonal are inverted.
static void solve_update_columns(int p, int q, double *U, double *W, const dense *blas)
{
    enum { NARROW = 48 };
    double one = 1.0, minus = -1.0, inverse[NARROW * NARROW];
    for (int r = 0; r < p; r += NARROW) {
        int m = p - r < NARROW ? p - r : NARROW, info;
        double *above = U + (int64_t)p * r, *U_r = above + r;
        for (int j = 0; j < m; ++j)
            memcpy(inverse + m * j, U_r + (int64_t)p * j, (j + 1) * sizeof(double));
        if (r) blas->gemm("T", "N", &m, &q, &r, &minus, above, &p, W, &p, &one, W + r, &p);
        blas->trtri("U", "N", &m, inverse, &m, &info);
        blas->trmm("L", "U", "T", "N", &m, &q, &one, inverse, &m, W + r, &p);
    }
}

// (P, Q; C) ↦ (U, W; C − Wᵀ W), P = Uᵀ U, W = U⁻ᵀ Q; C is its lower triangle.
static int eliminate(int p, int q, double *P, double *C, const dense *blas)
{
    double one = 1.0, minus = -1.0, *W = P + (int64_t)p * p;
    int info = 0;
    blas->potrf("U", &p, P, &p, &info);
    if (info) return NOT_DEFINITE;
    if (q) {
        solve_update_columns(p, q, P, W, blas);
        blas->syrk("L", "T", &q, &p, &minus, W, &p, &one, C, &q);
    }
    return DONE;
}

// (U, W), (p, p + inside), as a factor has them: U packed, column by column, then W.
static void store(int p, int inside, const double *U, double *L)
{
    for (int j = 0; j < p; L += ++j) memcpy(L, U + (int64_t)p * j, (j + 1) * sizeof(double));
    memcpy(L, U + (int64_t)p * p, (int64_t)p * inside * sizeof(double));
}

// Factor K; held, (p, p), is added to the p pivots of the last front, unless NULL. L takes U of each
// front, packed, and the rows of W in the interior; S, packed, comes as zeros; work has room for
// f->work. NEW_PATTERN is returned for an entry of K outside of the fronts.
int fronts_factor(const fronts *f, int N, const int *rows, const int *indptr,
                  const int *indices, const int *number, const double *values, const double *held,
                  double *L, double *S, double *work, const dense *blas)
{
    const matrix K = {N, rows, indptr, indices, number, values};
    const int n_I = f->n_I, n_Gamma = f->n - n_I;
    int *const place = malloc(((size_t)f->n + f->widest + f->count + 1) * sizeof(int));
    if (!place) return NO_MEMORY;
    int *const at = place + f->n, *const stack = at + f->widest, depth = 0;
    double *top = work; // of the update matrices that wait
    for (int r = 0; r < f->n; ++r) place[r] = -1;
    int status = assemble_interface(f, &K, S);
    for (int i = 0; i < f->count && !status; ++i) {
        const front *const F = f->front + i;
        const int p = F->p, q = F->q, *const later = f->rows + F->begin;
        double *const P = top, *const C = top + p * ((int64_t)p + q);
        for (int j = 0; j < p; ++j) place[F->first + j] = j;
        for (int j = 0; j < q; ++j) place[later[j]] = p + j;
        for (int j = 0; j < q; ++j) memset(C + (int64_t)q * j + j, 0, (q - j) * sizeof(double));
        status = assemble(f, F, &K, place, P);
        for (int c = 0; c < F->children; ++c) {
            const front *const child = f->front + stack[--depth];
            top -= (int64_t)child->q * child->q;
            for (int j = 0; j < child->q; ++j) at[j] = place[f->rows[child->begin + j]];
            extend_add(p, q, P, C, child->q, at, top);
        }
        for (int j = 0; j < q; ++j) place[later[j]] = -1;
        if (held && i == f->count - 1)
            for (int64_t j = 0; j < (int64_t)p * p; ++j) P[j] += held[j];
        if (!status) status = eliminate(p, q, P, C, blas);
        if (status) break;
        store(p, F->inside, P, L + F->factor);
        if (F->inside) {
            memmove(top, C, (int64_t)q * q * sizeof(double));
            top += (int64_t)q * q;
            stack[depth++] = i;
        } else // the update matrix of a root is part of S
            for (int j = 0; j < q; ++j)
                for (int l = j; l < q; ++l)
                    S[packed(n_Gamma, later[l] - n_I, later[j] - n_I)] += C[(int64_t)q * j + l];
    }
    free(place);
    return status;
}

// Least square of a diagonal entry of U; infinite without any
double fronts_least_pivot(const fronts *f, const double *L)
{
    double least = INFINITY;
    for (const front *F = f->front; F < f->front + f->count; ++F) {
        const double *U = L + F->factor;
        for (int j = 0; j < F->p; U += ++j)
            if (U[j] * U[j] < least) least = U[j] * U[j];
    }
    return least;
}

// --- solution -----------------------------------------------------------------------------------

// y = U⁻¹ y or, transposed, U⁻ᵀ y, for k columns, (p, k), of n rows; work has room for p² entries
static void solve_triangle(char *transposed, int p, int k, double *U, double *y, int n,
                           double *work, const dense *blas)
{
    double one = 1.0;
    int stride = 1;
    if (k == 1) {
        blas->tpsv("U", transposed, "N", &p, U, y, &stride);
        return;
    }
    for (int j = 0; j < p; U += ++j) memcpy(work + (int64_t)p * j, U, (j + 1) * sizeof(double));
    blas->trsm("L", "U", transposed, "N", &p, &k, &one, work, &p, y, &n);
}

// Z = a W X + c Z or, transposed, a Wᵀ X + c Z, for W, (p, q), and k columns of n and m rows
static void multiply(char *transposed, double a, int p, int q, int k, double *W, double *X, int n,
                     double c, double *Z, int m, const dense *blas)
{
    int stride = 1, rows = *transposed == 'T' ? q : p, inner = *transposed == 'T' ? p : q;
    if (k == 1)
        blas->gemv(transposed, &p, &q, &a, W, &p, X, &stride, &c, Z, &stride);
    else
        blas->gemm(transposed, "N", &rows, &k, &inner, &a, W, &p, X, &n, &c, Z, &m);
}

// Y = U⁻¹ U⁻ᵀ Y for k columns, (n_I, k), by ranks; work has room for f->widest k, and for several
// columns f->thickest² at least.
void fronts_solve(const fronts *f, const double *L, int k, double *Y, double *work,
                  const dense *blas)
{
    const int n = f->n_I;
    for (const front *F = f->front; F < f->front + f->count; ++F) { // U⁻ᵀ
        const int p = F->p, q = F->inside, *const rows = f->rows + F->begin;
        double *U = (double *)L + F->factor, *W = U + (int64_t)p * (p + 1) / 2, *y = Y + F->first;
        solve_triangle("T", p, k, U, y, n, work, blas);
        if (q) multiply("T", 1.0, p, q, k, W, y, n, 0.0, work, q, blas);
        for (int c = 0; c < k; ++c)
            for (int j = 0; j < q; ++j) Y[(int64_t)n * c + rows[j]] -= work[(int64_t)q * c + j];
    }
    for (const front *F = f->front + f->count; F-- > f->front;) { // U⁻¹
        const int p = F->p, q = F->inside, *const rows = f->rows + F->begin;
        double *U = (double *)L + F->factor, *W = U + (int64_t)p * (p + 1) / 2, *y = Y + F->first;
        for (int c = 0; c < k; ++c)
            for (int j = 0; j < q; ++j) work[(int64_t)q * c + j] = Y[(int64_t)n * c + rows[j]];
        if (q) multiply("N", -1.0, p, q, k, W, work, q, 1.0, y, n, blas);
        solve_triangle("N", p, k, U, y, n, work, blas);
    }
}
