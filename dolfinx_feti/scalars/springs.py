# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Point springs that resist the rigid motions of a matrix; their forces t are additional scalars.

.. math:: (A + E κ E^⊤)\, x + B\, s - E\, t = b, \quad C^⊤ x + D\, s = d, \quad
          E^⊤ x - κ^{-1} t = 0

The last equation is :math:`t = κ E^⊤ x`. With it, the springs cancel in the first one: the solution
is the same, but the matrix is regular. E selects as many dofs as there are rigid motions W that
nothing resists.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import scipy.linalg

from dolfinx_feti.feti.regularity.bodies import find_bodies
from dolfinx_feti.feti.regularity.rigid_motions import free_motions
from dolfinx_feti.runtime.arrays import Array, Numbers
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.scalars.border import Border
from dolfinx_feti.torn.matrix import Torn

__all__ = ["PointSprings"]


class PointSprings:
    """The springs of one matrix; none if it has no free rigid motions.

    Attributes:
        count: Number k of springs and of motions W.
        X: −A⁻¹ E with the springs in A, (N, k): the columns of X in ``bordered`` that belong to
            their forces. They need no solve: a force E moves the body along W, which only the
            springs resist, so that X = −W (Eᵀ W)⁻¹ κ⁻¹.
    """

    def __init__(self, A: PETSc.Mat) -> None:
        """Choose the dofs and the stiffnesses. Collective.

        Args:
            A: Torn matrix.
        """
        with Lifetime() as owned:
            torn = owned.own(Torn(A))
            comm = torn.comm
            W = _free_motions(torn)
            self.count = W.shape[1]
            self._dofs, numbers = _choose_dofs(W, comm)  # of the springs of this process
            stiffness = torn.tear(torn.assemble(torn.stiffness()))
            self._local_κ = stiffness[self._dofs]
            κ = np.zeros(self.count)
            κ[numbers] = self._local_κ
            self._κ = comm.allreduce(κ)
            E = np.zeros((torn.n, self.count))
            E[self._dofs, numbers] = 1.0
            self._E = _assembled(torn, E)
            E_W = comm.allreduce(E.T @ W)  # Eᵀ W
            delta = 1.0 / torn.tear(torn.multiplicity())  # the copies of a motion are equal
            averaged_W = _assembled(torn, delta[:, None] * W)
            self.X = -averaged_W @ np.linalg.inv(E_W) / self._κ  # −W (Eᵀ W)⁻¹ κ⁻¹
        # PETSc's states of the local matrix when the springs were last added, and removed.
        self._state_with = -1
        self._state_without = -1

    @contextmanager
    def added_to(self, A: PETSc.Mat) -> Iterator[None]:
        """Return a context in which the diagonal of a matrix has the springs.

        A FETI solver sets up a matrix again if its PETSc state, a count of changes, is another one
        than before. Adding springs increases the count. If the matrix does not change between two
        contexts, its entries are the same in both, though. The second one then gets the state of
        the first, so that the solver keeps its factors.
        """
        K = A.getISLocalMat()
        if not self.count:
            yield
            return
        before = np.array([K.getValue(dof, dof) for dof in self._dofs])
        is_unchanged = K.stateGet() == self._state_without
        self._set_diagonal(K, before + self._local_κ)
        if is_unchanged:
            K.stateSet(self._state_with)
        self._state_with = K.stateGet()
        try:
            yield
        finally:
            self._set_diagonal(K, before)
            if is_unchanged:
                K.stateSet(self._state_without)
            self._state_without = K.stateGet()

    def _set_diagonal(self, K: PETSc.Mat, values: Array) -> None:
        """Write the diagonal of the local matrix at the dofs of the springs."""
        for dof, value in zip(self._dofs, values, strict=True):
            K.setValue(dof, dof, value)
        K.assemble()
        K.stateIncrease()

    def extend(self, border: Border) -> Border:
        """Return a border with the forces t as last scalars: t/κ − Eᵀ x = 0."""
        B = np.hstack([border.B, -self._E])
        C = np.hstack([border.C, -self._E])
        D = scipy.linalg.block_diag(border.D, np.diag(1.0 / self._κ))
        return Border(B, C, D, spring_count=self.count)


def _free_motions(torn: Torn) -> Array:
    """Return the rigid motions that nothing resists, one body after the other, (n, k). Collective.

    The largest entry of each column over all processes is one, up to its sign.
    """
    bodies = find_bodies(torn)
    rigid = free_motions(torn, bodies, is_semidefinite=False)
    columns = []
    for body, dimension in enumerate(rigid.dimensions):
        for j in range(dimension):
            columns.append(np.where(bodies.label == body, rigid.fields[:, j], 0.0))
    W = np.array(columns).reshape(len(columns), torn.n).T
    largest = np.max(torn.comm.allgather(np.abs(W).max(axis=0, initial=0.0)), axis=0)
    return np.asarray(W / largest)


def _choose_dofs(W: Array, comm: MPI.Comm) -> tuple[Numbers, Numbers]:
    """Choose k dofs whose rows of k columns W are well conditioned together. Collective.

    Each process chooses up to k candidates among its dofs. All processes then choose the same k
    dofs among the candidates of all.

    Args:
        W: Rigid motions on the torn dofs of this process, (n, k).
        comm: Communicator.

    Returns:
        The chosen torn dofs of this process, and the number of the spring at each of them, counted
        over all processes.
    """
    k = W.shape[1]
    local = on_all(lambda: _independent_rows(W, k), comm)
    candidates = comm.allgather(W[local])
    last = sum(map(len, candidates[: comm.rank + 1]))
    first = last - len(local)
    chosen = on_all(lambda: _independent_rows(np.vstack(candidates), k), comm)
    numbers = np.flatnonzero((chosen >= first) & (chosen < last))  # of the springs of this process
    return local[chosen[numbers] - first], numbers


def _independent_rows(X: Array, k: int) -> Numbers:
    """Return k rows of X, (n, k), that are well conditioned together, ascending, (up to k,)."""
    if not X.size:
        return np.zeros(0, dtype=np.int64)
    order = scipy.linalg.qr(X.T, mode="r", pivoting=True)[-1]
    return np.sort(order[:k])


def _assembled(torn: Torn, X: Array) -> Array:
    """Return the sums of the copies of each column, (n, k) → (N, k). Collective."""
    return np.array([torn.assemble(x) for x in X.T]).reshape(X.shape[1], torn.N).T
