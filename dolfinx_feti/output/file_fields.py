# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Copies of fields in a form that files can hold: functions, or values at points.

Values :math:`f_q` at quadrature points :math:`ξ_q` with weights :math:`w_q` are projected to a
basis :math:`φ_i` in each cell. The projection minimises
:math:`\sum_q w_q (\sum_i c_i φ_i(ξ_q) - f_q)^2`.
"""

from __future__ import annotations

import numpy as np

import dolfinx
import ufl
from ufl.core.expr import Expr

from dolfinx_feti.fem.quadrature import same_points
from dolfinx_feti.output.evaluation import CellEvaluator
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.compat import geometry_dofmap, interpolation_points

__all__ = ["FieldCopy", "QuadratureFields", "VertexFields", "projection_matrix"]


def projection_matrix(φ: Array, weights: Array) -> Array:
    """Return the map from values at quadrature points to the coefficients of a basis.

    Args:
        φ: Values of the basis at the points, (points, basis).
        weights: Weights of the points, (points,). If one is not positive, ones replace them all.

    Returns:
        Π, (basis, points).
    """
    w = np.sqrt(weights if np.all(weights > 0.0) else np.ones(len(weights)))
    return np.asarray(np.linalg.pinv(w[:, None] * φ) * w)  # (√W Φ)⁺ √W


class FieldCopy:
    """A copy of a user's field, in a space that the file can hold.

    Attributes:
        function: The copy, with the values at the last call of :meth:`update`.
    """

    def __init__(
        self,
        name: str,
        field: dolfinx.fem.Function | Expr,
        space: dolfinx.fem.FunctionSpace,
        rule: tuple[Array, Array] | None,
    ) -> None:
        """Create the function. Collective.

        Args:
            name: Name of the function.
            field: The field, interpolated, or projected if it has data at quadrature points.
            space: Space of the function, of a Lagrange element or a discontinuous one: its dofs are
                values at points.
            rule: Points and weights of the field's quadrature elements; None without any.
        """
        self.function = dolfinx.fem.Function(space, name=name)
        self._source: dolfinx.fem.Function | None = None
        self._evaluator: CellEvaluator | None = None
        self._projection: Array | None = None
        if rule is not None:
            points, weights = rule
            φ = space.element.basix_element.tabulate(0, points)[0, :, :, 0]
            self._projection = projection_matrix(φ, weights)
            self._evaluator = CellEvaluator(field, space.mesh, points)
        elif isinstance(field, dolfinx.fem.Function) and _is_mapped_by_identity(field):
            self._source = field
        else:
            self._evaluator = CellEvaluator(field, space.mesh, interpolation_points(space))

    def update(self) -> None:
        """Set the function to the current values of the field. Collective."""
        if self._source is not None:
            self.function.interpolate(self._source)
        if self._evaluator is not None:
            coefficients = self._evaluator.values()
            if self._projection is not None:
                coefficients = np.einsum("iq,cqk->cik", self._projection, coefficients)  # c = Π f
            dofmap = self.function.function_space.dofmap
            values = self.function.x.array.reshape(-1, dofmap.bs)
            values[dofmap.list[: len(coefficients)]] = coefficients
            self.function.x.scatter_forward()


class QuadratureFields:
    """Fields at the same quadrature points of all owned cells."""

    def __init__(self, mesh: dolfinx.mesh.Mesh, points: Array) -> None:
        """Create the collection, without any field. Collective.

        Args:
            mesh: The mesh.
            points: The points in the reference cell, (points, tdim).
        """
        self._mesh = mesh
        self._points = points
        self._position = CellEvaluator(ufl.SpatialCoordinate(mesh), mesh, points)
        self._evaluators: dict[str, CellEvaluator] = {}

    def add(self, name: str, field: Expr, points: Array) -> None:
        """Add a field. Collective.

        Args:
            name: Its name in the file.
            field: The field.
            points: Its quadrature points in the reference cell, (points, tdim).

        Raises:
            ValueError: The points differ from those of the earlier fields.
        """
        if not same_points(self._points, points):
            raise ValueError("its quadrature points differ from those of the earlier fields.")
        self._evaluators[name] = CellEvaluator(field, self._mesh, points)

    def coordinates(self) -> Array:
        """Return the points, (n, 3); on a mesh of the plane the third coordinate is zero."""
        gdim = self._mesh.geometry.dim
        x = self._position.values().reshape(-1, gdim)
        return np.pad(x, ((0, 0), (0, 3 - gdim)))

    def values(self) -> dict[str, Array]:
        """Return the current values of each field at the points, (n, k)."""
        values: dict[str, Array] = {}
        for name, evaluator in self._evaluators.items():
            in_cells = evaluator.values()
            values[name] = in_cells.reshape(-1, in_cells.shape[2])
        return values


class VertexFields:
    """Values of functions on a mesh of vertices, at the owned vertices."""

    def __init__(self, mesh: dolfinx.mesh.Mesh) -> None:
        """Create the collection, without any function."""
        self._mesh = mesh
        self._functions: dict[str, dolfinx.fem.Function] = {}

    def add(self, name: str, field: dolfinx.fem.Function | Expr) -> None:
        """Add a function.

        Raises:
            ValueError: The field is an expression.
        """
        if not isinstance(field, dolfinx.fem.Function):
            raise ValueError("it is an expression on a mesh of vertices; give a Function.")
        self._functions[name] = field

    def coordinates(self) -> Array:
        """Return the vertices, (n, 3)."""
        nodes = geometry_dofmap(self._mesh)[: self._n_vertices(), 0]
        return np.asarray(self._mesh.geometry.x[nodes], dtype=np.float64)

    def values(self) -> dict[str, Array]:
        """Return the current values of each function at the vertices, (n, k)."""
        values: dict[str, Array] = {}
        for name, function in self._functions.items():
            dofmap = function.function_space.dofmap
            dofs = dofmap.list[: self._n_vertices(), 0]
            values[name] = np.asarray(function.x.array.reshape(-1, dofmap.bs)[dofs])
        return values

    def _n_vertices(self) -> int:
        """Return the number of owned vertices."""
        return self._mesh.topology.index_map(0).size_local


def _is_mapped_by_identity(function: dolfinx.fem.Function) -> bool:
    """Return True if the element maps values from the reference cell unchanged."""
    return bool(function.function_space.ufl_element().pullback == ufl.identity_pullback)
