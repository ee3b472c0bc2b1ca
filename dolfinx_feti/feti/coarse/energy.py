# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Combinations of the coarse columns that are independent in energy, subdomain by subdomain.

.. math:: B^⊤ (V^⊤ A\, V)\, B, \qquad b_j^⊤ (V^⊤ A\, V)\, b_j = ±1

with a block-diagonal B, (n_c, n_0), n_0 ≤ n_c. For each subdomain, the matrix
:math:`H_i = U_i^⊤ δ\, T_i A\, T_i^⊤ δ\, U_i` of the energies of its averaged columns, (k_i, k_i),
is scaled to a diagonal of ±1. Eigenvectors whose eigenvalue is rounding are *combinations of zero
energy*, the columns of :math:`B_0`; the others, scaled to energy ±1, are the columns of B. Columns
of different subdomains may still depend on each other. Then :math:`A_0` has a zero pivot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import scipy.sparse

from dolfinx_feti.feti.subdomain.block_diagonal import block_diagonal, distributed_block_diagonal
from dolfinx_feti.feti.subdomain.orthonormal import symmetric_part, unit_scale
from dolfinx_feti.runtime.arrays import Array, Numbers


@dataclass(frozen=True, slots=True)
class EnergyTolerances:
    """Energies up to which combinations of columns are dropped.

    Attributes:
        zero_energy: Energy of a combination of columns of unit energy up to which it is zero.
        zero_pivot: Pivot of A₀, relative to the norm of A₀, up to which it is zero.
    """

    zero_energy: float
    zero_pivot: float


#: Tolerances without a high contrast. Dependent columns leave 1e-15 to 1e-14 by rounding, so that
#: 1e-10 is far above it. It has to be below the energy in which independent columns differ: with
#: 1e-6, a plate of t/L = 1/1000 takes 1900 iterations instead of 34; with 1e-11 it takes 34, too.
#: Eliminating the neighbours' columns reduces a pivot further: one that is kept by the first
#: tolerance must not be dropped by the second, which is therefore smaller. At a high contrast both
#: are equal, because rounding leaves no room between them.
LOW_CONTRAST_TOLERANCES = EnergyTolerances(zero_energy=1e-10, zero_pivot=1e-11)

#: Tolerances for a high contrast. A soft part between stiff subdomains contributes to the energy of
#: their columns in proportion to its stiffness, for an island in a void 1e-12: with 1e-11, the
#: motion of such an island counts as zero energy. 1e-13 is between that and rounding; with 1e-15,
#: the tests of the package take as many iterations.
HIGH_CONTRAST_TOLERANCES = EnergyTolerances(zero_energy=1e-13, zero_pivot=1e-13)

#: Smallest stiffness of an interface dof over the largest one, below which a contrast is high. It
#: is four digits above ``zero_energy`` of the low contrast, and below the ratios of ordinary
#: materials; ten units of single precision, like ``products.MIN_SINGLE_PRECISION_RATIO``. Half and
#: twice of it change no iteration of blocks with jumps of 1e3 and 1e8.
HIGH_CONTRAST_RATIO = 10.0 * float(np.finfo(np.float32).eps)


def energy_tolerances(stiffness: Array, comm: MPI.Comm) -> EnergyTolerances:
    """Return the tolerances for an interface. Collective.

    Args:
        stiffness: Stiffness of each interface dof of this process, (n_Γ,); zeros are ignored.
        comm: Communicator of the interface.
    """
    positive = stiffness[stiffness > 0.0]
    smallest = comm.allreduce(float(positive.min(initial=np.inf)), op=MPI.MIN)
    largest = comm.allreduce(float(positive.max(initial=0.0)), op=MPI.MAX)
    if smallest < HIGH_CONTRAST_RATIO * largest:
        return HIGH_CONTRAST_TOLERANCES
    return LOW_CONTRAST_TOLERANCES


@dataclass(frozen=True, slots=True)
class Combinations:
    """Combinations of the columns of this process, each within one subdomain.

    Attributes:
        B: Independent combinations, with energies ±1; block-diagonal, (n_c, n_0).
        B_0: Combinations of zero energy; block-diagonal, (n_c, any number).
        widths: Number of columns of B of each subdomain, with the sum n_0.
    """

    B: scipy.sparse.csr_array
    B_0: scipy.sparse.csr_array
    widths: Numbers

    def without_zero_energy(self) -> Combinations:
        """Return B with an empty B₀, for a later matrix.

        B₀ has zero energy with the matrix for which it was computed. Its energy with a later matrix
        is not computed.
        """
        n_c = self.B.shape[0]
        return Combinations(self.B, B_0=scipy.sparse.csr_array((n_c, 0)), widths=self.widths)


def independent_combinations(
    energies: PETSc.Mat, blocks: Sequence[slice], tolerance: float
) -> Combinations:
    """Split the columns of each subdomain by their energy. Not collective.

    Args:
        energies: Vᵀ A V, (N_c, N_c), of which only the diagonal blocks of subdomains are read.
        blocks: Block of each subdomain of this process, in a coarse vector, (n_c,).
        tolerance: Energy of a combination of columns of unit energy up to which it is zero.
    """
    indptr, indices, values = energies.getDiagonalBlock().getValuesCSR()
    n_c = energies.getLocalSize()[0]
    local = scipy.sparse.csr_array((values, indices, indptr), shape=(n_c, n_c))
    split = [_split_by_energy(local[block, block].toarray(), tolerance) for block in blocks]
    B = block_diagonal([B_i for B_i, _ in split])
    B.eliminate_zeros()  # change_of_basis recognises a diagonal B by its entries
    return Combinations(
        B=B,
        B_0=block_diagonal([B_0i for _, B_0i in split]),
        widths=np.array([B_i.shape[1] for B_i, _ in split], dtype=np.int64),
    )


def _split_by_energy(H: Array, tolerance: float) -> tuple[Array, Array]:
    """Split the columns of one subdomain by their energy.

    Args:
        H: Energies of its columns, (k_i, k_i), of which the symmetric part is used. It is symmetric
            up to rounding if A is.
        tolerance: Largest zero energy, see :func:`independent_combinations`.

    Returns:
        The blocks of B and B₀, combinations of energy ±1 and of zero energy, (k_i, any number)
        each. If there are none of zero energy, the others are the scaled columns themselves: with a
        diagonal B, the change of basis is cheap.
    """
    scale = unit_scale(H)
    θ, Q = np.linalg.eigh(symmetric_part(scale[:, None] * H * scale))
    has_energy = np.abs(θ) > tolerance
    if has_energy.all():
        return np.diag(scale), np.zeros((len(H), 0))
    B_i = scale[:, None] * Q[:, has_energy] / np.sqrt(np.abs(θ[has_energy]))
    # A column without energy has scale 0, and is a combination of zero energy as it is.
    nonzero_scale = np.where(scale > 0.0, scale, 1.0)
    return B_i, nonzero_scale[:, None] * Q[:, ~has_energy]


def change_of_basis(A: PETSc.Mat, B: scipy.sparse.csr_array) -> PETSc.Mat:
    """Return Bᵀ A B, (N_c, N_c) → (N_0, N_0). Collective.

    Args:
        A: Matrix, which does not change.
        B: Rows and columns of this process of a block-diagonal matrix, (n_c, n_0).

    Returns:
        A new matrix; the caller destroys it.
    """
    comm = A.comm.tompi4py()
    n_c, n_0 = B.shape
    is_diagonal = n_0 == n_c and B.nnz == n_c
    if comm.allreduce(is_diagonal, op=MPI.LAND):
        changed = A.copy()
        scale = changed.createVecRight()
        scale.array[:] = B.diagonal()
        changed.diagonalScale(scale, scale)
        scale.destroy()
        return changed
    distributed = distributed_block_diagonal(B, A.comm)
    changed = A.ptap(distributed)
    distributed.destroy()
    return changed
