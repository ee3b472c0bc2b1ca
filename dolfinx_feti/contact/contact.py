# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Contact of a surface with a rigid tool, as a user creates it and reads its results.

:class:`Contact` creates the forms of the law immediately. The parts that measure and update the
contact are compiled when a problem receives it.
"""

from __future__ import annotations

from dataclasses import dataclass

import dolfinx
import ufl
from ufl.core.expr import Expr

from dolfinx_feti.contact.crossing import CrossingDetection
from dolfinx_feti.contact.evaluation import ContactEvaluation
from dolfinx_feti.contact.law import ContactLaw
from dolfinx_feti.contact.rounding import force_rounding
from dolfinx_feti.contact.state import ContactState
from dolfinx_feti.contact.surface import ContactSurface
from dolfinx_feti.contact.surface_fields import SurfaceFields
from dolfinx_feti.contact.tools import Tool, gap_from
from dolfinx_feti.contact.traces import Traces
from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.values import require_positive

__all__ = ["Contact"]


@dataclass(frozen=True, slots=True)
class _CompiledContact:
    """The parts of a contact that :meth:`Contact.prepare` creates.

    Attributes:
        evaluation: Values at the points of the surface.
        traces: Basis functions of u there.
        state: λ and ε, and their updates.
        crossing: Detection of points that have crossed the tool.
        fields: Functions on a mesh of the surface only.
        pressure: The contact pressure, one of these functions.
    """

    evaluation: ContactEvaluation
    traces: Traces
    state: ContactState
    crossing: CrossingDetection
    fields: SurfaceFields
    pressure: dolfinx.fem.Function


class Contact:
    """A surface of a body that a rigid tool must not enter.

    A new contact has only its forms. Values and results are available after :meth:`prepare`, which
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
        law: The forms; :class:`~dolfinx_feti.NonlinearProblem` adds them to its own.
        energy: Π_c, a form of rank zero.
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
            weight: Factor of an area, such as 2 π r in axisymmetric forms; it must not change once
                a problem has the contact.
            name: Name of the Function ``pressure``.

        Raises:
            ValueError: u is no displacement, ``ds`` is no measure of a surface, the distance is no
                scalar that depends on the position, or the cells have facets of two types.
            TypeError: u is no Function, or the tool no function.
        """
        _check_displacement(u)
        measure = _with_degree(ds, u.function_space)
        gap = gap_from(tool, u)
        require_positive(weight=weight)
        self.u = u
        self.name = name
        self.law = ContactLaw(u, gap, measure, weight, name)
        self.energy = self.law.energy
        self.multiplier = self.law.multiplier
        self.penalty = self.law.penalty
        self._compiled: _CompiledContact | None = None

    # -- for a problem ----------------------------------------------------------------------------

    def prepare(self, compiler: Compiler) -> None:
        """Compile the parts that measure and update the contact. Collective.

        Raises:
            ValueError: The measure has no facets, or the weight is not positive.
        """
        law = self.law
        surface = ContactSurface(law.multiplier.function_space, law.ds, law.weight, compiler)
        evaluation = ContactEvaluation(surface, law)
        traces = Traces(self.u.function_space, surface)
        fields = SurfaceFields(surface)
        self._compiled = _CompiledContact(
            evaluation=evaluation,
            traces=traces,
            state=ContactState(evaluation, traces),
            crossing=CrossingDetection(evaluation),
            fields=fields,
            pressure=fields.create(self.name),
        )

    @property
    def state(self) -> ContactState:
        """λ and ε, and their updates; a RuntimeError without a problem."""
        return self._parts.state

    @property
    def crossing(self) -> CrossingDetection:
        """Detection of points that have crossed the tool; a RuntimeError without a problem."""
        return self._parts.crossing

    def force_rounding(self) -> float:
        """Return the norm of the rounding errors of the contact's forces on nodes. Collective."""
        return force_rounding(self._parts.evaluation, self._parts.traces)

    def update_pressure(self) -> None:
        """Set ``pressure`` to the fit of the current p by traces of u. Collective."""
        self._parts.fields.set_values(self.pressure, self._fitted_pressure())

    # -- for a user -------------------------------------------------------------------------------

    @property
    def pressure(self) -> dolfinx.fem.Function:
        """The contact pressure p after each solve, the traction per reference area.

        It has values at the quadrature points of a mesh of the surface only, and can be written and
        drawn like any other Function.

        Raises:
            RuntimeError: No problem has the contact yet.
        """
        return self._parts.pressure

    def force(self) -> Array:
        """Return the resultant force of the contact on the body, (d,). Collective.

        Raises:
            RuntimeError: No problem has the contact yet.
        """
        return self._parts.evaluation.force()

    def penetration(self) -> float:
        """Return the largest −g of the surface, negative if nothing touches. Collective.

        Raises:
            RuntimeError: No problem has the contact yet.
        """
        evaluation = self._parts.evaluation
        return evaluation.surface.maximum(-evaluation.gap())

    def true_pressure(self) -> dolfinx.fem.Function:
        """Return p per deformed area, p dA/da, as a Function like ``pressure``. Collective.

        In two dimensions the stretch out of the plane is taken as one.

        Raises:
            RuntimeError: No problem has the contact yet.
        """
        fields = self._parts.fields
        true_pressure = fields.create(f"{self.name}_true")
        stretch = self._parts.evaluation.area_stretch()
        fields.set_values(true_pressure, self._fitted_pressure() / stretch)
        return true_pressure

    # -- helpers ----------------------------------------------------------------------------------

    @property
    def _parts(self) -> _CompiledContact:
        """The parts that :meth:`prepare` has created.

        Raises:
            RuntimeError: No problem has the contact yet.
        """
        if self._compiled is None:
            raise RuntimeError(
                "The contact belongs to no problem yet: pass contacts=[contact] to "
                "NonlinearProblem first."
            )
        return self._compiled

    def _fitted_pressure(self) -> Array:
        """Return the fit of the current p by traces of u, (points,). Collective."""
        return self._parts.traces.fit(self._parts.evaluation.pressure())


def _check_displacement(u: dolfinx.fem.Function) -> None:
    """Check that u is a displacement on a mesh of two or three dimensions.

    Raises:
        TypeError: It is no Function.
        ValueError: It has another shape than (d,), or the mesh is a surface or a line.
    """
    if not isinstance(u, dolfinx.fem.Function):
        raise TypeError(f"u is {u!r}: give the Function of the displacement.")
    mesh = u.function_space.mesh
    d = mesh.geometry.dim
    if u.ufl_shape != (d,) or d not in (2, 3) or mesh.topology.dim != d:
        raise ValueError(
            f"u has the shape {u.ufl_shape}: give a displacement in two or three dimensions, "
            f"of shape ({d},) on this mesh."
        )


def _with_degree(ds: ufl.Measure, V: dolfinx.fem.FunctionSpace) -> ufl.Measure:
    """Return the measure of a surface with a mesh and a quadrature degree.

    Args:
        ds: The measure; its degree is kept if it has one.
        V: Space of the displacement; its mesh, and twice its degree, are the defaults.

    Raises:
        ValueError: It is no measure of a surface.
    """
    if not isinstance(ds, ufl.Measure) or ds.integral_type() != "exterior_facet":
        raise ValueError(f"ds is {ds}: give the measure of a surface, as ds(lumen).")
    if ds.ufl_domain() is None:
        ds = ds(domain=V.mesh)
    degree = int(ds.metadata().get("quadrature_degree", -1))
    if degree < 0:
        degree = 2 * V.ufl_element().embedded_superdegree
    return ds(metadata={**ds.metadata(), "quadrature_degree": degree})
