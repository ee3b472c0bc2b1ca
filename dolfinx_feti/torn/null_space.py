# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The null space that a torn matrix has been given, as PETSc's ``setNullSpace`` takes it: checked.

.. math:: A Z = 0, \quad Z^⊤ Z = I, \quad Z^⊤ b = 0, \quad Z^⊤ x = 0, \qquad
          (N + θ I_k)\, s = e, \quad S^⊤ e = 0 \; ⟹ \; I_k s = 0, \; N s = e

with orthonormal columns Z of the assembled problem, (N, k). The coarse matrices have as large a
null space S, and a stiffness on the diagonal at k unknowns on which S is regular.
"""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import scipy.linalg

from dolfinx_feti.errors import SetUpError
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.torn.matrix import Torn

#: Error that rounding leaves in Zᵀ Z = I, and in A z = 0, scaled by the diagonal of A.
ROUNDING = 1e-10

#: Share of ‖N‖‖s‖ below which N s is rounding, also that of the kernels of the subdomains.
NO_FORCE = 1e-8


def null_space(torn: Torn) -> Array:
    """Return Z on the torn dofs, (n, k), without columns if none is attached. Collective."""
    space, held = torn.A.getNullSpace(), torn.prescribed
    columns = [mode.array_r.copy() for mode in space.getVecs()] if space.handle else []
    if space.handle and space.hasConstant():
        columns.append(np.full(torn.owned, torn.A.getSize()[0] ** -0.5))
    if not columns:
        return np.zeros((torn.n, 0))
    z, Z = np.column_stack(columns), np.column_stack([torn.tear(column) for column in columns])
    gram = torn.comm.allreduce(z.T @ z)
    if not np.abs(gram - np.eye(len(gram))).max() <= ROUNDING:
        raise SetUpError(
            "The vectors of the null space of A are not orthonormal, as PETSc takes them to be: "
            "orthonormalise them first."
        )
    d = torn.assemble(np.abs(torn.diagonal()))
    d = np.where(d > 0.0, d, 1.0)[:, None]
    force = np.column_stack([torn.assemble(torn.multiply(t)) for t in Z.T])
    squares = [(force**2 / d)[~held], (d * z**2)[held], d * z**2]
    sums = torn.comm.allreduce(np.array([each.sum(axis=0) for each in squares]))
    resisted, moved, size = np.sqrt(sums)
    for j in np.flatnonzero(~(np.maximum(resisted, moved) <= ROUNDING * size)):
        what = "A resists it" if resisted[j] >= moved[j] else "it moves Dirichlet dofs"
        raise SetUpError(
            f"Vector {j} of the null space of A is no null vector, {what} (‖A z‖/‖z‖ = "
            f"{max(resisted[j], moved[j]) / size[j]:.1e}, scaled by the diagonal of A): give "
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
