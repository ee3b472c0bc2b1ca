# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Bodies, the parts of the problem that free dofs connect, and the motions that nothing resists.

A *body* is a connected component of the assembled problem without its Dirichlet dofs. Of its rigid
body modes Z, those that vanish on the Dirichlet dofs next to it are candidates for a kernel of A.
They are tested on the assembled matrix itself, scaled by its diagonal d,

.. math:: \hat A = d^{-1/2} A\, d^{-1/2}, \qquad \hat r = d^{1/2} r, \qquad
          \|\hat A \hat r\| ≤ τ\, \|\hat r\|,

or, where A is known to be positive semi-definite, by the energy :math:`\hat r^⊤ \hat A \hat r`,
which is not less than the smallest eigenvalue, and in which an error of r counts squared. This
needs no factor, and nothing of it depends on the decomposition. A prestressed body has rigid
motions that are no kernel; the test tells them apart, too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.sparse
import scipy.sparse.csgraph

from dolfinx_feti.feti.coarse.columns import triangles
from dolfinx_feti.torn import Torn

__all__ = ["RESIDUAL", "WEAK", "Bodies", "Motions", "ScaledOperator", "find_bodies", "free_motions"]

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

#: A scaled energy below this is rounding.
WEAK = 1e-14

#: A scaled force below this is rounding.
RESIDUAL = 1e-12

#: Rigid body modes of size one that are smaller than this on Dirichlet dofs count as free.
HELD = 1e-8


@dataclass(frozen=True, slots=True)
class Bodies:
    """The bodies of a torn matrix; they depend on its pattern alone.

    Attributes:
        count: Number of bodies over all processes.
        of: Body of each torn dof, (n,); ``count`` for those with a prescribed value.
        held: Torn dofs with a prescribed value next to a body, with the body; (pairs, 2).
    """

    count: int
    of: Integers
    held: Integers


@dataclass(frozen=True, slots=True)
class Motions:
    """Motions that nothing resists.

    Attributes:
        fields: Single-valued fields on the torn dofs; those of different bodies share columns,
            (n, m).
        dimensions: Number of motions of each body, in the first columns, (bodies,).
    """

    fields: Array
    dimensions: Integers

    @property
    def total(self) -> int:
        """Number of motions of all bodies."""
        return int(self.dimensions.sum())


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
        vector = torn.A.createVecRight()
        vector.array[:] = torn.assemble(np.abs(torn.diagonal()))
        d = torn.tear(vector)
        vector.array[:] = 1.0 / torn.multiplicity()
        self.share = np.sqrt(torn.tear(vector))
        vector.destroy()
        mean = torn.comm.allreduce(d.sum()) / max(torn.comm.allreduce(torn.n), 1)
        self.root = np.sqrt(np.where(d > 0.0, d, mean or 1.0))

    def sizes(self, X: Array) -> Array:
        r"""Return rows whose norms are those of :math:`\hat r = d^{1/2} r`, (n, k)."""
        return (self.share * self.root)[:, None] * X

    def forces(self, X: Array) -> Array:
        r"""Return rows whose norms are those of :math:`\hat A \hat r`, (n, k).

        Note:
            Collective.
        """
        torn, image = self._torn, np.empty_like(X)
        vector = torn.A.createVecRight()
        for j in range(X.shape[1]):
            vector.array[:] = torn.assemble(torn.multiply(X[:, j]))
            image[:, j] = torn.tear(vector)
        vector.destroy()
        image[torn.dirichlet] = 0.0
        return image * (self.share / self.root)[:, None]


def find_bodies(torn: Torn) -> Bodies:
    """Find the parts of the assembled problem that free dofs connect.

    Args:
        torn: The torn matrix.

    Note:
        Collective.
    """
    bs = torn.K.getBlockSize()
    graph = torn.graph
    free = np.any(~torn.dirichlet.reshape(-1, bs), axis=1)
    pieces, label = scipy.sparse.csgraph.connected_components(graph[free][:, free], directed=False)
    first = torn.comm.scan(pieces) - pieces
    piece = np.full(len(free), -1, dtype=np.int64)
    piece[free] = first + label
    count, merged = _merge(torn, np.repeat(piece, bs), torn.comm.allreduce(pieces))
    body = np.where(piece >= 0, merged[piece], count) if len(merged) else piece + 1
    of = np.repeat(body, bs)
    inside = np.flatnonzero(torn.dirichlet & (of < count))  # in blocks with another dof free
    block, beside = graph.tocsr()[~free][:, free].nonzero()
    pairs = np.unique(np.column_stack([np.flatnonzero(~free)[block], body[free][beside]]), axis=0)
    dofs = (pairs[:, :1] * bs + np.arange(bs)).ravel()
    held = np.vstack(
        [np.column_stack([inside, of[inside]]), np.column_stack([dofs, np.repeat(pairs[:, 1], bs)])]
    )
    return Bodies(count, np.where(torn.dirichlet, count, of), held)


def _merge(torn: Torn, piece: Integers, pieces: int) -> tuple[int, Integers]:
    """Join the pieces that hold copies of one dof: number of bodies, and the body of each piece."""
    copies = torn.gather(piece.astype(np.float64)).astype(np.int64)
    degree = torn.multiplicity()
    first = np.repeat(copies[np.cumsum(degree) - degree] if len(degree) else copies, degree)
    pairs = np.unique((first * pieces + copies)[(first >= 0) & (copies >= 0)])
    a, b = np.divmod(np.concatenate(torn.comm.allgather(pairs)), max(pieces, 1))
    joined = scipy.sparse.csr_array((np.ones(len(a)), (a, b)), shape=(pieces, pieces))
    count, label = scipy.sparse.csgraph.connected_components(joined, directed=False)
    return int(count), label.astype(np.int64)


def free_motions(
    torn: Torn, bodies: Bodies, near_kernel: Array, operator: ScaledOperator, *, definite: bool
) -> Motions:
    """Find the rigid motions of each body that neither its supports nor its stiffness resist.

    Args:
        torn: The torn matrix.
        bodies: Its bodies.
        near_kernel: Rigid body modes on the torn dofs, (n, k).
        operator: The assembled matrix, scaled.
        definite: Whether the assembled matrix is known to be positive semi-definite.

    Note:
        Collective.
    """
    comm, count, k = torn.comm, bodies.count, near_kernel.shape[1]
    candidates = np.zeros((count, k, k))
    dofs, owner = bodies.held.T
    sized = operator.sizes(near_kernel)
    on_held = triangles(sized[dofs], owner, count, comm)
    on_rest = triangles(sized, bodies.of, count, comm)
    on_all = np.concatenate([on_rest, on_held], axis=1)
    numbers = np.zeros(count, dtype=np.int64)
    for b in range(count):
        combinations = _vanishing(on_all[b], on_held[b])
        numbers[b] = combinations.shape[1]
        candidates[b, :, : numbers[b]] = combinations
    most = int(numbers.max(initial=0))
    if most == 0:
        return Motions(np.zeros((torn.n, 0)), numbers)
    fields = _combine(near_kernel, candidates[:, :, :most], bodies)
    forces = operator.forces(fields)
    weight = operator.sizes(fields)
    resisted = triangles(np.hstack([forces, weight]), bodies.of, count, comm)
    null = np.zeros((count, most, most))
    for b in range(count):
        found = unresisted(resisted[b][:, :most], resisted[b][:, most:], definite=definite)
        numbers[b] = found.shape[1]
        null[b, :, : numbers[b]] = found
    return Motions(_combine(fields, null[:, :, : numbers.max(initial=0)], bodies), numbers)


def unresisted(forces: Array, sizes: Array, *, definite: bool) -> Array:
    """Combine fields so that nothing resists them.

    Args:
        forces: Scaled forces of the fields, (rows, m), or what an orthogonal map makes of them.
        sizes: The scaled fields, mapped alike, (rows, m).
        definite: Whether their energy decides, and not their forces.

    Returns:
        Coefficients, (m, any number).
    """
    _, sigma, Vt = np.linalg.svd(sizes)
    there = sigma > HELD * sigma.max(initial=0.0)
    basis = Vt[there].T / sigma[there]  # fields of size one
    if definite:
        energy = (sizes @ basis).T @ (forces @ basis)
        values, Y = np.linalg.eigh(0.5 * (energy + energy.T))
        return np.asarray(basis @ Y[:, values <= WEAK])
    _, values, Yt = np.linalg.svd(forces @ basis)
    return np.asarray(basis @ Yt[values <= RESIDUAL].T)


def _vanishing(on_all: Array, on_held: Array) -> Array:
    """Combine modes, of size one on a body, that vanish where it is held, (k, any number).

    Args:
        on_all: The modes on the body, or what an orthogonal map makes of them, (rows, k).
        on_held: Those on its Dirichlet dofs, likewise.
    """
    _, sigma, Vt = np.linalg.svd(on_all)
    there = sigma > HELD * sigma.max(initial=0.0)
    basis = Vt[there].T / sigma[there]
    _, values, Yt = np.linalg.svd(on_held @ basis)
    return np.asarray(basis @ Yt[values <= HELD].T)


def _combine(fields: Array, coefficients: Array, bodies: Bodies) -> Array:
    """Combine fields body by body; zero on Dirichlet dofs.

    Args:
        fields: Columns on the torn dofs, (n, k).
        coefficients: For each body, (bodies, k, m).
        bodies: The bodies.
    """
    m = coefficients.shape[2]
    combined = np.zeros((len(fields), m))
    free = bodies.of < bodies.count
    for j in range(m):
        combined[free, j] = (fields[free] * coefficients[bodies.of[free], :, j]).sum(axis=1)
    return combined
