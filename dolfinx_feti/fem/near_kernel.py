# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The near kernel of a torn matrix: constants and, for a displacement, rotations."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from operator import itemgetter

from petsc4py import PETSc

import numpy as np

import dolfinx

from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.torn.matrix import set_near_kernel

#: Difference from 1 that is rounding, in the dofs of the function 1. Interpolation leaves some
#: 1e-15; dofs that are neither values nor means of a function, of bubbles for example, are 0.
ONE_ATOL = 1e-12


def attach_near_kernel(
    A: PETSc.Mat,
    V: dolfinx.fem.FunctionSpace,
    u: Array | None = None,
    *,
    attached: PETSc.NullSpace | None = None,
) -> PETSc.NullSpace | None:
    """Attach constants and, for displacements, rotations ω × (x + u). Collective.

    The coordinates of the dofs are attached, too. A near null space that the user has attached is
    not replaced.

    Args:
        A: Torn matrix of V.
        V: Space, whose dofs are values at points or moments. There are rotations if its block size
            bs is the dimension of space.
        u: Displacement of the dofs [mm], (owned blocks, bs); None for zero.
        attached: Result of the last call for A. If A has another near null space now, it is one
            that the user has attached.

    Returns:
        The near null space that this call has attached, which the caller destroys; None if that of
        the user stays.
    """
    gdim = V.mesh.geometry.dim
    bs = V.dofmap.index_map_bs
    one, X = _dofs_of_linear_functions(V)
    modes = [one[:, None] * direction for direction in np.eye(bs)]
    x = X if u is None or bs != gdim else X + u
    if bs == gdim:
        for i, j in itertools.combinations(range(gdim), 2):
            rotation = np.zeros_like(x)
            rotation[:, i] = x[:, j]
            rotation[:, j] = -x[:, i]
            modes.append(rotation)
    coordinates = np.where(one[:, None] == 1.0, x, np.nan)  # NaN: a dof without a point
    present = A.getNearNullSpace()
    is_ours = attached is not None and present.handle == attached.handle
    if present.handle and not is_ours:
        # petsc4py's vector keeps a reference to the array
        A.compose("coordinates", PETSc.Vec().createWithArray(coordinates.ravel(), comm=A.comm))
        return None
    vectors = [A.createVecRight() for _ in modes]
    for vector, mode in zip(vectors, modes, strict=True):
        vector.array[:] = np.ravel(mode)
    set_near_kernel(A, vectors, coordinates)
    return A.getNearNullSpace()


def _dofs_of_linear_functions(V: dolfinx.fem.FunctionSpace) -> tuple[Array, Array]:
    """Return the owned dofs of the functions 1 and x, in the first component of each block.

    Returns:
        Dofs of 1, (owned blocks,), and of each coordinate [mm], (owned blocks, gdim).
    """
    gdim = V.mesh.geometry.dim
    n = V.dofmap.index_map.size_local
    if V.element.interpolation_ident:  # dofs are values at points
        return np.ones(n), V.tabulate_dof_coordinates()[:n, :gdim].copy()
    one = _interpolate(V, _value_one)
    one[np.isclose(one, 1.0, rtol=0.0, atol=ONE_ATOL)] = 1.0
    coordinates = [_interpolate(V, itemgetter(i)) for i in range(gdim)]  # x[i] at points x
    return one, np.stack(coordinates, axis=-1)


def _value_one(x: Array) -> Array:
    """Return the value 1 at points, (points,)."""
    return np.ones(x.shape[1])


def _interpolate(V: dolfinx.fem.FunctionSpace, value: Callable[[Array], Array]) -> Array:
    """Return the owned dofs of a function in the first component of each block, (owned blocks,).

    Args:
        V: The space.
        value: Value at points x (3, points), which all components get, (points,).
    """
    f = dolfinx.fem.Function(V)
    components = int(np.prod(V.value_shape))

    def in_all_components(x: Array) -> Array:
        return np.broadcast_to(value(x), (components, x.shape[1]))

    f.interpolate(in_all_components)
    n = V.dofmap.index_map.size_local
    return f.x.array.reshape(-1, V.dofmap.index_map_bs)[:n, 0].copy()
