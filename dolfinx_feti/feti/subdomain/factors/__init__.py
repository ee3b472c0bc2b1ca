# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Factorisations of the matrix of one subdomain, or of its interior; ``create`` chooses one.

``protocol`` has two interfaces. A *symbolic factor* belongs to a pattern and computes numeric
factors of its matrices; a *factor* belongs to one matrix and solves. The files of ``subdomain``
depend on these interfaces only.

To add a dense factorisation, write a class with the methods of ``Factor``, and a branch in
``create.factor_dense``, which treats blocks without rows itself. ``PackedMatrix`` returns the block
in a work space that others overwrite later: the factor has to be a copy, such as a packed one.

To add a sparse factorisation, write classes with the methods of ``SymbolicFactor`` and of
``Factor``, a pair of both results like ``multifrontal.FrontElimination``, and a branch in
``create.analyse_blocks``. Name the file in the order at the end, which tests/test_rooms.py reads,
and add the factorisation to ``factor_block`` in tests/feti/subdomain/factors/test_factors.py. Four
points:

- For a block with an interface it has to form S. If it cannot, leave these blocks to the present
  branch.
- For an indefinite matrix ``SymbolicFactor.factor`` has to return None, even if it can factor it:
  ``woodbury`` counts the negative eigenvalues of K_ρ on that assumption.
- ``woodbury`` adds a dense matrix on the dofs ``SymbolicFactor.last_dofs``, by ``factor_sum``. If
  there are none, ``petsc_factor`` factors every block with modes R, such as those of all floating
  subdomains. To avoid that, add a branch to ``create.factor_sparse`` that factors K + ρ R Rᵀ.
- The options choose between the factorisations of this package and the solvers of PETSc
  (``DirectOptions`` in ``feti.subsolver_options``). An option that chooses among the former is a
  new field there.

A direct solver of PETSc needs no code if it factors indefinite matrices, such as the bordered one
of ``petsc_factor``. The options ``feti_local_pc_factor_mat_solver_type`` (of K_ρ) and
``feti_dirichlet_pc_factor_mat_solver_type`` (of K_II) select it instead of MUMPS.

=================  ====================================================  ===========================
file               matrix                                                factorisation
=================  ====================================================  ===========================
``cholesky``       dense, definite; in double or in single precision     L Lᵀ, LAPACK
``bunch_kaufman``  dense, symmetric                                      L Δ Lᵀ with pivots, LAPACK
``multifrontal``   sparse, definite, with an interface or without        Uᵀ U by fronts, in C
``woodbury``       sparse K + ρ R Rᵀ, symmetric                          a symbolic factor, and a
                                                                         correction of rank 2 k
``petsc_factor``   sparse K + ρ R Rᵀ + diag(σ), any                      MUMPS or another direct
                                                                         solver, with pivots
=================  ====================================================  ===========================

In the order of the data: work_space, protocol, packed, cholesky, bunch_kaufman, petsc_solver,
petsc_factor, nested_dissection, multifrontal, woodbury, create.
"""
