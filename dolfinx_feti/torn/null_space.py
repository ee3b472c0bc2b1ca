# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The null space that a torn matrix has been given, as PETSc's ``setNullSpace`` takes it: checked.

.. math:: A Z = 0, \quad Z^⊤ Z = I, \quad Z^⊤ b = 0, \quad Z^⊤ x = 0, \qquad
          (N + θ I_k)\, s = e, \quad S^⊤ e = 0 \; ⟹ \; I_k s = 0, \; N s = e

with orthonormal columns Z of the assembled problem, (N, k). The coarse matrices have a null space
S of as many dimensions, and a stiffness on the diagonal at k unknowns on which S is regular.
"""

from __future__ import annotations

from contextlib import ExitStack

from petsc4py import PETSc

import numpy as np
import scipy.linalg

from dolfinx_feti.errors import SetUpError
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.torn.matrix import Torn

__all__ = ["anchor", "null_space", "take_out"]


#: Error that rounding leaves in Zᵀ Z = I, and in A z = 0, scaled by the diagonal of A.
ROUNDING = 1e-10

#: Share of ‖N‖‖s‖ below which N s is rounding, also that of the kernels of the subdomains.
NO_FORCE = 1e-8


def null_space(torn: Torn) -> Array:
    """Return Z on the torn dofs, (n, k), without columns if none is attached. Collective."""
    A = torn.A
    space = A.getNullSpace()
    with ExitStack() as owned:
        modes = list(space.getVecs()) if space.handle else []
        if space.handle and space.hasConstant():
            modes.append(A.createVecRight())
            owned.callback(modes[-1].destroy)
            modes[-1].set(A.getSize()[0] ** -0.5)
        return _checked(torn, modes)


def _checked(torn: Torn, modes: list[PETSc.Vec]) -> Array:
    """Return orthonormal null vectors of A on the torn dofs, (n, k); see :func:`null_space`."""
    comm = torn.comm
    Z = np.array([torn.tear(mode.array_r) for mode in modes]).reshape(len(modes), torn.n).T
    if not modes:
        return Z
    gram = np.array([[first.dot(second) for first in modes] for second in modes])
    if not np.abs(gram - np.eye(len(modes))).max() <= ROUNDING:
        raise SetUpError(
            "The vectors of the null space of A are not orthonormal, as PETSc takes them to be: "
            "orthonormalise them first."
        )
    d = torn.assemble(np.abs(torn.diagonal()))
    d = np.where(d > 0.0, d, 1.0)
    held = torn.prescribed
    for j, mode in enumerate(modes):
        z, force = mode.array_r, torn.assemble(torn.multiply(Z[:, j]))
        squares = [(force**2 / d)[~held].sum(), (d * z**2)[held].sum(), (d * z**2).sum()]
        resisted, moved, size = np.sqrt(comm.allreduce(np.array(squares)))
        if not max(resisted, moved) <= ROUNDING * size:
            what = "A resists it" if resisted >= moved else "it moves Dirichlet dofs"
            raise SetUpError(
                f"Vector {j} of the null space of A is no null vector, {what} (‖A z‖/‖z‖ = "
                f"{max(resisted, moved) / size:.1e}, scaled by the diagonal of A): give "
                "A.setNullSpace what nothing resists, and nothing else."
            )
    if not torn.is_symmetric():
        raise SetUpError(
            "A has a null space and is not symmetric, but only symmetric systems are solved in the "
            "complement of one: prescribe as many dofs instead."
        )
    return Z


def take_out(A: PETSc.Mat, v: PETSc.Vec) -> float:
    """Take the part in the null space out of a vector, v ← v − Z Zᵀ v; ‖Zᵀ v‖. Collective."""
    space = A.getNullSpace()
    if not space.handle:
        return 0.0
    part = v.copy()
    space.remove(v)
    part.axpy(-1.0, v)
    size = part.norm()
    part.destroy()
    return float(size)


def anchor(N: PETSc.Mat, S: Array) -> bool:
    """Make a coarse matrix regular along null vectors S, (own rows, k), by k diagonal entries.

    Returns whether N S = 0 holds; N is left as it is otherwise. Collective.
    """
    if not S.shape[1]:
        return True
    comm, first, scale = N.comm.tompi4py(), N.getOwnershipRange()[0], N.norm() or 1.0
    s, force = N.createVecs()
    free = True
    for column in S.T:
        s.array[:] = column
        N.mult(s, force)
        free = free and force.norm() <= NO_FORCE * scale * s.norm()
    for owned in (s, force):
        owned.destroy()
    if not free:
        return False
    whole = np.vstack(comm.allgather(S))
    pivots = on_all(lambda: scipy.linalg.qr(whole.T, mode="r", pivoting=True)[1], comm)
    chosen = pivots[: S.shape[1]] - first
    stiffness = np.where(np.isin(np.arange(len(S)), chosen), scale, 0.0)
    rows = np.arange(len(S) + 1, dtype=PETSc.IntType)
    csr = (rows, first + rows[:-1], stiffness)
    more = PETSc.Mat().createAIJ(N.getSizes(), csr=csr, comm=N.comm)
    N.axpy(1.0, more, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    more.destroy()
    return True
