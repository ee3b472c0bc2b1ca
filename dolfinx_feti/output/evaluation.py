# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Values of fields and UFL expressions, such as a stress, at points of the reference body.

A point X lies in one cell, or in several on their common facet, edge or vertex. Its value is the
mean over these cells, and so independent of the numbering of cells and of the processes.
In a cell, the expression is evaluated at the reference coordinates ξ with x(ξ) = X, without any
interpolation.
"""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import basix
import dolfinx
import ufl
from ufl.core.expr import Expr

from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.runtime import compat
from dolfinx_feti.runtime.arrays import Array, Integers, Mask
from dolfinx_feti.runtime.collective import on_all, total_of

__all__ = ["evaluate", "mesh_of"]

#: Share of the extent of the mesh by which boxes around cells are enlarged: rounding of the points
#: is 1e-16 of it. A larger share adds a few candidate cells, and changes no result.
PADDING = 1e-10

#: Reference coordinate by which a point may lie outside of a cell. Points that a user computes have
#: rounding errors of 1e-15; from 1e-7 on, neighbouring cells contribute to the mean.
OUTSIDE = 1e-10

#: Steps of Newton's method for reference coordinates: one for affine cells, four to six for curved
#: ones and hexahedra. Points that have not converged are outside of a distorted cell.
STEPS = 25

#: Points in one compiled expression, which is evaluated at all of them in each of their cells: 64²
#: evaluations take less time than the compilation of a second expression.
CHUNK = 64


def evaluate(expression: Expr, points: npt.ArrayLike) -> Array:
    """Return the values of a Function or UFL expression at points.

    Example::

        stress = kinematics.cauchy_stress(psi, F)
        print(evaluate(stress, [0.0, 10.5, 40.0]))  # (3, 3)

    Args:
        expression: The Function or expression, of any shape.
        points: Points X of the reference body, (gdim,) or (n, gdim), equal on all processes.

    Returns:
        Values, (n, …shape), or (…shape) for a single point, on all processes; the mean over the
        cells if a point lies in several.

    Raises:
        ValueError: A point is in no cell, the points have another number of coordinates, or the
            expression has no mesh, or no values inside cells.

    Note:
        Collective.
    """
    mesh = mesh_of(expression)
    X, is_single = on_all(lambda: _checked_points(points, mesh.geometry.dim), mesh.comm)
    which, cells, ξ = on_all(lambda: _cells_with(mesh, X), mesh.comm)
    count = total_of(np.bincount(which, minlength=len(X)).astype(np.float64), mesh.comm)
    outside = X[count == 0.0]
    if len(outside):
        named = ", ".join(str(x.tolist()) for x in outside[:3])
        raise ValueError(
            f"{len(outside)} of {len(X)} points are in no cell of the mesh, such as {named}: give "
            "points of the reference body. On a curved surface, which straight cells cut off, move "
            "them inwards."
        )
    values_in_cells = on_all(lambda: _values(expression, mesh, cells, ξ), mesh.comm)
    sums = np.zeros((len(X), values_in_cells.shape[1]))
    np.add.at(sums, which, values_in_cells)
    means = total_of(sums, mesh.comm) / count[:, None]
    values = means.reshape(len(X), *expression.ufl_shape)
    return values[0] if is_single else values


def mesh_of(expression: Expr) -> dolfinx.mesh.Mesh:
    """Return the mesh of an expression.

    Raises:
        ValueError: It has none.
    """
    domain = ufl.domain.extract_unique_domain(expression)
    if domain is None:
        raise ValueError(
            f"The expression {expression} lives on no mesh: give an expression in a Function."
        )
    return dolfinx.mesh.Mesh(domain.ufl_cargo(), domain)


def _checked_points(points: npt.ArrayLike, gdim: int) -> tuple[Array, bool]:
    """Return points, (n, gdim), and whether they were a single one.

    Raises:
        ValueError: The shape is wrong, or a coordinate is not finite.
    """
    X = np.asarray(points, dtype=np.float64)
    if X.ndim not in (1, 2) or X.shape[-1] != gdim or not np.isfinite(X).all():
        raise ValueError(
            f"points has the shape {X.shape}: give finite coordinates, ({gdim},) or (n, {gdim})."
        )
    return X.reshape(-1, gdim), X.ndim == 1


def _cells_with(mesh: dolfinx.mesh.Mesh, X: Array) -> tuple[Integers, Integers, Array]:
    """Find the owned cells that contain points. Not collective.

    Returns:
        Pairs of a point and a cell, (pairs,) each, and the point's reference coordinates in the
        cell, (pairs, tdim).
    """
    tdim = mesh.topology.dim
    n_cells = mesh.topology.index_map(tdim).size_local
    padding = PADDING * float(np.ptp(mesh.geometry.x, axis=0).max()) if n_cells else 0.0
    tree = dolfinx.geometry.bb_tree(
        mesh, tdim, entities=np.arange(n_cells, dtype=np.int32), padding=padding
    )
    in_space = np.zeros((len(X), 3))
    in_space[:, : X.shape[1]] = X
    found = dolfinx.geometry.compute_collisions_points(tree, in_space)
    cells = np.asarray(found.array, dtype=np.int64)
    which = np.repeat(np.arange(len(X)), np.diff(found.offsets))
    ξ, is_inside = _reference_coordinates(mesh, cells, X[which])
    return which[is_inside], cells[is_inside], ξ[is_inside]


def _reference_coordinates(
    mesh: dolfinx.mesh.Mesh, cells: Integers, X: Array
) -> tuple[Array, Mask]:
    """Solve x(ξ) = X in a cell for each point by Newton's method.

    Args:
        mesh: The mesh.
        cells: A cell for each point, (n,).
        X: Points, (n, gdim).

    Returns:
        ξ, (n, tdim), and a mask of the points that are in their cell, (n,).
    """
    element: Any = mesh.ufl_domain().ufl_coordinate_element()
    scalar = element.sub_elements[0]
    cell_type = element.cell_type
    nodes = mesh.geometry.x[compat.geometry_dofmap(mesh)[cells]][:, :, : X.shape[1]]
    vertices = np.asarray(basix.geometry(cell_type), dtype=np.float64)
    ξ = np.tile(vertices.mean(axis=0), (len(X), 1))
    step = np.full_like(ξ, np.inf)
    for _ in range(STEPS if len(X) else 0):
        φ, *gradients = np.asarray(scalar.tabulate(1, ξ))  # (n, nodes), and so for each direction
        x = np.einsum("na,nad->nd", φ, nodes)
        jacobian = np.einsum("jna,nad->ndj", np.array(gradients), nodes)  # ∂x/∂ξ
        step = np.einsum("njd,nd->nj", np.linalg.pinv(jacobian), X - x)
        ξ = np.clip(ξ + step, -1.0, 2.0)  # far outside, the map of a curved cell may be singular
        if np.abs(step).max() <= OUTSIDE:
            break
    normals = np.asarray(basix.cell.facet_outward_normals(cell_type), dtype=np.float64)
    corners = np.array([vertices[facet[0]] for facet in basix.topology(cell_type)[-2]])
    heights = np.einsum("nfj,fj->nf", ξ[:, None, :] - corners, normals)
    is_inside = (heights <= OUTSIDE).all(axis=1) & (np.abs(step) <= OUTSIDE).all(axis=1)
    return ξ, is_inside


def _values(expression: Expr, mesh: dolfinx.mesh.Mesh, cells: Integers, ξ: Array) -> Array:
    """Return the values in cells, (n,), at a reference point in each, (n, tdim) → (n, size)."""
    size = int(np.prod(expression.ufl_shape, dtype=np.int64))
    values = np.zeros((len(cells), size))
    for first in range(0, len(cells), CHUNK):
        part = slice(first, first + CHUNK)
        at = ξ[part]
        compiled = Compiler(MPI.COMM_SELF).expression(expression, at)
        all_values = compiled.eval(mesh, cells[part].astype(np.int32))
        by_point = np.asarray(all_values).reshape(len(at), len(at), size)  # (cells, points, size)
        values[part] = by_point[np.arange(len(at)), np.arange(len(at))]
    return values
