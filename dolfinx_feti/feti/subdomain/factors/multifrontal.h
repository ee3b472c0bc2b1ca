// Copyright (C) 2026 the dolfinx_feti authors
//
// SPDX-License-Identifier: LGPL-3.0-or-later
//
// Interface between multifrontal.py, which reads this file, and multifrontal.c.
//
// Shapes: a process has n dofs in all its subdomains. One subdomain has n_i dofs, n_I of them in its
// interior and n_Γ on its interface. Its graph has m nodes; a node is a group of consecutive dofs
// that are eliminated together. The rank of a dof is its place in the order of elimination, not a
// rank of MPI; the dofs of Γ have the last n_Γ ranks. Dense matrices are stored column by column.
//
// No function keeps a pointer that it is passed. cffi parses this file, which therefore has no
// preprocessor directives: multifrontal.c includes stdint.h first.

// Status that a function returns. DONE is zero; all others are failures.
enum {
    DONE,
    NO_MEMORY,    // for the integers of the analysis or of the factorisation
    TOO_LARGE,    // a number of dofs exceeds 32 bits, or a number of bytes 64
    INVALID,      // the graph, or the order of its nodes, is inconsistent
    NOT_DEFINITE, // K_II is not positive definite
    NEW_PATTERN   // the matrix has an entry outside of the fronts
};

// The graph of the matrix of a subdomain, and the order in which its interior is eliminated.
typedef struct {
    int nodes;           // m
    const int *size;     // dofs of each node, (m)
    const int *ptr;      // place of the first neighbour of each node, (m + 1)
    const int *adjacent; // neighbours of all nodes, (ptr[m])
    int interior_nodes;  // number of nodes of the interior, m_I
    const int *order;    // nodes of the interior, the first to be eliminated first, (m_I)
} subdomain_graph;

// The matrix of all subdomains of a process by compressed rows, (n, n), and the rows of one.
typedef struct {
    int n;                  // order of the matrix
    const int *indptr;      // place of the first entry of each row, (n + 1)
    const int *indices;     // column of each entry, (indptr[n])
    const double *values;   // (indptr[n])
    const int *rows;        // rows of the subdomain, ascending, (n_i)
    const int *local_index; // place of each row among those of its subdomain, or negative, (n)
} process_matrix;

typedef struct front front; // of multifrontal.c

// The fronts of a graph, each of which passes its update matrix to its parent. They depend only on
// the pattern of the matrix.
typedef struct {
    int n_i;                // dofs
    int n_I;                // dofs of the interior
    int front_count;        // number of fronts
    int max_update_rows;    // largest number of update rows of a front
    int max_pivots;         // largest number of pivots of a front
    int last_front_rank;    // rank of the first pivot of the last front
    int *rank_of_dof;       // (n_i)
    int *dof_of_rank;       // (n_i)
    int *update_ranks;      // ranks of the update rows of all fronts, ascending in each
    front *fronts;          // children before parents, and a front that marks the end,
                            // (front_count + 1)
    int64_t factor_entries; // entries of the factor of K_II
    int64_t work_entries;   // entries of the work space of a factorisation
    double flops;           // operations of a factorisation
} assembly_tree;

// What a factorisation writes.
typedef struct {
    double *factor; // U of each front, packed, then its W in the interior, (factor_entries)
    double *schur;  // S, its lower triangle packed, zero on entry, (n_Γ (n_Γ + 1) / 2)
    double *work;   // (work_entries)
} factor_storage;

// Routines of BLAS and LAPACK in double precision, with the arguments of Fortran.
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
} dense_routines;

// Find the fronts of a graph.
//
// result: the fronts, which multifrontal_free frees; NULL on failure.
// Returns DONE, NO_MEMORY, TOO_LARGE or INVALID.
int multifrontal_analyse(const subdomain_graph *graph, assembly_tree **result);

// Factor K_II and form S for one matrix.
//
// addend_on_last: added to K_II on the pivots of the last front, (p, p); NULL for none.
// Returns DONE, NO_MEMORY, NOT_DEFINITE or NEW_PATTERN. After a failure the contents of the storage
// are arbitrary.
int multifrontal_factor(const assembly_tree *tree, const process_matrix *K,
                        const double *addend_on_last, const factor_storage *storage,
                        const dense_routines *dense);

// Y = K_II⁻¹ Y for r columns.
//
// factor: from multifrontal_factor, (factor_entries). Y: (n_I, r), rows numbered by ranks.
// work: (max_update_rows r), and at least (max_pivots²) if r > 1.
void multifrontal_solve(const assembly_tree *tree, const double *factor, int r, double *Y,
                        double *work, const dense_routines *dense);

// Return the smallest square of a diagonal entry of U; infinity if there is none.
double multifrontal_smallest_pivot(const assembly_tree *tree, const double *factor);

// Free what multifrontal_analyse returned.
void multifrontal_free(assembly_tree *tree);
