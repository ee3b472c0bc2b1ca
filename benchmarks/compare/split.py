# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The uncondensed system of displacement and pressure, solved by FGMRES and a Schur complement.

Before it is condensed, cell by cell, Newton's step for u and the fields p reads

.. math:: \begin{pmatrix} K_{uu} & C^⊤ \\ S & I \end{pmatrix}
          \begin{pmatrix} x \\ y \end{pmatrix} = \begin{pmatrix} f \\ 0 \end{pmatrix}, \qquad
          C = D^{-1} K_{up}^⊤, \quad S = D\, K_{pp}^{-1} K_{pu}, \quad y = D p,

with its second row divided by :math:`K_{pp}`, the cells' blocks, and the norm of each column of
:math:`K_{up}` in the diagonal D. Then :math:`K = K_{uu} - C^⊤ S`, and a residual (r, s) of the
system leaves K x with the residual :math:`r - C^⊤ s`, which is as large. x is accepted by that one,
as of all solvers.

The preconditioner eliminates x by one V-cycle of smoothed aggregation for :math:`K_{uu}`, which
knows no κ, and takes for the Schur complement :math:`I - S K_{uu}^{-1} C^⊤` the blocks of the cells
in :math:`I - S\, (\operatorname{diag} K_{uu})^{-1} C^⊤`. For P2–P0 these are a multiple of
:math:`1 + κ/μ`, that is the mass matrix times −(1/κ + 1/μ) before the division, with the μ of each
cell. The system is *augmented*: :math:`θ C^⊤` times its second row is taken from the first,

.. math:: K_θ = K_{uu} - θ\, C^⊤ S = (1 - θ) K_{uu} + θ K, \qquad C_θ = (1 - θ)\, C,

with so little κ in it that multigrid bears it, which makes up for an element that is not stable.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx_feti import LinearProblem, NonlinearProblem

__all__ = ["Split", "Uncondensed", "blocks_of", "split"]

Reason = PETSc.KSP.ConvergedReason

#: Directions that FGMRES keeps.
RESTART = 100

#: Mean of θ κ/μ over the cells.
AUGMENTATION = 2.5

#: Where FGMRES's own residual is below this multiple of the tolerance, that of the condensed system
#: is computed at each so many iterations.
NEAR, EACH = 10.0, 3

#: The problem whose pressure was condensed into the matrix, innermost last.
_PROBLEMS: list[LinearProblem | NonlinearProblem] = []


@contextmanager
def blocks_of(problem: LinearProblem | NonlinearProblem) -> Iterator[None]:
    """Let solvers that are set up meanwhile take what was condensed from this problem."""
    _PROBLEMS.append(problem)
    try:
        yield
    finally:
        _PROBLEMS.pop()


@dataclass(frozen=True, slots=True)
class Split:
    """The uncondensed system.

    Attributes:
        K: Condensed matrix, (N, N), with unit rows at Dirichlet dofs.
        K_uu: Matrix before the condensation, (N, N).
        C: D⁻¹ K_upᵀ, (M, N).
        S: D K_pp⁻¹ K_pu, (M, N).
        shape: n dofs of the fields in a cell, and d of u.
    """

    K: PETSc.Mat
    K_uu: PETSc.Mat
    C: PETSc.Mat
    S: PETSc.Mat
    shape: tuple[int, int]


def split(
    K: PETSc.Mat,
    fixed: PETSc.IS | None,
    dofs: npt.NDArray[np.integer],
    k_up: npt.NDArray[np.float64],
    slope: npt.NDArray[np.float64],
) -> Split:
    """Undo the condensation of a matrix.

    Args:
        K: Assembled matrix.
        fixed: Global Dirichlet dofs that this process owns.
        dofs: Global dofs of u in each owned cell, (cells, d).
        k_up: K_up, (cells, d, n).
        slope: K_pp⁻¹ K_pu, (cells, n, d).

    Returns:
        The system, which the caller destroys.

    Note:
        Collective.
    """
    free = K.createVecRight()
    free.set(1.0)
    if fixed is not None:
        indices = fixed.getIndices()
        free.setValues(indices, np.zeros(len(indices)))
    free.assemble()
    size = np.linalg.norm(k_up, axis=1)[:, :, None]  # D, (cells, n, 1)
    size[size == 0.0] = 1.0  # a dilation meets no u
    C = _rows_of_cells(K, dofs, k_up.transpose(0, 2, 1) / size)
    S = _rows_of_cells(K, dofs, slope * size)
    for block in (C, S):
        block.diagonalScale(None, free)
    K_uu = K.duplicate(copy=True)
    product = C.transposeMatMult(S)
    K_uu.axpy(1.0, product, PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)  # K + Cᵀ S
    for made in (product, free):
        made.destroy()
    near_kernel = K.getNearNullSpace()
    if near_kernel.handle:
        K_uu.setNearNullSpace(near_kernel)
    return Split(K, K_uu, C, S, (slope.shape[1], slope.shape[2]))


class Uncondensed:
    """Context of a KSP: FGMRES inside, until the residual of the condensed system is small."""

    def __init__(self) -> None:
        """Own nothing yet."""
        self._owned: list[PETSc.Object] = []

    def setUp(self, ksp: PETSc.KSP) -> None:
        """Set up FGMRES on the uncondensed system.

        Raises:
            RuntimeError: No field is condensed.
        """
        problem = _PROBLEMS[-1] if _PROBLEMS else None
        if problem is None or not problem.condenses:
            raise RuntimeError("no field is condensed")
        dofs, blocks = problem.condensed_blocks()
        fixed = problem.A.query("dirichlet")
        system = split(ksp.getOperators()[0], fixed, dofs, blocks.k_up, blocks.slope)
        self._inner, owned, self._up = _fgmres(system, f"{ksp.getOptionsPrefix()}inner_")
        self._owned = [self._inner, *owned, system.K_uu, system.C, system.S]

    def solve(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """Solve K x = b."""
        rtol, _, _, max_it = ksp.getTolerances()
        target, n = rtol * b.norm(), b.getLocalSize()  # of x, which is before y on each process
        solution, right = self._inner.getOperators()[0].createVecs()
        s, r = self._up.createVecs()
        right.array[:n] = b.array_r

        def test(inner: PETSc.KSP, iteration: int, norm: float) -> int:
            if iteration >= max_it:
                return Reason.DIVERGED_MAX_IT
            if norm > NEAR * target or iteration % EACH:
                return Reason.CONVERGED_ITERATING
            left = inner.buildResidual().array_r
            r.array[:], s.array[:] = left[:n], left[n:]
            s.scale(-1.0)
            self._up.multAdd(s, r, r)  # b − K x = r − C_θᵀ s
            return Reason.CONVERGED_RTOL if r.norm() <= target else Reason.CONVERGED_ITERATING

        self._inner.setConvergenceTest(test)
        self._inner.solve(right, solution)
        x.array[:] = solution.array_r[:n]
        ksp.setIterationNumber(self._inner.getIterationNumber())
        ksp.setConvergedReason(self._inner.getConvergedReason())
        for made in (solution, right, s, r):
            made.destroy()

    def destroy(self, _ksp: PETSc.KSP) -> None:
        """Free the solver inside."""
        for owned in self._owned:
            owned.destroy()


def _fgmres(system: Split, prefix: str) -> tuple[PETSc.KSP, list[PETSc.Mat], PETSc.Mat]:
    """Set up FGMRES on the uncondensed system; return it, the matrices that it has, and C_θᵀ."""
    comm = system.K.comm
    q = _cell_blocks(system)
    mean = comm.tompi4py().allreduce(float(np.trace(q, axis1=1, axis2=2).sum()))
    θ = min(1.0, AUGMENTATION * system.C.getSize()[0] / mean) if mean > 0.0 else 0.0
    K_θ = system.K_uu.duplicate(copy=True)
    K_θ.scale(1.0 - θ)
    K_θ.axpy(θ, system.K, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
    if system.K_uu.getNearNullSpace().handle:
        K_θ.setNearNullSpace(system.K_uu.getNearNullSpace())
    one = np.eye(system.shape[0])
    schur = one + (1.0 - θ) * q @ np.linalg.inv(one + θ * q)  # I − S K_θ⁻¹ C_θᵀ, by the cells
    unit, blocks = (
        _block_diagonal(system.C, block) for block in (np.broadcast_to(one, q.shape), schur)
    )
    up = system.C.transpose(PETSc.Mat())
    up.scale(1.0 - θ)  # C_θᵀ
    A = PETSc.Mat().createNest([[K_θ, up], [system.S, unit]], comm=comm)
    ksp = PETSc.KSP().create(comm)
    ksp.setOptionsPrefix(prefix)
    ksp.setOperators(A)
    ksp.setType(PETSc.KSP.Type.FGMRES)
    ksp.setGMRESRestart(RESTART)
    pc = ksp.getPC()
    pc.setType(PETSc.PC.Type.FIELDSPLIT)
    pc.setFieldSplitType(PETSc.PC.CompositeType.SCHUR)
    rows, _ = A.getNestISs()
    pc.setFieldSplitIS(("0", rows[0]), ("1", rows[1]))
    pc.setFieldSplitSchurPreType(PETSc.PC.FieldSplitSchurPreType.USER, blocks)
    ksp.setFromOptions()
    ksp.setUp()
    for part in pc.getFieldSplitSubKSP():
        part.setUp()
    return ksp, [A, K_θ, up, unit, blocks], up


def _cell_blocks(system: Split) -> npt.NDArray[np.float64]:
    """Return the blocks of the cells in −S (diag K_uu)⁻¹ Cᵀ, (cells, n, n)."""
    diagonal = system.K_uu.getDiagonal()
    diagonal.reciprocal()
    scaled = system.C.copy()
    scaled.diagonalScale(None, diagonal)
    S, C = (M.getValuesCSR()[2].reshape(-1, *system.shape) for M in (system.S, scaled))
    for made in (scaled, diagonal):
        made.destroy()
    return -S @ C.transpose(0, 2, 1)


def _rows_of_cells(
    K: PETSc.Mat, dofs: npt.NDArray[np.integer], values: npt.NDArray[np.float64]
) -> PETSc.Mat:
    """Return a matrix with n rows for each owned cell, values (cells, n, d), and K's columns."""
    cells, n, d = values.shape
    columns = np.repeat(dofs.astype(PETSc.IntType)[:, None, :], n, axis=1)
    starts = np.arange(cells * n + 1, dtype=PETSc.IntType) * d
    sizes = ((cells * n, None), (K.getLocalSize()[1], None))
    csr = (starts, columns.ravel(), values.ravel())
    return PETSc.Mat().createAIJ(sizes, csr=csr, comm=K.comm)


def _block_diagonal(C: PETSc.Mat, blocks: npt.NDArray[np.float64]) -> PETSc.Mat:
    """Return a matrix on the rows of C with blocks (cells, n, n) on its diagonal."""
    cells, n, _ = blocks.shape
    first, _ = C.getOwnershipRange()
    columns = (first + np.arange(cells * n)).reshape(cells, 1, n)
    starts = np.arange(cells * n + 1, dtype=PETSc.IntType) * n
    everywhere = np.broadcast_to(columns, blocks.shape).astype(PETSc.IntType)
    size = (cells * n, None)
    csr = (starts, everywhere.ravel(), np.ascontiguousarray(blocks).ravel())
    return PETSc.Mat().createAIJ((size, size), bsize=n, csr=csr, comm=C.comm)
