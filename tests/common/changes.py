# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""All that a user may change in a torn matrix between two solves, on a scalar problem by hand.

The problem is a row of six subdomains. Each change keeps the matrix symmetric, and positive
definite.
"""

import ctypes

from petsc4py import PETSc

import numpy as np
from collective import COMM

from dolfinx_feti import set_near_kernel
from dolfinx_feti.runtime.petsc_library import function
from dolfinx_feti.torn.matrix import set_condensed

LAST = COMM.rank == COMM.size - 1
Option = PETSc.Mat.Option


def local(problem):
    """Return the present local matrix."""
    return problem.A.getISLocalMat()


def replaced(problem, K):
    """Let another matrix be the local one; nobody else holds it, nor the one before."""
    problem.A.setISLocalMat(K)
    problem.A.assemble()
    K.destroy()


def scaled_copy(problem):
    K = local(problem).copy()
    K.scale(5.0)
    replaced(problem, K)


def two_copies(problem):
    """The first one is freed, so that PETSc may use its address again."""
    scaled_copy(problem)
    scaled_copy(problem)


def spring(problem, i, j):
    """Matrix of a spring between two torn dofs of this process, if it has them."""
    n = local(problem).getSize()[0]
    X = PETSc.Mat().createAIJ((n, n), nnz=2, comm=PETSc.COMM_SELF)
    if n:
        for row, column, value in ((i, i, 7.0), (j, j, 7.0), (i, j, -7.0), (j, i, -7.0)):
            X.setValue(row % n, column % n, value, addv=PETSc.InsertMode.ADD)
    X.assemble()
    return X


def axpy(problem, i, j):
    X = spring(problem, i, j)
    local(problem).axpy(1.0, X, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    problem.A.assemble()
    X.destroy()


def new_entries(problem):
    """One after the other, on the last process alone."""
    K = local(problem)
    if LAST and K.getSize()[0]:
        K.setOption(Option.NEW_NONZERO_ALLOCATION_ERR, False)
        for i, j, value in ((0, 0, 3.0), (8, 8, 3.0), (0, 8, -3.0), (8, 0, -3.0)):
            K.setValue(i, j, value, addv=PETSc.InsertMode.ADD)
    problem.A.assemble()


def fewer_entries(problem):
    """The same dofs, no longer coupled by the smallest entries."""
    n = local(problem).getSize()[0]
    indptr, indices, values = local(problem).getValuesCSR()
    rows = np.repeat(np.arange(n), np.diff(indptr))
    keep = (rows == indices) | (np.abs(values) > 0.2)
    dropped = np.bincount(rows, np.where(keep, 0.0, values), minlength=n)
    values = values + np.where(rows == indices, dropped[rows], 0.0)  # constants stay the kernel
    csr = (np.concatenate([[0], np.cumsum(np.bincount(rows[keep], minlength=n))]), indices[keep])
    csr = tuple(array.astype(PETSc.IntType) for array in csr)
    replaced(problem, PETSc.Mat().createAIJ((n, n), csr=(*csr, values[keep]), comm=PETSc.COMM_SELF))


def numbering(problem):
    """The first two torn dofs of each process change places in the assembled numbering."""
    K, dofs = local(problem), problem.A.getLGMap()[0].getIndices().copy()
    dofs[:2] = dofs[:2][::-1].copy()
    lgmap = PETSc.LGMap().create(dofs, bsize=1, comm=COMM)
    problem.A.setLGMap(lgmap, lgmap)  # drops the local matrix
    problem.A.setISLocalMat(K)
    problem.A.assemble()
    lgmap.destroy()


def one_entry(problem):
    """Through the local matrix, on the last process alone."""
    if LAST and local(problem).getSize()[0]:
        local(problem).setValue(0, 0, 11.0, addv=PETSc.InsertMode.ADD)
    problem.A.assemble()


def local_values(problem):
    """Through the torn matrix, in the local numbering."""
    if local(problem).getSize()[0]:
        problem.A.setValueLocal(1, 1, 2.5, addv=PETSc.InsertMode.ADD)
    problem.A.assemble()


def diagonal(problem):
    d = local(problem).getDiagonal()
    d.scale(3.0)
    local(problem).setDiagonal(d)
    d.destroy()


def fixed(problem, dofs):
    """Of these dofs those that this process owns."""
    first, last = problem.A.getOwnershipRange()
    return dofs[(first <= dofs) & (dofs < last)].astype(PETSc.IntType)


def other_dirichlet(problem):
    """The opposite side is held."""
    dofs = np.flatnonzero(problem.x[:, 0] == problem.x[:, 0].max())
    held = PETSc.IS().createGeneral(fixed(problem, dofs), comm=COMM)
    problem.A.compose("dirichlet", held)


def dirichlet_in_place(problem):
    """The same index set has one dof more, the last, on the process that owns it."""
    dofs = np.append(np.flatnonzero(problem.dirichlet), len(problem.dirichlet) - 1)
    problem.A.query("dirichlet").setIndices(fixed(problem, dofs))


def stiffness(problem):
    weight = PETSc.Vec().createSeq(local(problem).getSize()[0], comm=PETSc.COMM_SELF)
    weight.array[:] = 1.0 + np.arange(weight.getSize()) % 3
    problem.A.compose("stiffness", weight)


def near_kernel(problem):
    one = problem.A.createVecRight()
    one.set(-1.0)
    set_near_kernel(problem.A, [one])


def near_kernel_in_place(problem):
    """PETSc locks the vectors; who insists can still change them."""
    mode = problem.A.getNearNullSpace().getVecs()[0]
    unlock, lock = (function(f"VecLockRead{way}", (ctypes.c_void_p,)) for way in ("Pop", "Push"))
    unlock(mode.handle)
    mode.scale(-1.0)
    lock(mode.handle)


#: Changes of the pattern.
PATTERN = {
    "local matrix replaced": scaled_copy,
    "local matrix replaced twice": two_copies,
    "entries added in a subdomain": lambda p: axpy(p, 0, 8),
    "two subdomains joined": lambda p: axpy(p, 0, -4),
    "entries inserted": new_entries,
    "entries removed": fewer_entries,
    "numbering": numbering,
    "block size": lambda p: local(p).setBlockSize(3),
    "other Dirichlet dofs": other_dirichlet,
    "Dirichlet dofs in place": dirichlet_in_place,
}

#: Changes of the values alone.
VALUES = {
    "local matrix scaled": lambda p: local(p).scale(2.0),
    "torn matrix scaled": lambda p: p.A.scale(0.1),
    "one entry": one_entry,
    "values in the local numbering": local_values,
    "diagonal": diagonal,
    "stiffness": stiffness,
    "stiffness in place": lambda p: p.A.query("stiffness").scale(4.0),
    "near kernel": near_kernel,
    "near kernel in place": near_kernel_in_place,
    "coordinates": lambda p: p.A.query("coordinates").shift(1.0),
    "pressures": lambda p: set_condensed(p.A, 3),
}
