# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""One subdomain alone: its matrix, its Schur complement, its modes, its generalised inverse.

A set-up makes four calls, in this order:

1. ``create_subdomains`` sorts the dofs. A ``Subdomain`` lasts as long as the pattern.
2. ``analyse`` chooses how matrices are factored (``factors``), and orders the eliminations. An
   ``Analysis`` lasts as long as the pattern.
3. ``create_schur_operator`` factors K_II, and forms S if the interior is eliminated. The
   ``SchurOperator`` belongs to one matrix: it is destroyed when the entries of K change.
4. ``create_generalized_inverse`` computes the modes, and factors K_ρ, or S_ρ. The
   ``GeneralizedInverse`` does not refer to the matrix: it may precondition later ones.

Steps 1 and 2 are collective. Steps 3 and 4 work on each process alone, inside of
``failures.on_subdomains``. The other files:

- Tools: failures, blocks, block_diagonal, panels, orthonormal.
- The matrices: matrix (K_i), schur (S_i).
- The modes without energy: kernel_detection (the procedure and its tolerances), null_vectors,
  interior (those of K_II).
- All modes: modes (R, Y, E and D, the result), scaled (the matrix in which they are searched),
  soft_modes (soft and buckling modes), mode_search (the search, from K to the result).

In shapes, subdomain i has n_i free dofs, n_{Γ,i} of them on its interface and n_{I,i} in its
interior. This process has n torn dofs, n_Γ = Σ n_{Γ,i} of them on interfaces. If the interior is
eliminated, S_i replaces K_i, and n_i means n_{Γ,i}. A *block* is what one subdomain contributes to
a block-diagonal matrix: K_i, K_II or S_i. In ``factors`` it is the matrix that is factored. A block
*of dofs* has the bs dofs of one node, where bs is PETSc's block size. *The paper* is Augustin,
Holzapfel and Steinbach 2014 (docs/theory.md).

In the order of the data: subdomain, failures, blocks, block_diagonal, panels, orthonormal, factors,
analysis, matrix, schur, schur_operator, kernel_detection, null_vectors, interior, modes, scaled,
soft_modes, mode_search, generalized_inverse.
"""
