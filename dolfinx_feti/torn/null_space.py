# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The null space that the user attaches to a torn matrix by PETSc's ``setNullSpace``.

.. math:: A Z = 0, \quad Z^⊤ Z = I, \quad Z^⊤ b = 0, \quad Z^⊤ x = 0

with orthonormal columns Z of the assembled problem, (N, k). T Z, (n, k), has the values of their
copies. The coarse matrix has a null space of the same dimension (``coarse.null_space``).
"""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np

from dolfinx_feti.errors import SetUpError
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.torn.matrix import Torn
from dolfinx_feti.torn.rounding import FORCE_ROUNDING_MARGIN, residual_rounding

#: Largest error of Zᵀ Z = I, and of A z = 0 scaled by the diagonal of A. The value is far from
#: both errors that it separates: rounding errors, which are at most some thousand times ε = 2e-16
#: in the tests, and the error of a vector that is not a null vector, which is near one.
NULL_VECTOR_RTOL = 1e-10

#: Largest part of a load in the null space of A, relative to the load, that counts as rounding. The
#: same value as :data:`NULL_VECTOR_RTOL`, the accuracy of the Z in Zᵀ b. A load that nothing
#: balances has a part near one.
NULL_LOAD_RTOL = 1e-10


def read_null_space(torn: Torn) -> Array:
    """Return T Z, (n, k), without columns if no null space is attached. Collective."""
    columns = _null_vectors(torn)
    if not columns:
        return np.zeros((torn.n, 0))
    return np.column_stack([torn.tear(column) for column in columns])


def has_null_space(torn: Torn) -> bool:
    """Return True if a null space is attached to A, also on processes without dofs."""
    return bool(_null_vectors(torn))


def _null_vectors(torn: Torn) -> list[Array]:
    """Return the columns of Z, (N,) each; none if no null space is attached."""
    space = torn.A.getNullSpace()
    if not space.handle:
        return []
    columns = [mode.array_r.copy() for mode in space.getVecs()]
    if space.hasConstant():
        columns.append(np.full(torn.N, torn.A.getSize()[0] ** -0.5))
    return columns


def require_null_space(torn: Torn) -> None:
    """Check that Zᵀ Z = I and A Z = 0 for the present matrix. Collective.

    Raises:
        SetUpError: The vectors are not orthonormal, or A Z ≠ 0, or A is not symmetric.
    """
    columns = _null_vectors(torn)
    if not columns:
        return
    Z = np.column_stack(columns)
    gram = torn.comm.allreduce(Z.T @ Z)
    if not np.abs(gram - np.eye(len(gram))).max() <= NULL_VECTOR_RTOL:  # also if it is nan
        raise SetUpError(
            "The vectors of the null space of A are not orthonormal, as PETSc assumes: "
            "orthonormalise them first."
        )
    _require_null_vectors(torn, Z)
    if not torn.is_symmetric():
        raise SetUpError(
            "A has a null space and is not symmetric, but FETI solves only symmetric systems in "
            "the complement of a null space: prescribe as many dofs instead."
        )


def _require_null_vectors(torn: Torn, Z: Array) -> None:
    """Check that A Z = 0, and that Z moves no Dirichlet dof. Collective.

    Args:
        torn: The torn matrix.
        Z: Null vectors, (N, k).

    Raises:
        SetUpError: A column of Z is not a null vector.
    """
    d = torn.assemble(np.abs(torn.diagonal()))
    d = np.where(d > 0.0, d, 1.0)[:, None]
    AZ = np.column_stack([torn.assemble(torn.multiply(torn.tear(z))) for z in Z.T])
    is_fixed = torn.is_dirichlet
    squares = [
        (AZ[~is_fixed] ** 2 / d[~is_fixed]).sum(axis=0),
        (d[is_fixed] * Z[is_fixed] ** 2).sum(axis=0),
        (d * Z**2).sum(axis=0),
    ]
    force, motion, norm = np.sqrt(torn.comm.allreduce(np.array(squares)))
    error = np.maximum(force, motion)
    for j in np.flatnonzero(~(error <= NULL_VECTOR_RTOL * norm)):
        cause = "A resists it" if force[j] >= motion[j] else "it moves Dirichlet dofs"
        raise SetUpError(
            f"Vector {j} of the null space of A is not a null vector, {cause} (‖A z‖/‖z‖ = "
            f"{error[j] / norm[j]:.1e}, scaled by the diagonal of A): pass only vectors with "
            "A z = 0 to A.setNullSpace."
        )


def max_null_part(
    torn: Torn, b: PETSc.Vec, x: PETSc.Vec, r: PETSc.Vec, load_rounding: float
) -> float:
    """Return the largest ‖Zᵀ r‖ of r = b − A x_D that counts as rounding. Collective.

    Args:
        torn: The torn matrix.
        b: Load, (N,).
        x: x_D, prescribed values on Dirichlet dofs and zeros elsewhere, (N,).
        r: b − A x_D, (N,).
        load_rounding: Size of the rounding errors of b, in its units.

    Returns:
        The bound, in the units of b; infinite without a null space.
    """
    if not torn.A.getNullSpace().handle:
        return np.inf
    rounding = FORCE_ROUNDING_MARGIN * residual_rounding(torn, b, x)
    return max(NULL_LOAD_RTOL * r.norm(), rounding, load_rounding)


def remove_null_space(A: PETSc.Mat, v: PETSc.Vec) -> float:
    """Remove the part of a vector in the null space, v ← v − Z Zᵀ v. Collective.

    Args:
        A: Torn matrix; without a null space v does not change.
        v: The vector, (N,), changed in place.

    Returns:
        ‖Zᵀ v‖.
    """
    space = A.getNullSpace()
    if not space.handle:
        return 0.0
    part = v.copy()
    space.remove(v)
    part.axpy(-1.0, v)  # Z Zᵀ v
    norm = part.norm()
    part.destroy()
    return float(norm)
