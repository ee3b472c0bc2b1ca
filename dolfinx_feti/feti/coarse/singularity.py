# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Is the assembled matrix singular? Two ways to a motion that nothing resists.

1. *Rigid motions* of each body that its supports leave, tested on the assembled matrix
   (``bodies``).
2. *Null vectors of N.* Where all :math:`K_i` are positive semi-definite, A w = 0 means
   :math:`K_i w_i = 0`, so that w = E s with :math:`G s = 0, D s = 0` and N s = 0: the kernel of N
   holds all of the kernel of A, mechanisms included that are not rigid.

Rounding hides the kernel of N: its factor has tiny pivots, and no zero one. But it makes a random
vector grow, more than any regular problem does. Then inverse iteration with :math:`N + 10^{-12}
\operatorname{diag}|N|` finds the vectors s of which A is suspected. N may be nearly singular for
other reasons (slender bodies, prestress), so that each is made a field of the whole body, the
copies of E s averaged, and tested on the assembled matrix like the rigid motions.

A motion of the interior of a subdomain that its interface does not feel is a third way; K_II tells
(``matrices``).
"""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx_feti.errors import SetUpError, SingularError
from dolfinx_feti.feti.coarse.bodies import (
    Bodies,
    Motions,
    ScaledOperator,
    free_motions,
    unresisted,
)
from dolfinx_feti.feti.coarse.coarse import Coarse
from dolfinx_feti.feti.coarse.columns import (
    independent_columns,
    orthonormal_columns,
    triangles,
)
from dolfinx_feti.feti.coarse.gathered import GatheredSolver
from dolfinx_feti.feti.coarse.motions import describe
from dolfinx_feti.feti.gluing import Gluing
from dolfinx_feti.feti.subdomain.matrices import SubdomainMatrices
from dolfinx_feti.torn import Torn

__all__ = ["require_held", "require_regular", "require_regular_interior"]

Array = npt.NDArray[np.float64]

#: Growth of a random vector in the scaled N⁻¹ above which the assembled matrix is looked at.
GROWTH = 1e8

#: Backward error of a coarse solve above which the solver has failed.
BACKWARD = 1e-8

#: Inverse iteration: share of the diagonal that is added, vectors beside the known ones, rounds.
SHIFT, VECTORS, ROUNDS = 1e-12, 8, 4

#: Most motions that are looked for.
MOST = 64

#: Size below which a combination of suspected fields of size one is rounding.
DISTINCT = 1e-8

#: Sine of the angle below which a motion is a rigid one that is known.
APART = 1e-4

NEARLY = (
    "The assembled problem is singular up to rounding: it resists every motion, but one of them so "
    "little that the coarse matrix has a zero pivot. Look at the Dirichlet conditions and for "
    "coefficients that nearly vanish."
)


def require_regular(
    torn: Torn,
    bodies: Bodies,
    near_kernel: Array,
    gluing: Gluing,
    matrices: SubdomainMatrices,
    coarse: Coarse,
    *,
    symmetric: bool,
    definite: bool,
    prefix: str,
) -> None:
    """Look for motions that nothing resists.

    Args:
        torn: The torn matrix.
        bodies: Its bodies.
        near_kernel: Rigid body modes on the torn dofs, (n, k).
        gluing: The weights of the copies.
        matrices: The matrices of the subdomains.
        coarse: N with its solver.
        symmetric: Whether K is symmetric.
        definite: Whether all K_i are known to be positive semi-definite.
        prefix: Options prefix of the coarse solver.

    Raises:
        SingularError: There are some; the message names them.
        SetUpError: The coarse solver does not solve.

    Note:
        Collective.
    """
    operator = ScaledOperator(torn)
    rigid = free_motions(torn, bodies, near_kernel, operator, definite=definite)
    probe = _probe(coarse)
    others = np.zeros((torn.n, 0))
    sound = probe.grown <= GROWTH and probe.error <= BACKWARD
    if coarse.total and (rigid.total or not sound):
        suspects = _Suspects(torn, bodies, gluing, matrices, coarse, operator)
        others = suspects.find(rigid, symmetric=symmetric, definite=definite, prefix=prefix)
    if rigid.total or others.shape[1]:
        raise SingularError(describe(torn, bodies, rigid, others))
    if probe.zero_pivots and not probe.error <= BACKWARD:
        raise SingularError(NEARLY)
    if not probe.error <= BACKWARD:
        raise SetUpError(
            f"The coarse solver leaves a backward error of {probe.error:.1e}: look at the options "
            f"-{prefix}…, or let -{prefix}q be diagonal."
        )


def require_held(torn: Torn, bodies: Bodies, near_kernel: Array, *, definite: bool) -> None:
    """Look for rigid motions of a body that nothing resists.

    Args:
        torn: The torn matrix.
        bodies: Its bodies.
        near_kernel: Rigid body modes on the torn dofs, (n, k).
        definite: Whether all K_i are known to be positive semi-definite.

    Raises:
        SingularError: There are some; the message names them.

    Note:
        Collective.
    """
    operator = ScaledOperator(torn)
    rigid = free_motions(torn, bodies, near_kernel, operator, definite=definite)
    if rigid.total:
        raise SingularError(describe(torn, bodies, rigid, np.zeros((torn.n, 0))))


def require_regular_interior(
    torn: Torn, bodies: Bodies, near_kernel: Array, matrices: SubdomainMatrices
) -> None:
    """Look for motions of the interior of a subdomain that its interface does not feel.

    Raises:
        SingularError: There are some; the message names them.

    Note:
        Collective.
    """
    inside = matrices.interior_kernel()
    if not torn.comm.allreduce(inside.shape[1]):
        return
    operator = ScaledOperator(torn)
    rigid = free_motions(torn, bodies, near_kernel, operator, definite=False)
    apart = [np.zeros((torn.n, n)) for n in torn.comm.allgather(inside.shape[1])]
    apart[torn.comm.rank] = inside
    others = _unresisted(np.hstack(apart), rigid, bodies, operator, torn, definite=False)
    raise SingularError(describe(torn, bodies, rigid, others))


@dataclass(frozen=True, slots=True)
class _Probe:
    """What one solve with the factor of N tells.

    Attributes:
        grown: Growth of a random vector in d^½ N⁻¹ d^½, d the diagonal of N.
        error: Backward error, ‖b − N x‖/(‖N‖‖x‖ + ‖b‖).
        zero_pivots: Whether the factor met any.
    """

    grown: float
    error: float
    zero_pivots: bool


def _probe(coarse: Coarse) -> _Probe:
    """Solve with a random right-hand side. Collective."""
    if coarse.total == 0:
        return _Probe(1.0, 0.0, False)
    root = np.sqrt(_diagonal(coarse))
    b, x = coarse.N.createVecs()
    r = b.duplicate()
    b.array[:] = root * np.random.default_rng(coarse.start).standard_normal(coarse.size)
    start = b.copy()
    start.array[:] /= root
    x.array[:] = coarse.solve(b.array_r)
    coarse.N.mult(x, r)
    r.axpy(-1.0, b)
    error = r.norm() / (coarse.N.norm() * x.norm() + b.norm())
    x.array[:] *= root
    zero_pivots = bool(coarse.solver.pivots().zero)
    grown = np.inf if zero_pivots else x.norm() / start.norm()
    for owned in (b, x, r, start):
        owned.destroy()
    return _Probe(grown, error, zero_pivots)


def _diagonal(coarse: Coarse) -> Array:
    """Return the absolute diagonal of N, zeros taken for ones."""
    diagonal = coarse.N.getDiagonal()
    d = np.abs(diagonal.array_r)
    diagonal.destroy()
    return np.where(d > 0.0, d, 1.0)


class _Suspects:
    """The way from null vectors of N to motions of the bodies."""

    def __init__(
        self,
        torn: Torn,
        bodies: Bodies,
        gluing: Gluing,
        matrices: SubdomainMatrices,
        coarse: Coarse,
        operator: ScaledOperator,
    ) -> None:
        self._torn, self._bodies, self._gluing = torn, bodies, gluing
        self._matrices, self._coarse, self._operator = matrices, coarse, operator

    def find(self, rigid: Motions, *, symmetric: bool, definite: bool, prefix: str) -> Array:
        """Find motions beside the rigid ones that nothing resists, (n, any number)."""
        coarse, torn = self._coarse, self._torn
        d = _diagonal(coarse)
        shifted = coarse.N.copy()
        diagonal = shifted.getDiagonal()
        diagonal.array[:] += SHIFT * d
        shifted.setDiagonal(diagonal)
        solver = GatheredSolver(shifted, prefix=prefix, symmetric=symmetric)
        count = rigid.total + VECTORS
        found = np.zeros((torn.n, 0))
        while count <= MOST:
            S = self._smallest(solver, np.sqrt(d), count)
            found = _unresisted(
                self._fields(S), rigid, self._bodies, self._operator, torn, definite=definite
            )
            if found.shape[1] < VECTORS or count >= coarse.total:
                break
            count *= 2
        for owned in (solver, shifted, diagonal):
            owned.destroy()
        return found

    def _smallest(self, solver: GatheredSolver, root: Array, count: int) -> Array:
        """Approximate null vectors of the scaled N by inverse iteration, (K, count).

        Returns:
            None of them if the solver fails.
        """
        coarse = self._coarse
        count = min(count, coarse.total)
        b, x = coarse.N.createVecs()
        X = np.random.default_rng(coarse.start).standard_normal((coarse.size, count))
        for _ in range(ROUNDS):
            Y = np.empty_like(X)
            for j in range(count):
                b.array[:] = root * X[:, j]
                solver.solve(b, x)
                Y[:, j] = root * x.array_r
            solved = self._torn.comm.allreduce(bool(np.isfinite(Y).all()), op=MPI.LAND)
            X = orthonormal_columns(Y, self._torn.comm) if solved else Y[:, :0]
            count = X.shape[1]
        b.destroy()
        x.destroy()
        return X / root[:, None]

    def _fields(self, S: Array) -> Array:
        """Average the copies of E s for each column s, (K, r) → (n, r)."""
        torn, vector = self._torn, self._torn.A.createVecRight()
        W = np.empty((torn.n, S.shape[1]))
        for j in range(S.shape[1]):
            vector.array[:] = torn.assemble(self._gluing.delta * self._coarse.prolong(S[:, j]))
            w = np.where(torn.dirichlet, 0.0, torn.tear(vector))
            W[:, j] = self._matrices.extend(w, np.zeros(torn.n))
        vector.destroy()
        W[torn.dirichlet] = 0.0
        return W


def _unresisted(
    W: Array,
    rigid: Motions,
    bodies: Bodies,
    operator: ScaledOperator,
    torn: Torn,
    *,
    definite: bool,
) -> Array:
    """Combine fields to motions, beside the rigid ones, that nothing resists. Collective."""
    if W.shape[1] == 0:
        return W
    W = _beside(rigid, W, bodies, operator, torn)
    if W.shape[1] == 0:
        return W
    both = np.hstack([operator.forces(W), operator.sizes(W)])
    R = triangles(both, np.zeros(torn.n, dtype=np.int64), 1, torn.comm)[0]
    m = W.shape[1]
    return np.asarray(W @ unresisted(R[:, :m], R[:, m:], definite=definite))


def _beside(
    rigid: Motions, W: Array, bodies: Bodies, operator: ScaledOperator, torn: Torn
) -> Array:
    """Take the rigid motions out of fields; return a basis of what is left. Collective."""
    comm, count = torn.comm, bodies.count
    root = (operator.share * operator.root)[:, None]
    X = root * W
    size = np.sqrt(comm.allreduce((X**2).sum(axis=0)))
    X = independent_columns(X / np.where(size > 0.0, size, 1.0), DISTINCT, comm)
    for _ in range(2):
        for column in (root * rigid.fields).T:
            overlap, own = (
                comm.allreduce(np.array([np.bincount(bodies.of, c, count + 1) for c in part.T]))
                for part in (column[:, None] * X, column[:, None] ** 2)
            )
            share = overlap / np.where(own > 0.0, own, np.inf)
            X = X - column[:, None] * share[:, bodies.of].T
    return np.asarray(independent_columns(X, APART, comm) / root)
