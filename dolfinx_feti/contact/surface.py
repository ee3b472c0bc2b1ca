# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The quadrature points of a surface, and the values of expressions there.

The values of an expression e at the points q follow from two linear forms, which dolfinx assembles
on any cells, flat or curved, and for any list of facets:

.. math:: e_q = \frac{\int e\, φ_q \,\mathrm{d}A}{\int φ_q \,\mathrm{d}A}

with basis functions φ_q that are one at one point (:mod:`~dolfinx_feti.contact.points`).
"""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI

import numpy as np

import dolfinx
import ufl
from ufl.core.expr import Expr

from dolfinx_feti.contact.points import FacetQuadratureElement
from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.runtime.arrays import Array, Indices

__all__ = ["ContactSurface", "PointExpression"]


@dataclass(frozen=True, slots=True)
class PointExpression:
    """A scalar expression e, compiled at the points of a surface.

    Attributes:
        form: ∫ e φ_q dA, a linear form.
        dofs: Dof q of each point, (points,).
        areas: ∫ φ_q dA of each point, (points,).
    """

    form: dolfinx.fem.Form
    dofs: Indices
    areas: Array

    def evaluate(self) -> Array:
        """Return the values in the current state, (points,). Collective."""
        return np.asarray(_assemble(self.form)[self.dofs] / self.areas)


class ContactSurface:
    """The quadrature points of a surface.

    The points are those in owned cells, sorted by their cells and facets.

    Attributes:
        mesh: The mesh of the body.
        ds: The measure.
        element: The element with a dof for each point of each facet of a cell.
        dofs: Dofs at the points in the space of that element, (points,).
        cells: Cell of each point, (points,).
        dofs_in_cell: Dof of each point among those of its cell, (points,).
        facets: The facets of the surface, (facets, 2): a cell and the number of the facet in it.
        facet_of_point: Row of ``facets`` for each point, (points,).
        cell_sizes: Size h of the cell at each point, (points,).
        min_cell_size: The smallest of them, over all processes.
        weighted_areas: ∫ weight φ_q dA of each point, (points,).
    """

    def __init__(
        self,
        point_space: dolfinx.fem.FunctionSpace,
        ds: ufl.Measure,
        weight: Expr | float,
        compiler: Compiler,
    ) -> None:
        """Find the points, and integrate their areas. Collective.

        Args:
            point_space: The space of values at the quadrature points of all facets of all cells.
            ds: The measure, with the quadrature degree of that space.
            weight: Factor of an area, such as 2 π r.
            compiler: Compiler of forms.

        Raises:
            ValueError: The measure has no facets, or the weight is not positive.
        """
        self.mesh: dolfinx.mesh.Mesh = point_space.mesh
        self.ds = ds
        self._test = ufl.TestFunction(point_space)
        self._compiler = compiler
        element = point_space.ufl_element()
        assert isinstance(element, FacetQuadratureElement)
        self.element = element
        area = _assemble(compiler.form(self._test * ds))  # zero on all facets of other surfaces
        topology = self.mesh.topology
        dofs_of_cells = point_space.dofmap.list[: topology.index_map(topology.dim).size_local]
        cells, columns = np.nonzero(area[dofs_of_cells])
        self.cells: Indices = cells.astype(np.int32)
        self.dofs_in_cell: Indices = columns.astype(np.int32)
        self.dofs: Indices = dofs_of_cells[cells, columns]
        self._areas: Array = area[self.dofs]
        if self.mesh.comm.allreduce(len(self.dofs)) == 0:
            raise ValueError(
                "The measure of a contact has no facets: give the measure its tags and a tag among "
                "them, as ds(lumen)."
            )
        ends = np.cumsum([len(rule) for rule in element.rules])
        number_in_cell = np.searchsorted(ends, columns, side="right").astype(np.int32)
        facets, facet_of_point = np.unique(
            np.column_stack([self.cells, number_in_cell]), axis=0, return_inverse=True
        )
        self.facets: Indices = facets
        self.facet_of_point: Indices = facet_of_point.ravel().astype(np.int32)
        self.weighted_areas: Array = self._areas * self.compile(ufl.as_ufl(weight)).evaluate()
        least = -self.maximum(-self.weighted_areas)
        if not least > 0.0:
            raise ValueError(
                "The weight of a contact is not positive on its surface: give what the measure is "
                "multiplied by, such as 2 π r."
            )
        unique_cells, inverse = np.unique(self.cells, return_inverse=True)
        self.cell_sizes: Array = self.mesh.h(topology.dim, unique_cells)[inverse]
        self.min_cell_size = -self.maximum(-self.cell_sizes)

    def compile(self, expression: Expr) -> PointExpression:
        """Compile a scalar expression at the points. Collective."""
        form = self._compiler.form(expression * self._test * self.ds)
        return PointExpression(form, self.dofs, self._areas)

    def coordinates(self) -> Array:
        """Return the points in the reference configuration, (points, d). Collective."""
        X = ufl.SpatialCoordinate(self.mesh)
        d = self.mesh.geometry.dim
        return np.column_stack([self.compile(X[i]).evaluate() for i in range(d)])

    def maximum(self, values: Array) -> float:
        """Return the largest of values at the points, over all processes. Collective."""
        return self.mesh.comm.allreduce(float(values.max(initial=-np.inf)), op=MPI.MAX)

    def facet_areas(self) -> Array:
        """Return the weighted area of each facet, (facets,)."""
        count = len(self.facets)
        areas = np.bincount(self.facet_of_point, self.weighted_areas, minlength=count)
        return areas.astype(np.float64)


def _assemble(form: dolfinx.fem.Form) -> Array:
    """Assemble a linear form of the point space, (local dofs,).

    Facets and dofs belong to cells, and dolfinx integrates over owned cells: each entry is complete
    without communication.
    """
    return np.asarray(dolfinx.fem.assemble_vector(form).array)
