# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""A few scalar unknowns s beside the x of a torn matrix: a bordered system, by block elimination.

.. math:: A\, x + B\, s = b, \quad C^⊤ x + D\, s = d: \qquad
          A\, y = b, \; A\, X = B, \quad (D - C^⊤ X)\, s = d - C^⊤ y, \quad x = y - X s

with columns B, C, (N, m), of any units. X starts from that of the last matrix, as accurate as
:math:`\|B_k - A X_k\|\, |s_k|` demands. Where A is nearly singular, y and X are inaccurate, but x
and s are not (Keller 1983).
Where nothing resists rigid motions, point springs E do, whose forces :math:`t = κ E^⊤ x` are
further scalars: :math:`(A + E κ E^⊤)\, x + B\, s - E\, t = b`.
"""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
import scipy.linalg

from dolfinx_feti.feti.gluing.bodies import find_bodies
from dolfinx_feti.feti.regularity.motions import free_motions
from dolfinx_feti.runtime.arrays import Array, Mask, Numbers
from dolfinx_feti.runtime.collective import on_all, total_of
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.torn.matrix import Torn, prescribed_dofs

Reason = PETSc.KSP.ConvergedReason

#: Corrections of X at most; the first one often is the last. The share of B that X may leave
#: whatever s is, and by what factor a correction aims below what is wanted.
CORRECTIONS, ROUGH, AIM = 4, 1e-2, 0.7

#: Size of a scaled singular value of D − Cᵀ X below which the bordered matrix is singular.
SINGULAR = 1e-12

DEPENDENT = (
    "the bordered matrix is singular: the equations of the scalars contradict each other, depend "
    "on each other, do not depend on the unknowns, or leave a rigid motion free"
)


@dataclass(frozen=True, slots=True)
class Border:
    """What m scalars add to a matrix; rows of B and C that this process owns.

    Attributes:
        B: Columns, (owned, m); rows of Dirichlet dofs count as zero.
        C: Rows of the equations, transposed, (owned, m).
        D: Corner, (m, m).
    """

    B: Array
    C: Array
    D: Array


class BorderedSolver:
    """Solves bordered systems with a FETI KSP, one after the other.

    Attributes:
        message: What went wrong beside the KSP's own failures, or an empty string.
        iterations: Krylov iterations of the last solve, of all right-hand sides.
    """

    def __init__(self) -> None:
        """Begin with nothing known."""
        self.message = ""
        self.iterations = 0
        self._X: Array | None = None
        self._springs: _Springs | None = None

    def solve(
        self, ksp: PETSc.KSP, A: PETSc.Mat, b: Array, border: Border, d: Array
    ) -> tuple[Array, Array]:
        """Solve, to the tolerances of the KSP. Collective.

        Args:
            ksp: A KSP with a FETI context; its converged reason is that of the bordered system.
            A: Torn matrix. If rigid motions are free, its diagonal has springs from now on.
            b: First right-hand side, with prescribed values on Dirichlet dofs, (owned,).
            border: B, C and D.
            d: Second right-hand side, (m,).

        Returns:
            x, (owned,), and s, (m,).
        """
        m, context = len(d), ksp.getPythonContext()
        self.iterations, self.message = 0, ""
        free = ~prescribed_dofs(A)
        springs = self._springs = self._springs or _Springs(A)
        springs.add(A)
        y = self._solved(ksp, A, b)
        if context.singular and not springs.count:  # its supports have gone
            springs = self._springs = _Springs(A)
            springs.add(A)
            y = self._solved(ksp, A, b)
        whole = on_all(lambda: springs.extended(border), A.comm.tompi4py())
        X, s, share = self._eliminated(ksp, A, b, y, whole, d, free)
        context.iterations = self.iterations
        if self.message:
            ksp.setConvergedReason(Reason.DIVERGED_BREAKDOWN)
            context.message = self.message
        elif ksp.getConvergedReason() > 0:
            context.residual = max(context.residual, share)
        return y - X @ s, s[:m]

    def _eliminated(
        self, ksp: PETSc.KSP, A: PETSc.Mat, b: Array, y: Array, border: Border, d: Array, free: Mask
    ) -> tuple[Array, Array, float]:
        """Find X, (owned, m), and s, (m,), for y = A⁻¹ b, and ‖(B − A X) s‖/(‖b‖ + Σ ‖B_k‖ |s_k|).

        Collective.
        """
        comm, m = A.comm.tompi4py(), len(border.D)
        d = np.concatenate([d, np.zeros(m - len(d))])
        B = np.where(free[:, None], border.B, 0.0)
        X = np.zeros_like(B)
        if self._springs is not None and self._springs.count:
            X[:, -self._springs.count :] = self._springs.start
        fresh = self._X is None or self._X.shape != X.shape
        if self._X is not None and not fresh:
            X = self._X
        X = np.where(free[:, None], X, 0.0)
        s: Array = np.zeros(m)
        if ksp.getConvergedReason() < 0:
            return X, s, np.nan
        rtol, atol, *_ = tolerances = ksp.getTolerances()
        sizes = _norms(B, comm)
        size_b = float(_norms(np.where(free, b, 0.0)[:, None], comm)[0])
        e = d - total_of(border.C.T @ y, comm)  # d − Cᵀ y
        wanted = (rtol if fresh else ROUGH) * sizes
        rest = B - _product(A, X, free)
        for _ in range(CORRECTIONS):
            for k in np.flatnonzero(_norms(rest, comm) > wanted):
                ksp.setTolerances(rtol=0.0, atol=AIM * wanted[k])
                X[:, k] += self._solved(ksp, A, rest[:, k])
                ksp.setTolerances(*tolerances)
                if ksp.getConvergedReason() < 0:
                    return X, np.zeros(m), np.nan
                rest[:, k : k + 1] = B[:, k : k + 1] - _product(A, X[:, k : k + 1], free)
            s = self._scalars(border, X, e, comm)
            scale, left = size_b + float(np.abs(s) @ sizes), _norms(rest, comm)
            wanted = max(rtol * scale, atol) / _no_zeros(m * np.abs(s))
            wanted = np.fmin(wanted, ROUGH * sizes)
            if self.message or np.all(left <= wanted):
                break
        self._X = X
        return X, s, float(np.abs(s) @ left) / (scale or 1.0)

    def _solved(self, ksp: PETSc.KSP, A: PETSc.Mat, b: Array) -> Array:
        """Return A⁻¹ b, (owned,). Collective."""
        x = solved(ksp, A, b)
        self.iterations += ksp.getPythonContext().iterations
        return x

    def _scalars(self, border: Border, X: Array, d: Array, comm: MPI.Comm) -> Array:
        """Return s = (D − Cᵀ X)⁻¹ d, (m,), with rows and columns of size one. Collective."""
        S = border.D - total_of(border.C.T @ X, comm)
        rows, columns = np.ones(len(S)), np.ones(len(S))
        for _ in range(5):
            T = np.abs(rows[:, None] * S * columns)
            rows /= np.sqrt(_no_zeros(T.max(axis=1)))
            columns /= np.sqrt(_no_zeros(T.max(axis=0)))
        U, σ, Vt = on_all(lambda: np.linalg.svd(rows[:, None] * S * columns), comm)
        if not (np.isfinite(σ).all() and σ[-1] > SINGULAR * σ[0]):
            self.message = DEPENDENT
            return np.zeros(len(d))
        return columns * (Vt.T @ ((U.T @ (rows * d)) / σ))


def solved(ksp: PETSc.KSP, A: PETSc.Mat, b: Array) -> Array:
    """Solve A x = b; return x, (owned,). Collective."""
    with Lifetime() as owned:
        rhs, x = map(owned.own, A.createVecs())
        rhs.array[:] = b
        ksp.setOperators(A)
        ksp.solve(rhs, x)
        return x.array_r.copy()


class _Springs:
    """Point springs that hold the rigid motions W of a matrix, if nothing else does.

    Attributes:
        count: Their number k, that of W.
        start: −A⁻¹ E, as these alone resist W, (owned, k).
    """

    def __init__(self, A: PETSc.Mat) -> None:
        """Choose the dofs. Collective."""
        self._state = -1
        with Lifetime() as owned:
            self._choose(owned.own(Torn(A)))

    def _choose(self, torn: Torn) -> None:
        """Choose the dofs, their stiffness, and the start. Collective."""
        comm, W = torn.comm, _free_motions(torn)
        self.count = k = W.shape[1]
        own = on_all(lambda: _pivots(W, k), comm)
        candidates = comm.allgather(W[own])
        last = sum(map(len, candidates[: comm.rank + 1]))
        chosen = on_all(lambda: _pivots(np.vstack(candidates), k), comm)
        place = np.flatnonzero((chosen >= last - len(own)) & (chosen < last))
        self._dofs = own[chosen[place] - (last - len(own))]
        stiffness = torn.tear(torn.assemble(torn.stiffness()))
        E, κ = np.zeros((torn.n, k)), np.zeros(k)
        E[self._dofs, place] = 1.0
        κ[place] = self._own = stiffness[self._dofs]
        self._κ = comm.allreduce(κ)
        self._E = _assembled(torn, E)
        held = comm.allreduce(E.T @ W)  # Eᵀ W
        share = 1.0 / torn.tear(torn.multiplicity())
        self.start = -_assembled(torn, share[:, None] * W) @ np.linalg.inv(held) / self._κ

    def add(self, A: PETSc.Mat) -> None:
        """Add the springs to the diagonal of a matrix that has been assembled anew."""
        K = A.getISLocalMat()
        if K.stateGet() != self._state:
            for dof, κ in zip(self._dofs, self._own, strict=True):
                K.setValue(dof, dof, κ, addv=PETSc.InsertMode.ADD_VALUES)
            K.assemble()
            K.stateIncrease()
            self._state = K.stateGet()

    def extended(self, border: Border) -> Border:
        """Return a border with the forces t as further scalars: t/κ − Eᵀ x = 0."""
        B, C = (np.hstack([columns, -self._E]) for columns in (border.B, border.C))
        return Border(B, C, scipy.linalg.block_diag(border.D, np.diag(1.0 / self._κ)))


def _free_motions(torn: Torn) -> Array:
    """Return the rigid motions that nothing resists, one body after the other, (n, k)."""
    bodies = find_bodies(torn)
    rigid = free_motions(torn, bodies, definite=False)
    columns = [
        np.where(bodies.label == b, rigid.fields[:, j], 0.0)
        for b, dimension in enumerate(rigid.dimensions)
        for j in range(dimension)
    ]
    W = np.array(columns).reshape(len(columns), torn.n).T
    largest = np.max(torn.comm.allgather(np.abs(W).max(axis=0, initial=0.0)), axis=0)
    return np.asarray(W / largest)


def _pivots(X: Array, k: int) -> Numbers:
    """Return rows of X, (n, k), that are as independent as can be, ascending, (up to k,)."""
    if not X.size:
        return np.zeros(0, dtype=np.int64)
    order = scipy.linalg.qr(X.T, mode="r", pivoting=True)[-1]
    return np.sort(order[:k])


def _assembled(torn: Torn, X: Array) -> Array:
    """Return the sums of the copies of each column, (n, k) → (owned, k). Collective."""
    return np.array([torn.assemble(x) for x in X.T]).reshape(X.shape[1], torn.owned).T


def _product(A: PETSc.Mat, X: Array, free: Mask) -> Array:
    """Return A X with zeros on Dirichlet dofs, (owned, k). Collective."""
    x, y = A.createVecs()
    Y = np.zeros_like(X)
    for k in range(X.shape[1]):
        x.array[:] = X[:, k]
        A.mult(x, y)
        Y[:, k] = np.where(free, y.array_r, 0.0)
    for vector in (x, y):
        vector.destroy()
    return Y


def _norms(X: Array, comm: MPI.Comm) -> Array:
    """Return the norms of columns over all processes, (k,)."""
    return np.sqrt(total_of((X**2).sum(axis=0), comm))


def _no_zeros(x: npt.ArrayLike) -> Array:
    """Return numbers with ones in place of zeros."""
    return np.where(np.asarray(x) == 0.0, 1.0, x)
