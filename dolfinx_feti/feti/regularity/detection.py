# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Checks that the assembled matrix is regular: it must resist every motion (docs/theory.md).

1. *Rigid motions* of each body that its supports leave free (``rigid_motions``): an error, unless
   the null space that the user gave to A contains them. This test needs no factor.
2. *Null vectors of the coarse matrix.* If all :math:`K_i` are positive semi-definite, each motion
   is E s with N s = 0. With a singular N, random vectors grow in a solve (``coarse_matrix``); then
   null vectors are computed. The primal formulation has no N, and tests the fields of zero energy
   of its coarse space (``coarse.zero_energy``).
3. *Null vectors of* :math:`K_{II}`, which vanish on the interface, are never in a coarse space.

A null vector of 2 or 3 is a candidate: it is a motion of A only if its force in the scaled
assembled matrix is rounding.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from petsc4py import PETSc

import numpy as np

from dolfinx_feti.errors import SingularError
from dolfinx_feti.feti.coarse.solver import CoarseSolver
from dolfinx_feti.feti.regularity.bodies import Bodies
from dolfinx_feti.feti.regularity.coarse_matrix import (
    backward_error_in_range,
    growth_and_backward_error,
    null_vectors,
)
from dolfinx_feti.feti.regularity.messages import (
    NEARLY_SINGULAR,
    NULL_SPACE_INSIDE,
    inaccurate_solver_error,
    singular_error,
    singular_interior_error,
)
from dolfinx_feti.feti.regularity.rigid_motions import SAME_MOTION, RigidMotions, free_motions
from dolfinx_feti.feti.regularity.tsqr import independent_columns, r_factor
from dolfinx_feti.feti.subdomain.orthonormal import null_combinations, orthonormal_combinations
from dolfinx_feti.feti.subsolver_options import DirectOptions
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.torn.matrix import Torn
from dolfinx_feti.torn.rounding import FORCE_ROUNDING_MARGIN

#: Growth of a random vector in the scaled N⁻¹ above which null vectors are computed. Singular
#: matrices have larger ones. If N turns out to be regular, the null vectors were not needed, and
#: cost a few solves. Half of it changes no test.
SUSPICIOUS_GROWTH = 1e8

#: Backward error of a solve with N above which null vectors are computed, as they are the likely
#: reason. If none of them is a motion, the solver is inaccurate, which is an error. A choice far
#: above rounding: half of it changes no test.
MAX_BACKWARD_ERROR = 1e-8

#: Largest backward error of a solver of A₀. It may be larger than with N, because the error of the
#: projection is corrected in later iterations. Bodies with voids of 1e-12 of their stiffness have
#: 3e-8, and take as many iterations as without voids; a coarse Krylov method with a loose
#: tolerance, which is to be refused, has 1e-3 and more.
MAX_PROJECTION_ERROR = 1e-6

#: Vectors of inverse iteration in addition to the rigid motions. If there are this many mechanisms,
#: there may be more, and it is repeated with twice as many vectors. A choice of effort.
SPARE_VECTORS = 8

#: Largest number of vectors of inverse iteration: a message need not count more motions.
MAX_MOTIONS = 64

#: Norm up to which a combination of fields of norm one vanishes. Candidates of one motion agree in
#: half of their digits at least, so the square root of EPS. Half of it changes no test.
DEPENDENT_FIELD_NORM = 1e-8


class CoarseMotions(Protocol):
    """The motions of the torn structure that coarse vectors describe."""

    def field(self, s: Array) -> Array:
        """Return the motion E s with its copies averaged. Collective.

        Args:
            s: Coarse vector, (n_c,).

        Returns:
            The field, single-valued and zero on Dirichlet dofs, (n,).
        """


@dataclass(frozen=True, slots=True)
class CoarseMatrix:
    """N of the dual formulation, and what its null vectors are.

    Attributes:
        N: The coarse matrix, (N_c, N_c).
        solver: Its solver.
        options: Options of the solver.
        motions: Its vectors as motions.
    """

    N: PETSc.Mat
    solver: CoarseSolver
    options: DirectOptions
    motions: CoarseMotions


def require_supported(torn: Torn, bodies: Bodies) -> None:
    """Check that bodies cannot move rigidly except in the given null space. Collective.

    Raises:
        SingularError: A body can move; the message describes its motions.
    """
    rigid = free_motions(torn, bodies, is_semidefinite=False)
    if not rigid.lie_in_null_space():
        raise singular_error(rigid, np.zeros((torn.n, 0)))


def require_regular(
    torn: Torn, bodies: Bodies, coarse: CoarseMatrix, *, is_semidefinite: bool
) -> None:
    """Check by N of the dual formulation that A resists all motions. Collective.

    Args:
        torn: The torn matrix.
        bodies: Its bodies.
        coarse: N with added stiffness along a given null space, its solver, and its motions.
        is_semidefinite: Whether all K_i are known to be positive semi-definite.

    Raises:
        SingularError: A does not resist some motions, which the message describes; or the coarse
            solver is not accurate because N has a zero pivot, although no such motion was found.
        SetUpError: The coarse solver is not accurate for another reason.
    """
    rigid = free_motions(torn, bodies, is_semidefinite=is_semidefinite)
    has_unknown_motions = not rigid.lie_in_null_space()
    growth, error = growth_and_backward_error(coarse.N, coarse.solver)
    has_zero_pivot = np.isinf(growth)
    is_accurate = error <= MAX_BACKWARD_ERROR
    is_suspicious = not (growth <= SUSPICIOUS_GROWTH and is_accurate)
    mechanisms = np.zeros((torn.n, 0))
    if coarse.N.getSize()[0] and (is_suspicious or has_unknown_motions):
        mechanisms = _mechanisms(rigid, coarse)
    if has_unknown_motions or mechanisms.shape[1]:
        raise singular_error(rigid, mechanisms)
    if is_accurate:
        return
    if has_zero_pivot:
        raise SingularError(NEARLY_SINGULAR)
    raise inaccurate_solver_error(error, coarse.options.prefix)


def require_no_mechanism(
    torn: Torn, bodies: Bodies, fields: Array, *, is_semidefinite: bool
) -> None:
    """Check that A resists given fields, apart from rigid motions among them. Collective.

    Args:
        torn: The torn matrix.
        bodies: Its bodies.
        fields: Single-valued fields on the torn dofs, zero on Dirichlet dofs, (n, k). They may
            depend on each other.
        is_semidefinite: Whether all K_i are known to be positive semi-definite.

    Raises:
        SingularError: A does not resist some fields; the message describes their motions.
    """
    rigid = free_motions(torn, bodies, is_semidefinite=is_semidefinite)
    mechanisms = _unresisted_motions(fields, rigid)
    if mechanisms.shape[1]:
        raise singular_error(rigid, mechanisms)


def require_accurate_solver(A_0: PETSc.Mat, solver: CoarseSolver, options: DirectOptions) -> None:
    """Check the solver of A₀ by a right-hand side in the range of A₀. Collective.

    Args:
        A_0: The Galerkin matrix, (N_0, N_0), which may be singular.
        solver: Its solver.
        options: Options of the coarse solver.

    Raises:
        SetUpError: The solver is not accurate.
    """
    if not A_0.getSize()[0]:
        return
    error = backward_error_in_range(A_0, solver)
    if not error <= MAX_PROJECTION_ERROR:
        raise inaccurate_solver_error(error, options.prefix)


def require_regular_interior(torn: Torn, bodies: Bodies, kernel: Array) -> None:
    """Check that no interior of a subdomain is singular. Collective.

    Args:
        torn: The torn matrix.
        bodies: Its bodies.
        kernel: Null vectors of all K_II of this process on the torn dofs, (n, r).

    Raises:
        SingularError: Some process has null vectors. The message describes those that are motions
            of the assembled matrix, or says that the interface resists all of them.
    """
    counts = torn.comm.allgather(kernel.shape[1])
    if not any(counts):
        return
    rigid = free_motions(torn, bodies, is_semidefinite=False)
    if rigid.null_space.shape[1]:
        raise SingularError(NULL_SPACE_INSIDE)
    columns = [np.zeros((torn.n, count)) for count in counts]  # of each process
    columns[torn.comm.rank] = kernel
    mechanisms = _unresisted_motions(np.hstack(columns), rigid)
    if rigid.total or mechanisms.shape[1]:
        raise singular_error(rigid, mechanisms)
    raise singular_interior_error(counts)


def _mechanisms(rigid: RigidMotions, coarse: CoarseMatrix) -> Array:
    """Compute the motions of null vectors of N that are not rigid. Collective.

    With more than ``MAX_MOTIONS − SPARE_VECTORS`` rigid motions none are computed.

    Args:
        rigid: Rigid motions that nothing resists.
        coarse: N and its motions.

    Returns:
        The motions as columns on the torn dofs, (n, any number).
    """
    n = rigid.torn.n
    mechanisms = np.zeros((n, 0))
    count = rigid.total + SPARE_VECTORS
    while count <= MAX_MOTIONS:
        candidates = null_vectors(coarse.N, count, options=coarse.options)  # (n_c, ≤ count)
        fields = [coarse.motions.field(s) for s in candidates.T]
        columns = np.array(fields).reshape(candidates.shape[1], n).T
        mechanisms = _unresisted_motions(columns, rigid)
        if mechanisms.shape[1] < SPARE_VECTORS or count >= coarse.N.getSize()[0]:
            break
        count *= 2
    return mechanisms


def _unresisted_motions(W: Array, rigid: RigidMotions) -> Array:
    """Compute the combinations of fields that cause no force and are not rigid. Collective.

    A force counts as zero if it is at most ``FORCE_ROUNDING_MARGIN`` times the rounding errors of
    the force of a field, of the largest one if there are several.

    Args:
        W: Single-valued fields on the torn dofs, (n, k).
        rigid: Rigid motions that nothing resists.

    Returns:
        Motions on the torn dofs, (n, ≤ k).
    """
    W = _without_rigid_part(rigid, W)
    k = W.shape[1]
    if k == 0:
        return W
    comm = rigid.torn.comm
    matrix = rigid.matrix
    R = r_factor(np.hstack([matrix.scaled_forces(W), matrix.scale_motions(W)]), comm)
    forces = R[:, :k]
    motions = R[:, k:]
    rounding = matrix.force_rounding(W)

    def combinations() -> Array:
        basis = orthonormal_combinations(motions)
        largest_rounding = (np.abs(basis).T @ rounding).max(initial=0.0)
        tolerance = FORCE_ROUNDING_MARGIN * largest_rounding
        return np.asarray(basis @ null_combinations(forces @ basis, tolerance))

    return np.asarray(W @ on_all(combinations, comm))


def _without_rigid_part(rigid: RigidMotions, W: Array) -> Array:
    """Remove rigid motions from fields. Collective.

    Args:
        rigid: Rigid motions that nothing resists.
        W: Single-valued fields on the torn dofs, (n, k).

    Returns:
        A basis of the parts of the fields that are orthogonal to the motions in the scaling of
        ``scaled_assembled``, (n, ≤ k).
    """
    if W.shape[1] == 0:
        return W
    comm = rigid.torn.comm
    weight = rigid.matrix.motion_weight
    X = weight * W
    norm = np.sqrt(comm.allreduce((X**2).sum(axis=0)))
    X = independent_columns(X / np.where(norm > 0.0, norm, 1.0), DEPENDENT_FIELD_NORM, comm)
    motions = weight * rigid.fields
    for _ in range(2):  # the second pass removes the rounding errors of the first
        for j in range(motions.shape[1]):
            X = _orthogonal_on_each_body(rigid, X, motions[:, j : j + 1])
    return np.asarray(independent_columns(X, SAME_MOTION, comm) / weight)


def _orthogonal_on_each_body(rigid: RigidMotions, X: Array, r: Array) -> Array:
    """Return X − r (rᵀ X)/(rᵀ r) with the scalar products of each body, (n, k). Collective.

    Args:
        rigid: Rigid motions that nothing resists.
        X: Scaled fields, (n, k).
        r: A scaled motion of every body, zero on bodies without one, (n, 1).
    """
    label = rigid.bodies.label
    square = _sums_by_body(rigid, r**2)  # rᵀ r
    product = _sums_by_body(rigid, r * X)  # rᵀ X
    coefficient = product / np.where(square > 0.0, square, np.inf)  # (k, bodies + 1)
    return X - r * coefficient[:, label].T


def _sums_by_body(rigid: RigidMotions, columns: Array) -> Array:
    """Return the sums of columns, (n, k), over each body, (k, bodies + 1). Collective.

    Row j has the sums of column j. The last entry of a row is the sum over the Dirichlet dofs,
    which belong to no body.
    """
    bodies = rigid.bodies
    sums = [np.bincount(bodies.label, column, bodies.count + 1) for column in columns.T]
    return np.asarray(rigid.torn.comm.allreduce(np.array(sums)))
