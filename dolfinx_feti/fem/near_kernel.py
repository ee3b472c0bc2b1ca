# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The near kernel: constants and, for a displacement, rotations, as dofs of a space."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from operator import itemgetter

from petsc4py import PETSc

import numpy as np

import dolfinx

from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.torn.matrix import set_near_kernel

#: Error of a dof of the constant 1.
ROUNDING = 1e-12


def attach_near_kernel(A: PETSc.Mat, V: dolfinx.fem.FunctionSpace, u: Array | None = None) -> None:
    """Attach constants and, for displacements, the rotations of the deformed body.

    A near null space of the user's stays. Rotations are included if the block size bs of V is the
    spatial dimension, and are those with the displacement u at the dofs, (owned blocks, bs). Dofs
    may be values at points, or moments.
    """
    gdim, bs = V.mesh.geometry.dim, V.dofmap.index_map_bs
    one, x = _linear_fields(V)
    modes = [one[:, None] * direction for direction in np.eye(bs)]
    if bs == gdim:
        x += 0.0 if u is None else u
        for i, j in itertools.combinations(range(gdim), 2):
            rotation = np.zeros_like(x)
            rotation[:, i], rotation[:, j] = x[:, j], -x[:, i]
            modes.append(rotation)
    x[one != 1.0] = np.nan  # such a dof is at no point
    space = A.getNearNullSpace()
    if space.handle and space.handle != A.getAttr("own near kernel"):  # the user's
        A.compose("coordinates", PETSc.Vec().createWithArray(x.ravel(), comm=A.comm))
        return
    vectors = [A.createVecRight() for _ in modes]
    for vector, mode in zip(vectors, modes, strict=True):
        vector.array[:] = np.ravel(mode)
    set_near_kernel(A, vectors, x)
    A.setAttr("own near kernel", A.getNearNullSpace().handle)


def _linear_fields(V: dolfinx.fem.FunctionSpace) -> tuple[Array, Array]:
    """Return the owned dofs of 1, (owned blocks,), and of the coordinates, (owned blocks, gdim)."""
    gdim, n = V.mesh.geometry.dim, V.dofmap.index_map.size_local
    if V.element.interpolation_ident:  # dofs are values at points
        return np.ones(n), V.tabulate_dof_coordinates()[:n, :gdim].copy()
    f, components = dolfinx.fem.Function(V), int(np.prod(V.value_shape))

    def dofs(value: Callable[[Array], Array]) -> Array:
        f.interpolate(lambda x: np.broadcast_to(value(x), (components, x.shape[1])))
        return f.x.array.reshape(-1, V.dofmap.index_map_bs)[:n, 0].copy()

    one = dofs(lambda x: np.ones(x.shape[1]))
    one[np.isclose(one, 1.0, rtol=0.0, atol=ROUNDING)] = 1.0
    return one, np.stack([dofs(itemgetter(i)) for i in range(gdim)], axis=-1)
