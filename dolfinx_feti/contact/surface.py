# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Values at the quadrature points of a surface, and the body's stiffness there per area.

The values of an expression e at the points q follow from two linear forms, which dolfinx assembles
on any cells, flat or curved, and for any list of facets:

.. math:: e_q = \frac{\int e\, φ_q \,\mathrm{d}A}{\int φ_q \,\mathrm{d}A}

with basis functions φ_q that are one at one point (:mod:`~dolfinx_feti.contact.points`).

The stiffness of a facet f per area, with the diagonal k of the tangent, the N nodes i of the facet,
and the m_i facets of the surface that share one, is

.. math:: s_f = \frac{1}{A_f} \sum_{i ∈ f} \frac{k_i}{m_i},

so springs of stiffness s_f per area double the diagonal on average.

There are more points than nodes, so part of a pressure p has no force on any node. It is removed by
a fit of p by the traces φ_i of the basis functions of u, over the points A where p > 0:

.. math:: \min_w \sum_{q ∈ A} A_q \Bigl(p_q - \sum_i w_i\, φ_i(ξ_q)\Bigr)^2,

with the weighted area A_q of a point, solved by conjugate gradients with Jacobi's preconditioner.
The forces of p on the nodes do not change.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

from mpi4py import MPI

import numpy as np
import scipy.sparse

import basix
import basix.ufl
import dolfinx
import ufl
from ufl.core.expr import Expr

from dolfinx_feti.contact.points import FacetQuadratureElement
from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.runtime import compat
from dolfinx_feti.runtime.arrays import Array, Indices

__all__ = ["ContactSurface"]

#: Relative residual of the fit's normal equations: below the tolerances of Newton's method. Each
#: further digit takes about four products with a small matrix.
FIT_RTOL = 1e-10

#: Value of a basis function below which it is zero on a facet: those of nodes inside the cell are
#: rounding errors there, all others are above 1e-3 at a point.
TRACE_ATOL = 1e-12

#: Iterations of the fit, at most. Mass matrices take some thirty. Points at the rim of a contact
#: where the basis functions are small can take more; the remaining error is at these points.
MAX_FIT_ITERATIONS = 100


class ContactSurface:
    """The quadrature points of a surface, with values and integrals there.

    Attributes:
        dofs: Dofs at the points in the space of values at the quadrature points of all facets, for
            points in owned cells, (points,).
        cell_sizes: Size h of the cell at each point, (points,).
        min_cell_size: The smallest of them, over all processes.
        weighted_areas: Integral of the weight over the basis function of each point, (points,).
    """

    def __init__(
        self,
        V: dolfinx.fem.FunctionSpace,
        point_space: dolfinx.fem.FunctionSpace,
        ds: ufl.Measure,
        compiler: Compiler,
        weight: Expr | float,
    ) -> None:
        """Find the points, and integrate their areas dA = weight ds. Collective.

        Args:
            V: The space of the displacement.
            point_space: The space of values at the quadrature points of all facets of all cells.
            ds: The measure, with the quadrature degree of that space.
            compiler: Compiler of forms.
            weight: Factor of an area, such as 2 π r.

        Raises:
            ValueError: The measure has no facets, or the weight is not positive.
        """
        self._V = V
        self._mesh = V.mesh
        self._ds = ds
        self._test = ufl.TestFunction(point_space)
        self._compiler = compiler
        element = point_space.ufl_element()
        assert isinstance(element, FacetQuadratureElement)
        self._element = element
        area = self._assemble(compiler.form(self._test * ds))
        topology = self._mesh.topology
        dofs_of_cells = point_space.dofmap.list[: topology.index_map(topology.dim).size_local]
        cells, columns = np.nonzero(area[dofs_of_cells])
        ends = np.cumsum([len(rule) for rule in element.rules])
        self._cell: Indices = cells.astype(np.int32)
        self._facet: Indices = np.searchsorted(ends, columns, side="right").astype(np.int32)
        self._point_in_cell: Indices = columns.astype(np.int32)
        self.dofs: Indices = dofs_of_cells[cells, columns]
        self._area: Array = area[self.dofs]
        count = self._mesh.comm.allreduce(len(self.dofs))
        if count == 0:
            raise ValueError(
                "The measure of a contact has no facets: give the measure its tags and a tag among "
                "them, as ds(lumen)."
            )
        self.weighted_areas: Array = self._area * self.evaluator(ufl.as_ufl(weight))()
        least = -self.maximum(-self.weighted_areas)
        if not least > 0.0:
            raise ValueError(
                "The weight of a contact is not positive on its surface: give what the measure is "
                "multiplied by, such as 2 π r."
            )
        unique_cells, inverse = np.unique(self._cell, return_inverse=True)
        self.cell_sizes: Array = self._mesh.h(topology.dim, unique_cells)[inverse]
        self.min_cell_size = -self.maximum(-self.cell_sizes)

    def evaluator(self, expression: Expr) -> Callable[[], Array]:
        """Return a function that evaluates a scalar at the points, (points,). Collective."""
        compiled = self._compiler.form(expression * self._test * self._ds)

        def values() -> Array:
            return self._assemble(compiled)[self.dofs] / self._area

        return values

    def integrator(self, form: ufl.Form) -> Callable[[], float]:
        """Return a function that integrates a form of rank zero over all processes. Collective."""
        compiled = self._compiler.form(form)

        def integral() -> float:
            value = float(dolfinx.fem.assemble_scalar(compiled))
            return float(self._mesh.comm.allreduce(value))

        return integral

    def maximum(self, values: Array) -> float:
        """Return the largest of values at the points, over all processes. Collective."""
        return self._mesh.comm.allreduce(float(values.max(initial=-np.inf)), op=MPI.MAX)

    def stiffness_per_area(self, diagonal: Array, quantile: float) -> float:
        """Return a quantile of the stiffness per area, s_f, over all facets. Collective.

        Args:
            diagonal: Diagonal of the assembled tangent, (owned,) in u.
            quantile: The quantile, from 0 (softest facet) to 1 (stiffest).
        """
        V = self._V
        bs = self._V.dofmap.index_map_bs
        scalar = dolfinx.fem.Function(V).x  # |k|, with ghosts
        owned = V.dofmap.index_map.size_local * bs
        scalar.array[:owned] = np.abs(diagonal)
        scalar.scatter_forward()
        k = scalar.array.reshape(-1, bs).mean(axis=1)  # of each node
        facets = self._facets()
        m = dolfinx.fem.Function(V).x  # facets of the surface that share a node
        for f, nodes in enumerate(self._nodes_of_facets()):
            table = V.dofmap.list[facets[facets[:, 1] == f, 0]][:, nodes]
            m.array[:] += np.repeat(np.bincount(table.ravel(), minlength=len(k)), bs)
        m.scatter_reverse(dolfinx.la.InsertMode.add)
        m.scatter_forward()
        shares = k / np.maximum(m.array[::bs], 1.0)
        areas = self._areas_of_facets(facets)
        stiffness = np.zeros(len(facets))
        for f, nodes in enumerate(self._nodes_of_facets()):
            is_f = facets[:, 1] == f  # the f-th facet of their cells
            sums = shares[V.dofmap.list[facets[is_f, 0]][:, nodes]].sum(axis=1)
            stiffness[is_f] = sums / areas[is_f]
        all_facets = np.sort(np.concatenate(self._mesh.comm.allgather(stiffness)))
        return float(all_facets[int(quantile * (len(all_facets) - 1))])

    def nodal_forces(self, values: Array) -> Array:
        """Return ∫ values φ_i dA of the nodes i of u, (owned nodes,). Collective.

        Args:
            values: Values at the points, (points,).
        """
        return self._to_nodes(self.weighted_areas * values)

    def fit(self, values: Array) -> Array:
        """Return the fit of positive values by traces of u, zero at other points. Collective.

        Args:
            values: Values at the points, (points,).
        """
        active_areas = np.where(values > 0.0, self.weighted_areas, 0.0)
        w = self._solve_normal_equations(active_areas, values)
        return np.where(values > 0.0, np.maximum(self._to_points(w), 0.0), 0.0)

    def _solve_normal_equations(self, areas: Array, values: Array) -> Array:
        """Return the w that minimises Σ A_q (p_q − (Φ w)_q)², by conjugate gradients. Collective.

        Args:
            areas: A_q, positive, or zero at points without part in the fit, (points,).
            values: p_q, (points,).

        Returns:
            w, (owned nodes,).
        """
        comm = self._mesh.comm
        diagonal = self._to_nodes(areas, squared=True)
        inverse = np.divide(1.0, diagonal, out=np.zeros(len(diagonal)), where=diagonal > 0.0)
        r = self._to_nodes(areas * values)
        w = np.zeros(len(r))
        z = inverse * r
        d = z.copy()
        rz = comm.allreduce(float(r @ z))
        first_rz = rz
        for _ in range(MAX_FIT_ITERATIONS):
            if not rz > FIT_RTOL**2 * first_rz:
                break
            Ad = self._to_nodes(areas * self._to_points(d))
            α = rz / comm.allreduce(float(d @ Ad))
            w += α * d
            r -= α * Ad
            z = inverse * r
            rz_before = rz
            rz = comm.allreduce(float(r @ z))
            d = z + rz / rz_before * d
        return w

    def _to_nodes(self, values: Array, *, squared: bool = False) -> Array:
        """Return Φᵀ times values at the points, (owned nodes,). Collective.

        Args:
            values: Values at the points, (points,).
            squared: Whether the entries of Φ are squared, for the diagonal of Φᵀ diag(values) Φ.
        """
        traces = self._traces.power(2) if squared else self._traces
        x = dolfinx.la.vector(self._V.dofmap.index_map, 1)
        x.array[:] = traces.T @ values
        x.scatter_reverse(dolfinx.la.InsertMode.add)
        return x.array[: self._V.dofmap.index_map.size_local].copy()

    def _to_points(self, w: Array) -> Array:
        """Return Φ w at the points, (points,), of values w at the nodes, (owned nodes,).

        Collective.
        """
        x = dolfinx.la.vector(self._V.dofmap.index_map, 1)
        x.array[: len(w)] = w
        x.scatter_forward()
        return np.asarray(self._traces @ x.array)

    def create_submesh(self) -> tuple[dolfinx.fem.Function, Indices]:
        """Create a function of the points on a mesh of the surface alone. Collective.

        Returns:
            The function, on a quadrature element of the facets, and the number of the point of each
            of its dofs, (owned cells of the mesh, points of a facet).
        """
        mesh = self._mesh
        tdim = self._mesh.topology.dim
        facets = self._facets()
        mesh.topology.create_connectivity(tdim, tdim - 1)
        links = mesh.topology.connectivity(tdim, tdim - 1)
        numbers = links.array[links.offsets[facets[:, 0]] + facets[:, 1]]
        order = np.argsort(numbers, kind="stable")
        submesh, parents = compat.create_submesh(mesh, tdim - 1, numbers[order])
        kind = getattr(basix.CellType, submesh.topology.cell_name())
        element = basix.ufl.quadrature_element(
            kind, degree=self._ds.metadata()["quadrature_degree"]
        )
        surface = dolfinx.fem.Function(dolfinx.fem.functionspace(submesh, element))
        n = len(self._element.rules[0])
        here = self._coordinates().reshape(len(facets), n, mesh.geometry.dim)[order]
        row = np.searchsorted(numbers[order], parents)
        there = _coordinates_of(surface)
        distances = np.linalg.norm(here[row][:, None, :, :] - there[:, :, None, :], axis=3)
        local = np.argmin(distances, axis=2)
        return surface, (order[row][:, None] * n + local).astype(np.int32)

    def _coordinates(self) -> Array:
        """Return the points in the reference configuration, (points, d)."""
        x = ufl.SpatialCoordinate(self._mesh)
        return np.column_stack([self.evaluator(x[i])() for i in range(self._mesh.geometry.dim)])

    @cached_property
    def _traces(self) -> scipy.sparse.csr_array:
        """Basis functions of the nodes of u at the points, Φ, (points, local nodes)."""
        V = self._V
        scalar, *_ = V.ufl_element().sub_elements
        table = np.concatenate([scalar.tabulate(0, rule)[0] for rule in self._element.rules])
        table[np.abs(table) < TRACE_ATOL] = 0.0
        index_map = V.dofmap.index_map
        values = table[self._point_in_cell]
        nodes = V.dofmap.list[self._cell]
        rows = np.repeat(np.arange(len(self.dofs)), nodes.shape[1])
        shape = (len(self.dofs), index_map.size_local + index_map.num_ghosts)
        return scipy.sparse.csr_array((values.ravel(), (rows, nodes.ravel())), shape=shape)

    def _assemble(self, form: dolfinx.fem.Form) -> Array:
        """Assemble a linear form of the point space, (local dofs,).

        Facets and dofs belong to cells, and dolfinx integrates over owned cells: each entry is
        complete without communication.
        """
        return np.asarray(dolfinx.fem.assemble_vector(form).array)

    # -- facets -----------------------------------------------------------------------------------

    def _facets(self) -> Indices:
        """Return the facets of the surface, (facets, 2): a cell and the local number in it."""
        return np.unique(np.column_stack([self._cell, self._facet]), axis=0)

    def _areas_of_facets(self, facets: Indices) -> Array:
        """Return the weighted area of each facet."""
        count = len(self._element.rules)
        numbers = facets[:, 0].astype(np.int64) * count + facets[:, 1]
        place = np.searchsorted(numbers, self._cell.astype(np.int64) * count + self._facet)
        return np.bincount(place, self.weighted_areas, minlength=len(facets)).astype(np.float64)

    def _nodes_of_facets(self) -> list[Indices]:
        """Return the local nodes of V on each facet of a cell, its edges and vertices included."""
        layout = self._V.dofmap.dof_layout
        tdim = self._mesh.topology.dim
        count = len(self._element.rules)
        return [np.asarray(layout.entity_closure_dofs(tdim - 1, f)) for f in range(count)]


def _coordinates_of(f: dolfinx.fem.Function) -> Array:
    """Return the points of a function at quadrature points, (cells, points, d)."""
    V = f.function_space
    mesh = V.mesh
    cells = np.arange(mesh.topology.index_map(mesh.topology.dim).size_local, dtype=np.int32)
    points = compat.interpolation_points(V)
    shape = (len(cells), len(points), mesh.geometry.dim)
    if not len(cells):
        return np.zeros(shape)
    nodes = mesh.geometry.x[compat.geometry_dofmap(mesh)[cells]]
    φ = mesh.ufl_domain().ufl_coordinate_element().sub_elements[0].tabulate(0, points)[0]
    return np.einsum("qn,cnd->cqd", φ, nodes)[:, :, : mesh.geometry.dim]
