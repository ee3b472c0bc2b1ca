# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Is the assembled matrix singular? Three ways to a motion that nothing resists (docs/theory.md).

1. *Rigid motions* of each body that its supports leave (``motions``), but for a given null space.
2. *Null vectors of N*, mechanisms that are not rigid included, where all :math:`K_i` are positive
   semi-definite: they make a random vector grow, and are tested like the rigid motions.
3. *Null vectors of* :math:`K_{II}`, if the interface does not feel them.

The message counts the translations and rotations of each body. Translations are what the mean of
each component leaves nothing of, :math:`(F - \bar F)^⊤ (F - \bar F)\, y = 0`.
"""

from __future__ import annotations

from collections.abc import Callable

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.errors import SetUpError, SingularError
from dolfinx_feti.feti.coarse.gathered import GatheredSolver
from dolfinx_feti.feti.gluing.bodies import Bodies
from dolfinx_feti.feti.regularity.motions import (
    NOT_RIGID,
    Motions,
    free_motions,
    independent_columns,
    orthonormal_columns,
    triangles,
    unresisted,
)
from dolfinx_feti.runtime.arrays import Array, Mask
from dolfinx_feti.runtime.collective import bounds, on_all, total_of
from dolfinx_feti.torn.matrix import Torn

#: Growth of a random vector in the scaled N⁻¹ above which the assembled matrix is looked at: less
#: than that of a singular block, as a look is all that follows.
SUSPICIOUS_GROWTH = 1e8

#: Backward error of a coarse solve above which the solver has failed.
BACKWARD = 1e-8

#: Inverse iteration with N: share of the diagonal that is added, spare vectors, rounds.
COARSE_SHIFT, SPARE, ROUNDS = 1e-12, 8, 4

#: Most motions that are looked for.
MOST = 64

#: Size below which a combination of fields of size one is rounding.
DISTINCT = 1e-8

#: Share of a motion beside its mean, squared, below which it is a translation.
CONSTANT = 1e-10

#: Most bodies that are described.
DESCRIBED = 3

NEARLY = (
    "The assembled problem is singular up to rounding: it resists every motion, but one of them so "
    "little that the coarse matrix has a zero pivot. Look at the Dirichlet conditions and for "
    "coefficients that nearly vanish."
)

INSIDE = (
    "The null space of A, or a part of it, lies inside of a subdomain that is not glued to others: "
    "tear each body into two subdomains, at least."
)


#: Where the interface resists what the interior does not: yᵀ A y = 0 and A y ≠ 0.
INTERIOR = (
    "The matrix of the interior of a subdomain is singular ({} motions, of subdomains on process "
    "{}), though the interface resists them: the assembled matrix is indefinite or nearly "
    "singular. In Newton's method take smaller steps; otherwise take other subdomains, or the "
    "options feti_interior keep and feti_pc_type lumped."
)


def require_regular(
    torn: Torn,
    bodies: Bodies,
    N: PETSc.Mat,
    solver: GatheredSolver,
    *,
    field: Callable[[Array], Array],
    definite: bool,
    prefix: str,
) -> None:
    """Look for motions that nothing resists. Collective.

    Args:
        torn: The torn matrix.
        bodies: Its bodies.
        N: The coarse matrix, regular along a null space that the matrix has been given, (K, K).
        solver: Its factors.
        field: Returns E s with its copies averaged, zero on Dirichlet dofs, (K,) → (n,).
        definite: Whether all K_i are known to be positive semi-definite.
        prefix: Options prefix of the coarse solver.

    Raises:
        SingularError: There are some; the message names them.
        SetUpError: The coarse solver does not solve.
    """
    rigid = free_motions(torn, bodies, definite=definite)
    growth, error = _growth_and_error(N, solver)
    others = np.zeros((torn.n, 0))
    sound = growth <= SUSPICIOUS_GROWTH and error <= BACKWARD
    most, known = rigid.total + SPARE, rigid.known
    while N.getSize()[0] and not (known and sound) and most <= MOST:
        S = _null_vectors(N, most, prefix=prefix)
        W = np.array([field(s) for s in S.T]).reshape(S.shape[1], torn.n).T
        others = _unresisted(W, rigid)
        if others.shape[1] < SPARE or most >= N.getSize()[0]:
            break
        most *= 2
    if not known or others.shape[1]:
        raise SingularError(_describe(rigid, others))
    if np.isinf(growth) and not error <= BACKWARD:
        raise SingularError(NEARLY)
    if not error <= BACKWARD:
        raise SetUpError(
            f"The coarse solver leaves a backward error of {error:.1e}: look at the options "
            f"-{prefix}…"
        )


def require_held(torn: Torn, bodies: Bodies) -> None:
    """Look for rigid motions alone; see :func:`require_regular`. Collective."""
    rigid = free_motions(torn, bodies, definite=False)
    if not rigid.known:
        raise SingularError(_describe(rigid, np.zeros((torn.n, 0))))


def require_regular_interior(torn: Torn, bodies: Bodies, kernel: Array) -> None:
    """Refuse motions of the interior of a subdomain that its interface does not feel. Collective.

    They are the null vectors of all K_II of this process on the torn dofs, (n, r). A SingularError
    names those of all processes.
    """
    counts = torn.comm.allgather(kernel.shape[1])
    if not any(counts):
        return
    rigid = free_motions(torn, bodies, definite=False)
    if rigid.null_space.shape[1]:
        raise SingularError(INSIDE)
    columns = [np.zeros((torn.n, count)) for count in counts]
    columns[torn.comm.rank] = kernel
    others = _unresisted(np.hstack(columns), rigid)
    if not rigid.total + others.shape[1]:
        processes = ", ".join(str(rank) for rank in np.flatnonzero(counts))
        raise SingularError(INTERIOR.format(sum(counts), processes))
    raise SingularError(_describe(rigid, others))


def _growth_and_error(N: PETSc.Mat, solver: GatheredSolver) -> tuple[float, float]:
    """Solve with a random right-hand side; collective.

    Returns:
        Growth of a random vector in d^½ N⁻¹ d^½, d the diagonal of N, infinite with a zero pivot;
        and the backward error ‖b − N x‖/(‖N‖‖x‖ + ‖b‖).
    """
    if N.getSize()[0] == 0:
        return 1.0, 0.0
    b, x = N.createVecs()
    r, root = b.duplicate(), np.sqrt(_diagonal(N))
    random = _random(N, 1)[:, 0]
    b.array[:] = root * random
    solver.solve(b, x)
    N.mult(x, r)
    r.axpy(-1.0, b)
    error = r.norm() / (N.norm() * x.norm() + b.norm())
    x.array[:] *= root
    b.array[:] = random
    growth = np.inf if solver.pivots().zero else x.norm() / b.norm()
    for owned in (b, x, r):
        owned.destroy()
    return growth, error


def _diagonal(N: PETSc.Mat) -> Array:
    """Return the absolute diagonal of N, zeros taken for ones."""
    diagonal = N.getDiagonal()
    d = np.abs(diagonal.array_r)
    diagonal.destroy()
    return np.where(d > 0.0, d, 1.0)


def _random(N: PETSc.Mat, count: int) -> Array:
    """Return the process's rows of random columns, (K, count)."""
    first, last = N.getOwnershipRange()
    return np.random.default_rng(first).standard_normal((last - first, count))


def _null_vectors(N: PETSc.Mat, count: int, *, prefix: str) -> Array:
    """Approximate null vectors of the scaled N by inverse iteration; none if the solver fails."""
    comm, d = N.comm.tompi4py(), _diagonal(N)
    root, shifted = np.sqrt(d), N.copy()
    b, x = N.createVecs()
    b.array[:] = COARSE_SHIFT * d
    shifted.setDiagonal(b, addv=PETSc.InsertMode.ADD_VALUES)
    solver = GatheredSolver(shifted, prefix=prefix, symmetric=True)
    X = _random(N, min(count, N.getSize()[0]))
    for _ in range(ROUNDS):
        Y = np.empty_like(X)
        for j in range(X.shape[1]):
            b.array[:] = root * X[:, j]
            solver.solve(b, x)
            Y[:, j] = root * x.array_r
        solved = comm.allreduce(bool(np.isfinite(Y).all()), op=MPI.LAND)
        X = orthonormal_columns(Y, comm) if solved else Y[:, :0]
    for owned in (solver, shifted, b, x):
        owned.destroy()
    return X / root[:, None]


def _unresisted(W: Array, rigid: Motions) -> Array:
    """Combine fields to motions that nothing resists, the rigid ones taken out. Collective."""
    W, operator = _without(rigid, W), rigid.operator
    m = W.shape[1]
    if m == 0:
        return W
    both = np.hstack([operator.forces(W), operator.sizes(W)])
    R = triangles(both, np.zeros(len(W), dtype=np.int64), 1, rigid.torn.comm)[0]
    parts = R[:, :m], R[:, m:]
    C = on_all(lambda: unresisted(*parts, definite=rigid.definite), rigid.torn.comm)
    return np.asarray(W @ C)


def _without(rigid: Motions, W: Array) -> Array:
    """Take the rigid motions out of fields; return a basis of what is left. Collective."""
    if W.shape[1] == 0:
        return W
    comm, bodies = rigid.torn.comm, rigid.bodies
    root = rigid.operator.sizes(np.ones((len(W), 1)))
    X = root * W
    size = np.sqrt(comm.allreduce((X**2).sum(axis=0)))
    X = independent_columns(X / np.where(size > 0.0, size, 1.0), DISTINCT, comm)

    def by_body(parts: Array) -> Array:
        own = [np.bincount(bodies.label, part, bodies.count + 1) for part in parts.T]
        return np.asarray(comm.allreduce(np.array(own)))

    for _ in range(2):
        for r in (root * rigid.fields).T[..., None]:  # (n, 1) each
            square = by_body(r**2)
            share = by_body(r * X) / np.where(square > 0.0, square, np.inf)
            X = X - r * share[:, bodies.label].T  # X ← X − r (rᵀ X)/(rᵀ r)
    return np.asarray(independent_columns(X, NOT_RIGID, comm) / root)


def _describe(rigid: Motions, others: Array) -> str:
    """Return the message of the error: rigid motions, and others, (n, any number). Collective."""
    total, torn = rigid.total + others.shape[1], rigid.torn
    text = f"The assembled problem is singular, with a kernel of dimension {total}: "
    x = torn.coordinates()
    moving = np.flatnonzero(rigid.dimensions)
    parts = [_body(rigid, x, int(b)) for b in moving[:DESCRIBED]]
    if len(moving) > DESCRIBED:
        parts.append(f"{len(moving) - DESCRIBED} more parts are free")
    if others.shape[1]:
        what = "a motion that is" if others.shape[1] == 1 else f"{others.shape[1]} motions that are"
        parts.append(f"nothing resists {what} not rigid{_largest(torn, x, others[:, 0])}")
    remedy = "Add Dirichlet conditions, connect what is loose, or give A this null space"
    return text + "; ".join(parts) + f". {remedy} (A.setNullSpace)."


def _body(rigid: Motions, x: Array | None, b: int) -> str:
    """Say where a body is, and how it may move."""
    torn, count, mine = rigid.torn, rigid.bodies.count, rigid.bodies.label == b
    if x is not None:
        mine &= np.isfinite(x[:, 0])  # the others are at no point
    names = _names(torn, mine, rigid.fields[mine, : rigid.dimensions[b]])
    said = f"the Dirichlet conditions leave {names} free"
    if count == 1:
        return said
    where = "" if x is None else f" around {_middle(torn, x[mine])}"
    return f"in a part that is not connected to the rest ({b + 1} of {count}{where}) {said}"


def _names(torn: Torn, mine: Mask, F: Array) -> str:
    """Count the rigid motions F of a body, (n, m), by their kinds; ``mine`` marks its dofs."""
    bs, comm = torn.A.getBlockSize(), torn.comm
    if bs == 1:
        return "a constant"
    of_component = np.eye(bs)[np.flatnonzero(mine) % bs]
    gram, sums = total_of(F.T @ F, comm), total_of(of_component.T @ F, comm)
    number = np.maximum(total_of(of_component.sum(axis=0), comm), 1.0)
    beside = gram - sums.T @ (sums / number[:, None])  # (F − F̄)ᵀ (F − F̄)
    shares = np.linalg.eigvals(np.linalg.pinv(gram, hermitian=True) @ beside).real
    turning = int(np.count_nonzero(shares > CONSTANT))
    kinds = (len(shares) - turning, "translation"), (turning, "rotation")
    return " and ".join(f"{n} {kind}{'s' * (n > 1)}" for n, kind in kinds if n)


def _middle(torn: Torn, x: Array) -> str:
    """Return the middle of points over all processes."""
    low, high = bounds(x, torn.comm)
    return _point(0.5 * (low + high))


def _largest(torn: Torn, x: Array | None, w: Array) -> str:
    """Say where a field is largest."""
    if x is None:
        return ""
    bs = torn.A.getBlockSize()
    size = np.where(np.isfinite(x[::bs, 0]), np.linalg.norm(w.reshape(-1, bs), axis=1), 0.0)
    i = int(size.argmax()) if len(size) else 0
    own = (float(size[i]), x[bs * i].tolist()) if len(size) else (-1.0, [])
    return f", largest at {_point(np.array(max(torn.comm.allgather(own))[1]))}"


def _point(x: Array) -> str:
    """Write coordinates, without what is rounding."""
    scale = max(float(np.abs(x).max()), 1e-300)
    return "(" + ", ".join(f"{round(v / scale, 6) * scale + 0.0:.4g}" for v in x) + ")"
