# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The torn matrix of a function space (MATIS), and its Dirichlet dofs.

``torn.matrix.create_torn_matrix`` creates a torn matrix from arrays; here they are those of a
dolfinx space. Dirichlet conditions (eq. 7 of the paper) do not change the entries of the local
matrices. The torn matrix has a list of their dofs, which the solver reads.
"""

from __future__ import annotations

from collections.abc import Sequence

from petsc4py import PETSc

import numpy as np

import dolfinx

from dolfinx_feti.fem.decomposition import TornSpace
from dolfinx_feti.runtime.arrays import Array, Mask
from dolfinx_feti.torn.matrix import DIRICHLET_DOFS, create_torn_matrix


def create_matrix_on_torn_space(
    space: TornSpace,
    K: PETSc.Mat,
    bcs: Sequence[dolfinx.fem.DirichletBC],
    stiffness: Array | None = None,
    symmetric: bool | None = None,
) -> PETSc.Mat:
    """Create the torn matrix of a torn space. Collective.

    Args:
        space: The torn space.
        K: Local matrix of this process, on the torn dofs.
        bcs: Dirichlet conditions.
        stiffness: Stiffness of each torn dof, (n_torn,), which determines the weights of the copies
            of a dof; see :func:`~dolfinx_feti.create_torn_matrix`.
        symmetric: Whether K is symmetric; None if that is not known.

    Returns:
        The matrix; the caller destroys it.
    """
    bs = space.V.dofmap.index_map_bs
    index_map = space.V.dofmap.index_map
    sizes = (index_map.size_local * bs, index_map.size_global * bs)
    comm = space.V.mesh.comm
    A = create_torn_matrix(
        K, space.global_block, sizes, comm=comm, stiffness=stiffness, symmetric=symmetric
    )
    set_dirichlet_dofs(A, dirichlet_mask(space.V, bcs))
    return A


def set_dirichlet_dofs(A: PETSc.Mat, is_dirichlet: Mask) -> None:
    """Replace the list of Dirichlet dofs of a torn matrix. Collective.

    The list is PETSc's object "dirichlet" of the matrix, as ``create_torn_matrix`` attaches it;
    ``torn.matrix.read_dirichlet_mask`` reads it.

    Args:
        A: The torn matrix.
        is_dirichlet: Mask of the owned dofs, (owned,).
    """
    dofs = np.flatnonzero(is_dirichlet) + A.getOwnershipRange()[0]
    A.compose(DIRICHLET_DOFS, PETSc.IS().createGeneral(dofs.astype(PETSc.IntType), comm=A.comm))


def dirichlet_mask(V: dolfinx.fem.FunctionSpace, bcs: Sequence[dolfinx.fem.DirichletBC]) -> Mask:
    """Return a mask of the owned dofs of V with a Dirichlet condition, (owned,)."""
    mask = np.zeros(V.dofmap.index_map.size_local * V.dofmap.index_map_bs, dtype=bool)
    for bc in bcs:
        dofs, _ = bc._cpp_object.dof_indices()  # owned ones, then ghosts
        is_owned = dofs < len(mask)
        mask[dofs[is_owned]] = True
    return mask
