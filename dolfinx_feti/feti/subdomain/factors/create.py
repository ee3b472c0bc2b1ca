# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Choice of the factorisation of a block of a subdomain.

For each block, the first factorisation that applies:

==================================  ======================  =======================================
block                               factorisation           applies if
==================================  ======================  =======================================
sparse K + ρ R Rᵀ + diag(σ)         ``woodbury``, by        the block has a symbolic factor, R is
                                    fronts                  not graded, there is no shift σ; K_Q is
                                                            positive definite, and the last front
                                                            determines R
                                    ``petsc_factor``        always
sparse K_II                         ``multifrontal``,       the block has a symbolic factor; K_II is
                                    forms S, too            positive definite
                                    ``petsc_factor``        always
dense S + ρ R Rᵀ + diag(σ)          ``cholesky``            positive definite
                                    ``bunch_kaufman``       always
dense S + ρ R Rᵀ, for a             ``cholesky`` in         positive definite in single precision
preconditioner                      single precision
                                    like S above            always
==================================  ======================  =======================================

A block has a symbolic factor (:func:`analyse_blocks`) if its matrix is symmetric, its options name
no other solver, PETSc has 32-bit indices, and the C code can be compiled. Two other modules choose
for themselves: ``interior`` searches for null vectors of a singular K_II with ``petsc_factor``, and
``coarse.solver`` factors the coarse matrix by fronts, or by PETSc.

The multifrontal code is part of this package. For a subdomain of 3000 dofs it eliminates the
interior and forms S in a sixth of the time of MUMPS; it factors K in half the time, with half the
memory (docs/results/factors.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.feti.subdomain.factors.bunch_kaufman import factor_bunch_kaufman
from dolfinx_feti.feti.subdomain.factors.cholesky import (
    factor_cholesky,
    factor_cholesky_in_single_precision,
)
from dolfinx_feti.feti.subdomain.factors.multifrontal import FrontCode, create_fronts, load_fronts
from dolfinx_feti.feti.subdomain.factors.packed import PackedMatrix
from dolfinx_feti.feti.subdomain.factors.petsc_factor import factor_by_petsc
from dolfinx_feti.feti.subdomain.factors.petsc_solver import FactorOptions
from dolfinx_feti.feti.subdomain.factors.protocol import EmptyFactor, Factor, SymbolicFactor
from dolfinx_feti.feti.subdomain.factors.woodbury import factor_by_woodbury
from dolfinx_feti.feti.subdomain.factors.work_space import WorkSpace
from dolfinx_feti.feti.subdomain.failures import on_subdomains
from dolfinx_feti.feti.subsolver_options import DirectOptions
from dolfinx_feti.runtime.arrays import Array, Indices
from dolfinx_feti.runtime.collective import warn
from dolfinx_feti.runtime.petsc_library import csr_of, reads_in_place
from dolfinx_feti.torn.matrix import Torn


def multifrontal_code(options: DirectOptions, comm: MPI.Comm) -> FrontCode | None:
    """Return the code of the multifrontal method if it may factor. Collective.

    Args:
        options: Options of the factorisations.
        comm: Processes of the problem.

    Returns:
        The code; None if the options name a solver, or, with a warning, if it cannot be compiled.
    """
    if options.names_solver:
        return None
    try:
        return load_fronts(comm)
    except RuntimeError as error:
        warn(f"MUMPS factors instead, which is slower: {error}", comm)
        return None


def analyse_blocks(
    torn: Torn, blocks: Sequence[Indices], interfaces: Sequence[Indices], options: FactorOptions
) -> Sequence[SymbolicFactor | None]:
    """Create the symbolic factors of disjoint diagonal blocks of K. Collective.

    Args:
        torn: The torn matrix K, (n, n).
        blocks: Torn dofs of each block, ascending, (n_i,).
        interfaces: Dofs of each block that are not eliminated, as indices into the block,
            ascending.
        options: Options of the factors, which may name a solver of PETSc.

    Returns:
        The symbolic factor of each block; None for all if PETSc factors them.

    Raises:
        SetUpError: The analysis of a block failed; on all processes.
    """
    # With 64-bit indices the whole K would be copied for every factor of every block.
    if not options.is_symmetric or not reads_in_place():
        return [None] * len(blocks)
    code = multifrontal_code(options.solver, torn.comm)
    if code is None:
        return [None] * len(blocks)

    def analyse() -> list[SymbolicFactor]:
        place_in_block = np.full(torn.n, -1, dtype=np.int32)
        for rows in blocks:
            place_in_block[rows] = np.arange(len(rows))
        bs = torn.K.getBlockSize()
        return [
            create_fronts(code, torn.graph, rows, place_in_block, bs, interface)
            for rows, interface in zip(blocks, interfaces, strict=True)
        ]

    return on_subdomains(analyse, torn.comm)


@dataclass(frozen=True, slots=True)
class SparseBlock:
    """A diagonal block K[rows, rows], (n_i, n_i), and the means of its factorisation.

    Attributes:
        K: Sequential matrix of all subdomains, (n, n).
        rows: Rows and columns of the block, (n_i,).
        options: Settings of the solver of PETSc.
        symbolic: Symbolic factor of the block, or, for the interior of a subdomain of which S is
            formed, of the subdomain with its interface; None if PETSc factors the block.
        work: Work space, shared with other blocks.
    """

    K: PETSc.Mat
    rows: Indices
    options: FactorOptions
    symbolic: SymbolicFactor | None
    work: WorkSpace


def factor_sparse(
    block: SparseBlock, R: Array, rho: float, shift: Array | None = None, *, is_graded: bool = False
) -> Factor:
    """Factor a sparse block, K[rows, rows] + ρ R Rᵀ + diag(shift).

    Args:
        block: The block K[rows, rows], (n_i, n_i).
        R: Columns, (n_i, k); orthonormal unless they are graded or there is a shift.
        rho: Stiffness ρ.
        shift: Addend of the diagonal, (n_i,); None for zero.
        is_graded: Whether the norms of the rows of R span many orders of magnitude. Then K_Q of
            ``woodbury`` is badly conditioned, and PETSc factors the block.

    Raises:
        FactorError: The factorisation failed.
        MemoryError: Memory ran out.
    """
    if block.symbolic is not None and shift is None and not is_graded and len(block.rows):
        with csr_of(block.K) as csr:
            factor = factor_by_woodbury(block.symbolic, csr, R, rho, block.work)
        if factor is not None:
            return factor
    return factor_by_petsc(block.K, block.rows, block.options, R, rho, shift)


def factor_interior(interior: SparseBlock) -> tuple[Factor, Array | None]:
    """Factor K_II of a subdomain; form S if the factorisation yields it.

    Args:
        interior: The block K_II, (n_{I,i}, n_{I,i}).

    Returns:
        The factor of K_II; and the Schur complement S on the interface of the symbolic factor,
        packed, (n_{Γ,i} (n_{Γ,i} + 1) / 2,), or None after a factorisation by PETSc.

    Raises:
        FactorError: The factorisation failed.
        MemoryError: Memory ran out.
    """
    if interior.symbolic is not None:
        with csr_of(interior.K) as csr:
            eliminated = interior.symbolic.factor(csr, interior.work)
        if eliminated is not None:
            return eliminated.factor, eliminated.schur
    return factor_by_petsc(interior.K, interior.rows, interior.options), None


def factor_dense(S: PackedMatrix, R: Array, rho: float, shift: Array | None = None) -> Factor:
    """Factor a dense block S + ρ R Rᵀ + diag(shift).

    Args:
        S: The block, (n, n).
        R: Columns, (n, k).
        rho: Stiffness ρ.
        shift: Addend of the diagonal, (n,); None for zero.

    Raises:
        FactorError: A pivot is zero.
    """
    if S.n == 0:
        return EmptyFactor()
    factor = factor_cholesky(S, R, rho, shift)
    if factor is not None:
        return factor
    return factor_bunch_kaufman(S, R, rho, shift)


def factor_dense_for_preconditioner(S: PackedMatrix, R: Array, rho: float) -> Factor:
    """Factor a dense block S + ρ R Rᵀ, in single precision if it is positive definite there.

    Args:
        S: The block, (n, n).
        R: Columns, (n, k).
        rho: Stiffness ρ, a mean stiffness of the block.

    Returns:
        The factor, in double precision if the matrix is not positive definite in single precision.

    Raises:
        FactorError: A pivot is zero.
    """
    if S.n == 0:
        return EmptyFactor()
    factor = factor_cholesky_in_single_precision(S, R, rho)
    if factor is not None:
        return factor
    return factor_dense(S, R, rho)
