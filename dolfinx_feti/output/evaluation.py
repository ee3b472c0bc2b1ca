# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Values of fields and UFL expressions, such as a stress, at points and at centroids of cells.

A point X of the reference body lies in one cell, or on a facet, edge or vertex that several cells
share. Its value is the mean over these cells, so it does not depend on the numbering of the cells
or on the number of processes. In a cell, the expression is evaluated at the reference coordinates ξ
with x(ξ) = X, without any interpolation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import basix
import dolfinx
import ufl
from ufl.core.expr import Expr

from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.fem.quadrature import quadrature_rule
from dolfinx_feti.runtime import compat
from dolfinx_feti.runtime.arrays import Array, Integers, Mask
from dolfinx_feti.runtime.collective import on_all, total_of

__all__ = ["CellEvaluator", "cell_values", "evaluate", "mesh_of"]

#: Padding of the boxes around cells, over the extent of the mesh. Rounding errors of points are
#: 1e-16 of it. More padding adds a few candidate cells and changes no result.
PADDING = 1e-10

#: Distance in reference coordinates up to which a point outside of a cell counts as inside.
#: Newton's method for ξ has converged if its last step is not longer than this. Points that a user
#: computes have rounding errors of 1e-15. At 1e-7, cells next to a point would contribute to its
#: mean.
COORDINATE_ATOL = 1e-10

#: Largest number of Newton steps for reference coordinates. Affine cells take one, curved cells and
#: hexahedra four to six. A point for which the steps do not converge is outside of a distorted
#: cell.
MAX_STEPS = 25

#: Points in one compiled expression. It is evaluated at all of them in each of their cells, and
#: only the value at the cell's own point is used: 64² evaluations take less time than the
#: compilation of a second expression.
POINTS_PER_EXPRESSION = 64


def evaluate(expression: Expr, points: npt.ArrayLike) -> Array:
    """Return the values of a Function or UFL expression at points.

    Example::

        stress = kinematics.cauchy_stress(psi, F)
        print(evaluate(stress, mesh.geometry.x[0]))  # (3, 3)

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
        Collective. Each process compiles an expression for every 64 of its points, as points are
        constants of the generated code: 1000 points on one process take 16 compilations.
    """
    mesh = mesh_of(expression)
    X, is_single = on_all(lambda: _checked_points(points, mesh.geometry.dim), mesh.comm)
    located = on_all(lambda: _locate(mesh, X), mesh.comm)
    cells_of_point = np.bincount(located.point, minlength=len(X)).astype(np.float64)
    count = total_of(cells_of_point, mesh.comm)
    outside = X[count == 0.0]
    if len(outside):
        examples = ", ".join(str(x.tolist()) for x in outside[:3])
        raise ValueError(
            f"{len(outside)} of {len(X)} points are in no cell of the mesh, such as {examples}: "
            "give points of the reference body. On a curved surface, which straight cells cut off, "
            "move them inwards."
        )
    values_in_cells = on_all(lambda: _values(expression, mesh, located), mesh.comm)
    sums = np.zeros((len(X), values_in_cells.shape[1]))
    np.add.at(sums, located.point, values_in_cells)
    means = total_of(sums, mesh.comm) / count[:, None]
    values = means.reshape(len(X), *expression.ufl_shape)
    return values[0] if is_single else values


def mesh_of(expression: Expr) -> dolfinx.mesh.Mesh:
    """Return the mesh of an expression.

    Raises:
        ValueError: The expression has no mesh.
    """
    domain = ufl.domain.extract_unique_domain(expression)
    if domain is None:
        raise ValueError(
            f"The expression {expression} lives on no mesh: give an expression in a Function."
        )
    return dolfinx.mesh.Mesh(domain.ufl_cargo(), domain)


def _checked_points(points: npt.ArrayLike, gdim: int) -> tuple[Array, bool]:
    """Return points, (n, gdim), and whether the argument was a single point.

    Raises:
        ValueError: The shape is wrong, or a coordinate is not finite.
    """
    X = np.asarray(points, dtype=np.float64)
    if X.ndim not in (1, 2) or X.shape[-1] != gdim or not np.isfinite(X).all():
        raise ValueError(
            f"points has the shape {X.shape}: give finite coordinates, ({gdim},) or (n, {gdim})."
        )
    return X.reshape(-1, gdim), X.ndim == 1


@dataclass(frozen=True, slots=True)
class _Located:
    """Pairs of a point and an owned cell that contains it.

    Attributes:
        point: Number of the point, (pairs,).
        cell: The cell, (pairs,).
        ξ: Reference coordinates of the point in the cell, (pairs, tdim).
    """

    point: Integers
    cell: Integers
    ξ: Array


def _locate(mesh: dolfinx.mesh.Mesh, X: Array) -> _Located:
    """Find the owned cells that contain points, (n, gdim). Not collective."""
    tdim = mesh.topology.dim
    n_cells = mesh.topology.index_map(tdim).size_local
    padding = PADDING * float(np.ptp(mesh.geometry.x, axis=0).max()) if n_cells else 0.0
    tree = dolfinx.geometry.bb_tree(
        mesh, tdim, entities=np.arange(n_cells, dtype=np.int32), padding=padding
    )
    in_space = np.zeros((len(X), 3))
    in_space[:, : X.shape[1]] = X
    candidates = dolfinx.geometry.compute_collisions_points(tree, in_space)
    cell = np.asarray(candidates.array, dtype=np.int64)
    point = np.repeat(np.arange(len(X)), np.diff(candidates.offsets))
    if not len(cell):
        return _Located(point, cell, np.zeros((0, tdim)))
    ξ, is_inside = _reference_coordinates(mesh, cell, X[point])
    return _Located(point[is_inside], cell[is_inside], ξ[is_inside])


def _reference_coordinates(
    mesh: dolfinx.mesh.Mesh, cells: Integers, X: Array
) -> tuple[Array, Mask]:
    """Solve x(ξ) = X in a cell for each point by Newton's method.

    Args:
        mesh: The mesh.
        cells: A cell for each point, (n,), with n ≥ 1.
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
    for _ in range(MAX_STEPS):
        φ, *gradients = np.asarray(scalar.tabulate(1, ξ))  # φ and ∂φ/∂ξ_j, (n, nodes)
        x = np.einsum("na,nad->nd", φ, nodes)
        jacobian = np.einsum("jna,nad->ndj", np.array(gradients), nodes)  # ∂x/∂ξ
        step = np.einsum("njd,nd->nj", np.linalg.pinv(jacobian), X - x)
        ξ = np.clip(ξ + step, -1.0, 2.0)  # far outside, the map of a curved cell may be singular
        if np.abs(step).max() <= COORDINATE_ATOL:
            break
    normals = np.asarray(basix.cell.facet_outward_normals(cell_type), dtype=np.float64)
    corners = np.array([vertices[facet[0]] for facet in basix.topology(cell_type)[-2]])  # of facets
    # heights over the facets, positive outside of the cell
    heights = np.einsum("nfj,fj->nf", ξ[:, None, :] - corners, normals)
    is_inside = (heights <= COORDINATE_ATOL).all(axis=1) & (np.abs(step) <= COORDINATE_ATOL).all(
        axis=1
    )
    return ξ, is_inside


def _values(expression: Expr, mesh: dolfinx.mesh.Mesh, located: _Located) -> Array:
    """Return the values of an expression at points in cells, (pairs, size)."""
    size = int(np.prod(expression.ufl_shape, dtype=np.int64))
    values = np.zeros((len(located.cell), size))
    for first in range(0, len(values), POINTS_PER_EXPRESSION):
        chunk = slice(first, first + POINTS_PER_EXPRESSION)
        ξ = located.ξ[chunk]
        # not collective: the number of chunks differs between processes
        compiled = Compiler(MPI.COMM_SELF).expression(expression, ξ)
        at_all_points = compiled.eval(mesh, located.cell[chunk].astype(np.int32))
        table = np.asarray(at_all_points).reshape(len(ξ), len(ξ), size)  # (cells, points, size)
        pair = np.arange(len(ξ))
        values[chunk] = table[pair, pair]  # each cell at its own point
    return values


class CellEvaluator:
    """Evaluation of an expression at given reference points of each owned cell."""

    def __init__(self, expression: Expr, mesh: dolfinx.mesh.Mesh, points: Array) -> None:
        """Compile the expression. Collective.

        Args:
            expression: The Function or expression, or a number.
            mesh: The mesh.
            points: Points of the reference cell, (points, tdim).
        """
        on_mesh = dolfinx.fem.Constant(mesh, np.float64(1.0)) * expression  # a number has no mesh
        n_cells = mesh.topology.index_map(mesh.topology.dim).size_local
        self._compiled = Compiler(mesh.comm).expression(on_mesh, points)
        self._mesh = mesh
        self._cells = np.arange(n_cells, dtype=np.int32)
        self._n_points = len(points)
        self._size = int(np.prod(expression.ufl_shape))

    def values(self) -> Array:
        """Return the current values, (n_cells, points, components)."""
        shape = (len(self._cells), self._n_points, self._size)
        if not len(self._cells):
            return np.zeros(shape)
        return np.asarray(self._compiled.eval(self._mesh, self._cells)).reshape(shape)


def cell_values(expression: Expr, mesh: dolfinx.mesh.Mesh) -> Array:
    """Return an expression at the centroids of the owned cells, (n_cells, …). Collective.

    Data at quadrature points have no value at a centroid. For them, the weighted mean over the cell
    is returned.
    """
    rule = quadrature_rule(expression)
    if rule is None:
        cell = getattr(basix.CellType, mesh.topology.cell_name())
        centroid = np.asarray(basix.geometry(cell)).mean(axis=0, keepdims=True)
        rule = (centroid, np.ones(1))
    points, weights = rule
    values = CellEvaluator(expression, mesh, points).values()
    means = np.tensordot(values, weights / weights.sum(), axes=(1, 0))
    return np.asarray(means).reshape(len(values), *expression.ufl_shape)
