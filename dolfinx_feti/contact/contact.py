# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Frictionless contact of a surface with a rigid tool, by an augmented Lagrangian.

With the signed distance g of the tool, a multiplier λ ≥ 0 and a penalty ε in the quadrature points,

.. math:: Π_c(u) = \int \frac{1}{2 ε} \left(⟨λ - ε\, g(X + u)⟩_+^2 - λ^2\right) \mathrm{d}A,
          \qquad λ ← ⟨λ - ε\, g⟩_+

after each equilibrium; it converges to λ ≥ 0, g ≥ 0 and λ g = 0. The residual is the derivative of
Π_c, a traction p = ⟨λ − ε g⟩₊ along ∇g. The tangent is that of the residual where p > 0, the
symmetric :math:`ε\, ∇g ⊗ ∇g - p\, ∇^2 g`, with two exceptions near p = 0 and at deep penetrations
(``Contact.tangent``). UFL differentiates g; these forms are written out with its derivatives.
Source: P. Alart, A. Curnier, Comput. Methods Appl. Mech. Engrg. 92 (1991).
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np

import dolfinx
import ufl
from ufl.core.expr import Expr

from dolfinx_feti.contact.crossing import CrossingDetection
from dolfinx_feti.contact.evaluation import ContactEvaluation
from dolfinx_feti.contact.points import create_point_space
from dolfinx_feti.contact.surface import ContactSurface
from dolfinx_feti.contact.tools import Tool
from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.runtime.arrays import Array, Indices
from dolfinx_feti.runtime.values import require_positive

__all__ = ["Contact"]

#: ε over the stiffness of the body at the surface, per area. At half of it, updates converge half
#: as fast; at twice, the condition number of the assembled tangent doubles.
PENALTY = 10.0

#: Quantile of the stiffness over the facets that determines ε. One ε for the whole surface
#: reproduces a uniform pressure exactly. The quantile ignores a few slivers; in a graded mesh most
#: facets are small and where the contact is. At 0.45 updates are slow in the stiffer half of a body
#: of two materials; at 1 a single sliver determines ε.
QUANTILE = 0.9

#: Gap over the size of a cell up to which a point is in contact in the tangent: well above the
#: rounding of a position, and below any tolerance. At 1e-6 Newton's method takes twice the steps
#: where the tolerance of penetrations is 1e-6.
CLOSED_GAP = 1e-9

#: Penetration over the size of a cell up to which the pressure contributes −p ∇²g, the part due to
#: the curvature of the tool, to the tangent: ten times the tolerance of penetrations. Without a
#: bound Newton's method starts with shifts if a tool moves by a tenth of a cell; at 1e-3 its last
#: steps converge linearly.
MAX_BENDING_DEPTH = 1e-2

#: Step of the second differences of g that measure its rounding, over the size of the smallest
#: cell. The curvature of a tool as small as a cell adds the square of it, 1e-14, which is below the
#: rounding of a body of a hundred cells. At 1e-9 the step itself is rounded.
ROUNDING_STEP = 1e-7

#: A multiplier, in the unit of λ, with which no point is in contact: λ − ε g is negative at any
#: penetration. The energy Π_c is meaningless with it.
RELEASED_MULTIPLIER = -1e100


@dataclass(frozen=True, slots=True)
class _Prepared:
    """The parts of a contact that :meth:`Contact.prepare` creates.

    Attributes:
        values: Values at the points of the surface.
        crossing: Detection of points that have crossed the tool.
        pressure: The contact pressure, on a mesh of the surface only.
        point_of_dof: Number of the point of each dof of the pressure, (owned cells, points).
    """

    values: ContactEvaluation
    crossing: CrossingDetection
    pressure: dolfinx.fem.Function
    point_of_dof: Indices


class Contact:
    """A surface of a body that a rigid tool must not enter.

    A new contact has its forms only. Its values and results exist from :meth:`prepare` on, which
    NonlinearProblem calls.

    Example::

        from dolfinx_feti.contact import cylinder

        radius = dolfinx.fem.Constant(mesh, 0.72)  # the lumen's is 0.71
        contact = Contact(u, ds(lumen), cylinder(axis=(0, 0, 1), radius=radius))
        problem = NonlinearProblem(energy, u, bcs=bcs, contacts=[contact])
        problem.solve()
        print(contact.force(), contact.penetration())

    Attributes:
        u: The displacement.
        energy: Π_c, a form of rank zero; :class:`~dolfinx_feti.NonlinearProblem` adds it.
        multiplier: λ, at the quadrature points of all facets; part of the state of a path.
        penalty: ε, stress per length, one value for all cells; part of the state of a path.
        name: Name of ``pressure``.
    """

    def __init__(
        self,
        u: dolfinx.fem.Function,
        ds: ufl.Measure,
        tool: Tool,
        *,
        weight: float | Expr = 1.0,
        name: str = "contact_pressure",
    ) -> None:
        """Create the contact. Collective.

        Args:
            u: The displacement, in a space of shape (d,) on a mesh of dimension d = 2 or 3.
            ds: Measure of the surface in the reference configuration, as ds(lumen), with the
                quadrature degree of the contact; if it has none, twice the degree of u.
            tool: Signed distance of the current position, ``x ↦ g`` in UFL: positive outside of
                the tool, with ‖∇g‖ = 1, such as ``cylinder(…)``.
            weight: Factor of an area, such as 2 π r in axisymmetric forms.
            name: Name of the Function ``pressure``.

        Raises:
            ValueError: u is no displacement, ``ds`` is no measure of a surface, the distance is no
                scalar that depends on the position, or the cells have facets of two types.
            TypeError: u is no Function, or the tool no function.
        """
        if not isinstance(u, dolfinx.fem.Function):
            raise TypeError(f"u is {u!r}: give the Function of the displacement.")
        V = u.function_space
        mesh = V.mesh
        d = mesh.geometry.dim
        if u.ufl_shape != (d,) or d not in (2, 3) or mesh.topology.dim != d:
            raise ValueError(
                f"u has the shape {u.ufl_shape}: give a displacement in two or three dimensions, "
                f"of shape ({d},) on this mesh."
            )
        if not isinstance(ds, ufl.Measure) or ds.integral_type() != "exterior_facet":
            raise ValueError(f"ds is {ds}: give the measure of a surface, as ds(lumen).")
        if not callable(tool):
            raise TypeError(
                f"tool is {tool!r}: give a function of the position, such as sphere(radius=1.0)."
            )
        require_positive(weight=weight)
        if ds.ufl_domain() is None:
            ds = ds(domain=mesh)
        degree = int(ds.metadata().get("quadrature_degree", -1))
        if degree < 0:
            degree = 2 * V.ufl_element().embedded_superdegree
        self.u = u
        self._ds = ds(metadata={**ds.metadata(), "quadrature_degree": degree})
        self._tool = tool
        self._weight = weight
        self.name = name
        self.multiplier = dolfinx.fem.Function(
            create_point_space(mesh, degree), name=f"{name}_multiplier"
        )
        self.penalty = dolfinx.fem.Function(
            dolfinx.fem.functionspace(mesh, ("DG", 0)), name=f"{name}_penalty"
        )
        self._gap = self._distance()
        λ = self.multiplier
        ε = self.penalty
        g = self._gap
        touching = -λ * g + ε / 2 * g**2  # ((λ − ε g)² − λ²)/(2 ε)
        density = ufl.conditional(ufl.gt(λ - ε * g, 0.0), touching, -(λ**2) / (2 * ε))
        self.energy = weight * density * self._ds
        self._cell_sizes = dolfinx.fem.Function(
            self.penalty.function_space, name=f"{name}_cell_sizes"
        )
        cells = np.arange(len(self.penalty.function_space.dofmap.list), dtype=np.int32)
        dofs = self.penalty.function_space.dofmap.list[cells, 0]
        self._cell_sizes.x.array[dofs] = mesh.h(mesh.topology.dim, cells)
        self._prepared: _Prepared | None = None

    @property
    def virtual_work(self) -> ufl.Form:
        """δΠ_c = −∫ p δg dA, tested with v."""
        trial = self.multiplier - self.penalty * self._gap
        density = ufl.conditional(ufl.gt(trial, 0.0), -trial * self._virtual_gap(), 0.0)
        return self._weight * density * self._ds

    @property
    def tangent(self) -> ufl.Form:
        """The derivative of δΠ_c, ∫ ε δg Δg − p Δδg dA, with two exceptions.

        Points with a gap up to ``CLOSED_GAP`` count as touching, so that the tangent at the kink is
        that of the stiffer side. With the softer side, a step ends where the point touches, and so
        does the next step. In −p Δδg, p is bounded by ``MAX_BENDING_DEPTH``: no equilibrium has a
        deeper penetration.
        """
        λ = self.multiplier
        ε = self.penalty
        g = self._gap
        h = self._cell_sizes
        trial = λ - ε * g
        δg = self._virtual_gap()
        du = ufl.TrialFunction(self.u.function_space)
        dg = ufl.derivative(g, self.u, du)  # Δg
        d_δg = ufl.derivative(δg, self.u, du)  # Δδg
        p = ufl.max_value(ufl.min_value(trial, λ + ε * MAX_BENDING_DEPTH * h), 0.0)
        stiffness = ε * dg * δg - p * d_δg
        density = ufl.conditional(ufl.gt(trial + ε * CLOSED_GAP * h, 0.0), stiffness, 0.0)
        return self._weight * density * self._ds

    def _virtual_gap(self) -> Expr:
        """Return δg, the derivative of g in u in the direction of the test function."""
        return ufl.derivative(self._gap, self.u, ufl.TestFunction(self.u.function_space))

    def _distance(self) -> Any:
        """Return g(X + u)."""
        x = ufl.SpatialCoordinate(self.u.function_space.mesh) + self.u
        g = ufl.as_ufl(self._tool(x))
        if g.ufl_shape != () or g.ufl_free_indices:
            raise ValueError(f"The tool's distance has the shape {g.ufl_shape}: give a scalar.")
        if self.u not in ufl.algorithms.extract_coefficients(g):
            raise ValueError(
                "The tool's distance does not depend on the position x that it is called with: "
                "write it in x, as lambda x: x[2] - height."
            )
        return g

    # -- called by a problem ----------------------------------------------------------------------

    def prepare(self, compiler: Compiler) -> None:
        """Compile the evaluation of gap, pressure and force. Collective.

        Raises:
            ValueError: The measure has no facets, or the weight is not positive.
        """
        surface = ContactSurface(
            self.u.function_space, self.multiplier.function_space, self._ds, compiler, self._weight
        )
        values = ContactEvaluation(
            surface, self._gap, self.u, self.multiplier, self.penalty, self.virtual_work
        )
        pressure, point_of_dof = surface.create_submesh()
        pressure.name = self.name
        crossing = CrossingDetection(self.u, self._gap, values)
        self._prepared = _Prepared(values, crossing, pressure, point_of_dof)

    def has_penalty(self) -> bool:
        """Return True if ε has been set. Collective."""
        return bool(self._comm.allreduce(bool(self.penalty.x.array.any()), op=MPI.LOR))

    def set_penalty(self, diagonal: Array) -> None:
        """Compute ε from the stiffness at the surface; a larger ε is not changed. Collective.

        Args:
            diagonal: Diagonal of the assembled tangent without contact, (owned,) in u.
        """
        stiffness = self._values.surface.stiffness_per_area(diagonal, QUANTILE)
        ε = self.penalty.x.array
        np.maximum(ε, PENALTY * stiffness, out=ε)

    def grow_penalty(self, factor: float) -> None:
        """Multiply ε by a factor. Not collective."""
        self.penalty.x.array[:] *= factor

    @contextmanager
    def without_tool(self) -> Iterator[None]:
        """Context in which no point is in contact; assemble no energy in it. Not collective."""
        before = self.multiplier.x.array.copy()
        self.multiplier.x.array[:] = RELEASED_MULTIPLIER
        try:
            yield
        finally:
            self.multiplier.x.array[:] = before

    def force_rounding(self) -> float:
        """Return the norm of the rounding errors of the contact's forces on nodes. Collective.

        g may be a small difference of large lengths such as a radius. Its rounding error is
        measured by second differences over a step so short that curvature does not contribute. u
        is moved during the call, and restored before it returns.
        """
        values = self._values
        u = self.u.x.array
        step = ROUNDING_STEP * values.surface.min_cell_size
        before = u.copy()
        gaps = []
        try:
            for shift in (0.0, step, -step):
                u[:] = before + shift
                gaps.append(values.gap())
        finally:
            u[:] = before
        difference = gaps[1] - 2.0 * gaps[0] + gaps[2]
        squares = np.array([difference @ difference, len(difference)])
        total, count = self._comm.allreduce(squares)
        error = np.sqrt(total / count / 6.0)  # the variance is that of 1 + 4 + 1 errors
        is_touching = values.pressure() > 0.0
        forces = values.surface.nodal_forces(is_touching * values.penalty() * error)
        return float(np.sqrt(self._comm.allreduce(float(forces @ forces))))

    def violation(self) -> float:
        """Return the largest abs(⟨λ − ε g⟩₊ − λ)/(ε h), with the size h of a cell. Collective.

        This is abs(g)/h for a point in contact, and λ/(ε h) for a point without contact whose
        multiplier still pushes.
        """
        values = self._values
        violation = np.abs(values.pressure() - values.multiplier()) / values.penalty()
        return max(values.surface.maximum(violation / values.surface.cell_sizes), 0.0)

    def force_change(self) -> float:
        """Return the relative change of the forces on nodes by the next update. Collective.

        It is the norm of the nodes' forces of p − λ over that of p.
        """
        values = self._values
        p = values.pressure()
        forces = values.surface.nodal_forces(p)
        changes = values.surface.nodal_forces(p - values.multiplier())
        change, size = self._comm.allreduce(np.array([changes @ changes, forces @ forces]))
        return float(np.sqrt(change / size)) if size > 0.0 else 0.0

    def update_multiplier(self) -> None:
        """Set λ to ⟨λ − ε g⟩₊. Collective."""
        values = self._values
        λ = self.multiplier.x
        λ.array[values.surface.dofs] = values.pressure()
        λ.scatter_forward()

    def fit_multiplier(self) -> None:
        """Replace λ by its fit by traces of u, and negative values by zero. Collective.

        The fit leaves the forces on nodes as they are. The part of λ without forces would grow from
        step to step as a contact spreads; negative values come from extrapolation.
        """
        surface = self._values.surface
        λ = self.multiplier.x
        λ.array[surface.dofs] = surface.fit(self._values.multiplier())
        λ.scatter_forward()

    def update_pressure(self) -> None:
        """Set ``pressure`` to the fit of the current p by traces of u. Collective."""
        self._set_values(self.pressure, self._values.surface.fit(self._values.pressure()))

    def store_state(self) -> None:
        """Store the state of body and tool for :meth:`has_crossed_tool`. Collective."""
        self._of_problem.crossing.store_state()

    def has_crossed_tool(self, tolerance: float) -> bool:
        """Return True if a point has crossed the tool since the stored state. Collective.

        Args:
            tolerance: Depth in the tool above which a point is inside of it, over the size of a
                cell.
        """
        return self._of_problem.crossing.has_crossed(tolerance)

    # -- called by a user -------------------------------------------------------------------------

    @property
    def pressure(self) -> dolfinx.fem.Function:
        """The contact pressure p after each solve, the traction per reference area.

        It has values at the quadrature points of a mesh of the surface only, and can be written and
        drawn like any other Function.

        Raises:
            RuntimeError: No problem has the contact yet.
        """
        return self._of_problem.pressure

    def force(self) -> Array:
        """Return the resultant force of the contact on the body, (d,). Collective.

        Raises:
            RuntimeError: No problem has the contact yet.
        """
        return self._values.force()

    def penetration(self) -> float:
        """Return the largest −g of the surface, negative if nothing touches. Collective.

        Raises:
            RuntimeError: No problem has the contact yet.
        """
        return self._values.surface.maximum(-self._values.gap())

    def true_pressure(self) -> dolfinx.fem.Function:
        """Return p per deformed area, p dA/da, as a Function like ``pressure``. Collective.

        In two dimensions the stretch out of the plane is taken as one.

        Raises:
            RuntimeError: No problem has the contact yet.
        """
        values = self._values
        true_pressure = dolfinx.fem.Function(self.pressure.function_space, name=f"{self.name}_true")
        p = values.surface.fit(values.pressure())
        self._set_values(true_pressure, p / values.area_stretch())
        return true_pressure

    # -- helpers ----------------------------------------------------------------------------------

    @property
    def _of_problem(self) -> _Prepared:
        """The parts that :meth:`prepare` has created.

        Raises:
            RuntimeError: No problem has the contact yet.
        """
        if self._prepared is None:
            raise RuntimeError(
                "The contact belongs to no problem yet: pass contacts=[contact] to "
                "NonlinearProblem first."
            )
        return self._prepared

    @property
    def _values(self) -> ContactEvaluation:
        """Values at the points of the surface; a RuntimeError without a problem."""
        return self._of_problem.values

    @property
    def _comm(self) -> MPI.Comm:
        """The processes of the mesh."""
        return self.u.function_space.mesh.comm

    def _set_values(self, f: dolfinx.fem.Function, values: Array) -> None:
        """Set a function like ``pressure`` to values at the points, (points,). Collective."""
        point_of_dof = self._of_problem.point_of_dof
        dofs = f.function_space.dofmap.list[: len(point_of_dof)]
        f.x.array[dofs] = values[point_of_dof]
        f.x.scatter_forward()
