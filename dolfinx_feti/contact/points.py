# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Quadrature element on facets, with a dof at each quadrature point of each facet of a cell.

A Function in its space has one value for each facet and each point of its quadrature rule. In an
integral over facets,

.. math:: \int_{f} λ\, v \,\mathrm{d}A = \sum_q w_q\, λ_{f,q}\, v(ξ_{f,q}),

only these values occur: a basis function of facet f is one at one point, and zero at the others and
on all other facets. The element has no values inside a cell. It is a coefficient or test function
in facet integrals of its own degree, in dolfinx 0.9 to 0.11: FFCx tabulates it at the points of
each facet, and the element recognises the facet by these points. It derives from the private class
``basix.ufl._QuadratureElement``, which a later version may change.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

import basix
import basix.ufl
import dolfinx
import ufl

from dolfinx_feti.runtime.arrays import Array

__all__ = ["FacetQuadratureElement", "create_point_space", "facet_points"]

#: Tolerance for points of the reference cell to be equal: FFCx computes the same points by another
#: sum, with rounding errors of 1e-16; distinct points are much farther apart.
POINT_ATOL = 1e-12


def facet_points(cell: basix.CellType, degree: int) -> list[Array]:
    """Return the quadrature points of each facet in the reference cell, (points, dimension) each.

    Args:
        cell: The cell.
        degree: The degree of the rule, FFCx's default for facets.
    """
    corners = np.asarray(basix.geometry(cell))
    types = basix.cell.subentity_types(cell)[-2]
    points_of_facet = []
    for kind, nodes in zip(types, basix.topology(cell)[-2], strict=True):
        points = np.asarray(basix.make_quadrature(kind, degree)[0])
        dimension = points.shape[1]
        first = corners[nodes[0]]
        edges = corners[nodes[1 : 1 + dimension]] - first
        points_of_facet.append(np.asarray(first + points @ edges))
    return points_of_facet


class FacetQuadratureElement(basix.ufl._QuadratureElement):  # type: ignore[misc]
    """Values at the quadrature points of all facets of a cell, one facet after the other.

    Attributes:
        rules: The points of each facet in the reference cell, (points, dimension) each.
    """

    def __init__(self, cell: basix.CellType, degree: int) -> None:
        """Create the element.

        Args:
            cell: The cell.
            degree: The degree of the facets' quadrature.
        """
        self.rules = facet_points(cell, degree)
        points = np.vstack(self.rules)
        super().__init__(cell, points, np.ones(len(points)), ufl.identity_pullback, degree)
        self._repr = f"FacetQuadratureElement({cell.name}, {degree})"

    def tabulate(self, nderivs: int, points: npt.NDArray[np.float64]) -> Any:
        """Return the basis functions at the points of one facet, or of all, (1, points, dofs)."""
        if nderivs > 0:
            raise ValueError("A function of quadrature points has no derivatives.")
        if _are_equal(points, self._points):
            return np.eye(self.dim)[None]
        table = np.zeros((1, len(points), self.dim))
        start = 0
        for rule in self.rules:
            if _are_equal(points, rule):
                table[0, :, start : start + len(rule)] = np.eye(len(rule))
                return table
            start += len(rule)
        raise ValueError(
            "A value at the quadrature points of facets, such as a contact pressure, is in an "
            "integral of another degree or over cells: integrate it over the contact's own measure."
        )

    def __eq__(self, other: object) -> bool:
        """Return True if two elements are equal."""
        return isinstance(other, FacetQuadratureElement) and self._repr == other._repr

    def __hash__(self) -> int:
        """Return a hash."""
        return hash(self._repr)

    @property
    def polyset_type(self) -> basix.PolysetType:
        """The kind of the facets' quadrature rules."""
        return basix.PolysetType.standard

    @property
    def has_custom_quadrature(self) -> bool:
        """Return False: FFCx uses the facets' rule of the measure."""
        return False

    @property
    def embedded_superdegree(self) -> int:
        """Return 0, the element's contribution to estimated quadrature degrees."""
        return 0


def create_point_space(mesh: dolfinx.mesh.Mesh, degree: int) -> dolfinx.fem.FunctionSpace:
    """Create the space of values at the quadrature points of all facets. Collective.

    Args:
        mesh: The mesh.
        degree: The degree of the facets' quadrature.

    Raises:
        ValueError: The facets of a cell are of two types, as those of a prism.
    """
    cell_name = mesh.topology.cell_name()
    if cell_name in ("prism", "pyramid"):
        raise ValueError(
            f"The mesh has cells of type {cell_name}, with facets of two types: contact needs "
            "tetrahedra, hexahedra, triangles or quadrilaterals."
        )
    cell = getattr(basix.CellType, cell_name)
    return dolfinx.fem.functionspace(mesh, FacetQuadratureElement(cell, degree))


def _are_equal(points: npt.NDArray[np.float64], others: Array) -> bool:
    """Return True if two sets of points are the same, in the same order."""
    return points.shape == others.shape and np.allclose(points, others, rtol=0, atol=POINT_ATOL)
