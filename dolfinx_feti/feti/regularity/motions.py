# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Motions that nothing resists, tested on the assembled matrix, scaled by its diagonal d.

.. math:: \hat A = d^{-1/2} A\, d^{-1/2}, \qquad \hat r = d^{1/2} r, \qquad
          \|\hat A \hat r\| ≤ τ\, \|\hat r\|,

or by :math:`\hat r^⊤ \hat A \hat r`, where A is known to be positive semi-definite. Candidates are
the rigid body modes of each body that vanish on its supports.
"""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI

import numpy as np

from dolfinx_feti.feti.gluing.bodies import Bodies
from dolfinx_feti.feti.subdomain.modes import UNSUPPORTED
from dolfinx_feti.feti.subdomain.orthonormal import (
    null_combinations,
    orthonormalising,
    symmetric_part,
)
from dolfinx_feti.runtime.arrays import Array, Integers, Numbers
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.torn.matrix import Torn
from dolfinx_feti.torn.null_space import null_space

#: A scaled energy below this is rounding, as it counts the error of a motion squared.
NO_ENERGY = 1e-14

#: A scaled force below this is rounding, also that of coordinates far from the origin.
NO_FORCE = 1e-12

#: Sine of the angle to given motions below which a motion is one of them.
NOT_RIGID = 1e-4


class ScaledOperator:
    r"""The assembled matrix on its free dofs, scaled by its diagonal: :math:`d^{-1/2} A d^{-1/2}`.

    Columns are single-valued fields on the torn dofs, zero on Dirichlet dofs.

    Attributes:
        share: Square root of a row's share in a sum over the copies of its dof, (n,).
        root: :math:`d^{1/2}`, (n,).
    """

    def __init__(self, torn: Torn) -> None:
        """Sum the diagonal. Collective."""
        self._torn = torn
        d = torn.tear(torn.assemble(np.abs(torn.diagonal())))
        self.share = np.sqrt(torn.tear(1.0 / torn.multiplicity()))
        mean = torn.comm.allreduce(d.sum()) / max(torn.comm.allreduce(torn.n), 1)
        self.root = np.sqrt(np.where(d > 0.0, d, mean or 1.0))

    def sizes(self, X: Array) -> Array:
        r"""Return rows whose norms are those of :math:`\hat r = d^{1/2} r`, (n, k)."""
        return (self.share * self.root)[:, None] * X

    def forces(self, X: Array) -> Array:
        r"""Return rows whose norms are those of :math:`\hat A \hat r`, (n, k). Collective."""
        torn, image = self._torn, np.empty_like(X)
        for j in range(X.shape[1]):
            image[:, j] = torn.tear(torn.assemble(torn.multiply(X[:, j])))
        image[torn.dirichlet] = 0.0
        return image * (self.share / self.root)[:, None]


@dataclass(frozen=True, slots=True)
class Motions:
    """Rigid motions of the bodies that nothing resists.

    Attributes:
        torn: The torn matrix.
        bodies: Its bodies.
        operator: The assembled matrix, scaled.
        definite: Whether that is known to be positive semi-definite.
        fields: Single-valued fields on the torn dofs; those of different bodies share columns,
            (n, m).
        dimensions: Number of motions of each body, in the first columns, (bodies,).
        null_space: What the matrix has been told to be its kernel, on the torn dofs, (n, k).
    """

    torn: Torn
    bodies: Bodies
    operator: ScaledOperator
    definite: bool
    fields: Array
    dimensions: Numbers
    null_space: Array

    @property
    def known(self) -> bool:
        """Whether the null space is known to hold all of them. Collective."""
        share, Z, W = self.operator.share[:, None], self.null_space, self.fields
        rest = W - Z @ self.torn.comm.allreduce((share * Z).T @ (share * W))  # W − Z Zᵀ W
        sizes = np.array([((share * X) ** 2).sum() for X in (rest, W)])
        beyond, whole = self.torn.comm.allreduce(sizes)
        return self.total <= Z.shape[1] and bool(beyond <= NOT_RIGID**2 * whole)

    @property
    def total(self) -> int:
        """Number of motions of all bodies."""
        return int(self.dimensions.sum())


def free_motions(torn: Torn, bodies: Bodies, *, definite: bool) -> Motions:
    """Find the rigid motions, among those of the near kernel, that nothing resists.

    ``definite`` tells that the assembled matrix is known to be positive semi-definite. Collective.
    """
    null_vectors, near_kernel = null_space(torn), torn.near_kernel()
    operator, (dofs, body) = ScaledOperator(torn), bodies.supports.T
    modes = operator.sizes(near_kernel)
    on_supports = triangles(modes[dofs], body, bodies.count, torn.comm)
    on_rest = triangles(modes, bodies.label, bodies.count, torn.comm)
    whole = np.concatenate([on_rest, on_supports], axis=1)
    unsupported = on_all(
        lambda: [_vanishing(whole[b], on_supports[b]) for b in range(bodies.count)], torn.comm
    )
    fields = _combine(near_kernel, unsupported, bodies)
    k, free = fields.shape[1], unsupported
    if k:
        scaled = np.hstack([operator.forces(fields), operator.sizes(fields)])
        resisted = triangles(scaled, bodies.label, bodies.count, torn.comm)
        parts = [(R[:, :k], R[:, k:]) for R in resisted]
        free = on_all(lambda: [unresisted(*of, definite=definite) for of in parts], torn.comm)
        fields = _combine(fields, free, bodies)
    dimensions = np.array([C.shape[1] for C in free], dtype=np.int64)
    return Motions(torn, bodies, operator, definite, fields, dimensions, null_vectors)


def unresisted(forces: Array, sizes: Array, *, definite: bool) -> Array:
    """Combine fields so that nothing resists them, (m, any number).

    Forces and fields are scaled, (rows, m) each, and may be mapped by one orthogonal map. Where the
    matrix is ``definite``, their energy decides.
    """
    basis = orthonormalising(sizes)
    if definite:
        energy = (sizes @ basis).T @ (forces @ basis)
        values, Y = np.linalg.eigh(symmetric_part(energy))
        return np.asarray(basis @ Y[:, values <= NO_ENERGY])
    return np.asarray(basis @ null_combinations(forces @ basis, NO_FORCE))


def _vanishing(on_all: Array, on_supports: Array) -> Array:
    """Combine modes, of size one on a body, that vanish on its Dirichlet dofs, (k, any number)."""
    basis = orthonormalising(on_all)
    return np.asarray(basis @ null_combinations(on_supports @ basis, UNSUPPORTED))


def _combine(fields: Array, coefficients: list[Array], bodies: Bodies) -> Array:
    """Combine fields, (n, k), body by body; zero on Dirichlet dofs and in columns a body lacks."""
    combined = np.zeros((len(fields), max((C.shape[1] for C in coefficients), default=0)))
    for b, C in enumerate(coefficients):
        if C.shape[1]:
            rows = bodies.label == b
            combined[rows, : C.shape[1]] = fields[rows] @ C
    return combined


def triangles(X: Array, group: Integers, count: int, comm: MPI.Comm) -> Array:
    """Return R of each group of rows X, (count, k, k), the same on all processes. Collective.

    Rows in other groups, (n,), than 0 … count − 1 are left out.
    """
    k = X.shape[1]
    if k == 0:
        return np.zeros((count, 0, 0))
    order = np.argsort(group, kind="stable")
    ends = np.searchsorted(group[order], np.arange(count + 1))

    def of_groups() -> Array:
        own = np.zeros((count, k, k))
        for g in np.flatnonzero(np.diff(ends)):
            own[g] = _triangle(X[order[ends[g] : ends[g + 1]]])
        return own

    stacked = np.stack(comm.allgather(on_all(of_groups, comm)), axis=1)  # (count, processes, k, k)
    whole = on_all(lambda: [_triangle(rows.reshape(-1, k)) for rows in stacked], comm)
    return np.array(whole).reshape(count, k, k)


def orthonormal_columns(X: Array, comm: MPI.Comm) -> Array:
    """Return an orthonormal basis of columns, by the rows of this process, (n, k). Collective."""
    k = X.shape[1]
    rows = np.vstack([X, np.zeros((k, k))])  # as many as columns, at least
    Q, R = on_all(lambda: np.linalg.qr(rows), comm)
    stacked = np.vstack(comm.allgather(R))
    Q_all, _ = on_all(lambda: np.linalg.qr(stacked), comm)
    return np.asarray(Q[: len(X)] @ Q_all[comm.rank * k : (comm.rank + 1) * k])


def independent_columns(X: Array, tolerance: float, comm: MPI.Comm) -> Array:
    """Return an orthonormal basis of columns of size one at most, by own rows, (n, k). Collective.

    Combinations of size one that are smaller than the tolerance are left out.
    """
    R = triangles(X, np.zeros(len(X), dtype=np.int64), 1, comm)[0]
    _, sigma, Vt = on_all(lambda: np.linalg.svd(R), comm)
    return orthonormal_columns(X @ Vt[sigma > tolerance].T, comm)


def _triangle(X: Array) -> Array:
    """Return R of X = Q R, (k, k)."""
    k = X.shape[1]
    if len(X) < k:
        X = np.vstack([X, np.zeros((k, k))])
    return np.asarray(np.linalg.qr(X, mode="r"))
