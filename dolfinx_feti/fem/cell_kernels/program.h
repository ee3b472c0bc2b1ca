// Copyright (C) 2026 the dolfinx_feti authors
//
// SPDX-License-Identifier: LGPL-3.0-or-later

// The forms of one quadrature degree as data, made by program.py, and what kernel.py adds for a call.
//
// Constants of the compiler, which program.py writes and kernel.py inserts in kernel.c:
//   GDIM   dimension of space
//   N      quadrature points of a chunk; the rule of a degree is cut into chunks of equal size
//   GROUPS groups of eight cells that one visit computes together
//
// A vector has a number of each of the eight cells of a group. The work space R of a visit is an array of vectors. It
// begins with the registers of the tape, of GROUPS N vectors each: the points of a chunk in all groups. With N = 4 and
// GROUPS = 5, for example, vector k = 9 of a register is point 1 of the chunk in group 2.
typedef struct {
    // forms
    int entries;             // of all forms in a cell
    int forms;
    const int *first_entry;  // of each form, and the end of the last one, (forms + 1,)
    const int *contractions; // of all forms, see Contraction in kernel.c; −1 ends them
    const int *tape;         // instructions, see tape.h
    const double *literals;  // numbers on the tape

    // quadrature rule
    int chunks;
    const double *weight; // (chunks N,); zero pads the last chunk

    // scalar elements; element 0 is that of the geometry
    int elements;
    const int *nodes;         // (elements,)
    const int *has_gradients; // whether ∂φ/∂X of an element is needed, (elements,)
    const int *table_start;   // where the table of each element begins, (elements + 1,)
    const double *table;      // φ, ∂φ/∂ξ of each element, (chunks N, nodes, 1 + GDIM)
    int is_affine;            // whether ∂x/∂ξ is constant in a cell

    // functions; function 0 is the position x
    int functions;
    const int *element;          // (functions,)
    const int *components;       // (functions,)
    const double *const *values; // dofs of the process, (nodes of the process, components) for each function
    const int *const *dofmap;    // (cells, nodes) for each function
    const double *constants;

    // cells of this call
    int n_cells;
    const int *cells; // (n_cells,), or NULL for cells 0 to n_cells - 1

    // offsets in the work space R of a visit, in vectors; the registers of the tape are at 0
    const int *basis_at; // φ, ∂φ/∂X of each element, (nodes, 1 + GDIM, GROUPS N)
    const int *dofs_at;  // dofs of each function, (nodes, components, GROUPS)
    int products_at;     // T of multiply_rows, (nodes, directions, GROUPS N)
    int entries_at;      // results, (GROUPS, entries)
    int work_size;
} Program;

// out[f] ← the entries of form f in the cells of the call, (n_cells, entries of f). Returns 0, or 1 without memory.
int evaluate(const Program *program, double *const *out);

// K ← K + Σ_τ k over the cells τ of the call, with the entries k of the only form. Returns 0, or 1 without memory.
int add_to_matrix(const Program *program, const CsrMatrix *matrix);
