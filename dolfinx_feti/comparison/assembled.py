# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The assembled counterpart of a torn system, and what a solution leaves of it."""

from __future__ import annotations

from petsc4py import PETSc

from dolfinx_feti.runtime.connectivity import is_symmetric

__all__ = ["assembled_system", "relative_difference", "relative_residual"]


def assembled_system(A: PETSc.Mat, b: PETSc.Vec) -> tuple[PETSc.Mat, PETSc.Vec]:
    r"""Convert a torn matrix and its right-hand side to the assembled system that FETI solves.

    .. math:: K = \begin{pmatrix} A_{FF} & 0 \\ 0 & I \end{pmatrix}, \qquad
        f = \begin{pmatrix} b_F - A_{FD}\, b_D \\ b_D \end{pmatrix}

    with the free dofs F and the Dirichlet dofs D, on which b holds the prescribed values.

    Args:
        A: Torn matrix (MATIS).
        b: Right-hand side, (N,).

    Returns:
        K, (N, N), marked as symmetric if the matrices of all subdomains are, with the near kernel
        and the null space of A; and f, (N,), without its part in that. The caller destroys them.

    Note:
        Collective.
    """
    K, f = PETSc.Mat(), b.copy()
    A.convert(PETSc.Mat.Type.AIJ, K)
    dirichlet = A.query("dirichlet")
    if dirichlet is not None:
        K.zeroRowsColumns(dirichlet.getIndices(), 1.0, b, f)
    if is_symmetric(A):
        K.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    near_kernel = A.getNearNullSpace()
    if near_kernel.handle:
        K.setNearNullSpace(near_kernel)
    null_space = A.getNullSpace()
    if null_space.handle:
        K.setNullSpace(null_space)
        null_space.remove(f)
    return K, f


def relative_residual(K: PETSc.Mat, f: PETSc.Vec, x: PETSc.Vec) -> float:
    """Return ‖f − K x‖/‖f‖. Collective."""
    r = f.duplicate()
    K.mult(x, r)
    r.aypx(-1.0, f)  # r = f − K x
    norm = r.norm()
    r.destroy()
    return norm / f.norm()


def relative_difference(x: PETSc.Vec, reference: PETSc.Vec) -> float:
    """Return ‖x − reference‖/‖reference‖. Collective."""
    y = x.copy()
    y.axpy(-1.0, reference)
    norm = y.norm()
    y.destroy()
    return norm / reference.norm()
