# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Cavities with a prescribed volume [mm³]; their pressure [kPa] is the unknown.

.. math:: V(u) = \bar V, \qquad r(u, p; v) = δΠ_{int} - p\, δV

The pressure is the multiplier of the volume (``mechanics.loads.enclosed_volume``), a follower
pressure. Its tangent is symmetric if the surface is closed, or if its rims are clamped or slide in
planes (:meth:`Cavity.check <dolfinx_feti.scalars.cavity.Cavity.check>`).
"""

from __future__ import annotations

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np

import dolfinx
import ufl

from dolfinx_feti.mechanics.loads import enclosed_volume, follower_pressure
from dolfinx_feti.mechanics.trial_displacements import FORCE_RTOL, free_norm, trial_displacement
from dolfinx_feti.runtime.arrays import Indices
from dolfinx_feti.runtime.values import require_finite, require_positive
from dolfinx_feti.scalars.equations import Coupling, ScalarEquation

__all__ = ["Cavity"]


class Cavity(Coupling):
    """The lumen inside a surface.

    Example::

        cavity = Cavity(u, ds(lumen), volume=1.0, axis=(0, 0, 1))
        cavity.volume.value = 1.05 * cavity.present_volume()
        problem = NonlinearProblem(energy, u, bcs=bcs, scalars=[cavity])
        problem.solve()
        print(cavity.pressure.value, cavity.present_volume())

    Attributes:
        u: The displacement.
        pressure: The unknown [kPa].
        volume: Prescribed volume [mm³]; its value may change between solves. None if the cavity has
            a Windkessel.
        form: V(u), a form of rank zero [mm³].
        area: Area of the surface at rest [mm²].
    """

    def __init__(
        self,
        u: dolfinx.fem.Function,
        ds: ufl.Measure,
        volume: float | None = None,
        *,
        axis: Sequence[float] | None = None,
        pressure: float = 0.0,
    ) -> None:
        """Create the cavity of a surface; N points out of the wall, into the lumen. Collective.

        Args:
            u: The displacement [mm].
            ds: Measure of the inner surface in the reference configuration.
            volume: The volume to be enclosed [mm³].
            axis: Direction of a tube's axis, normal to the planes of its open ends. If not given,
                the surface has to be closed, or its rims have to lie in planes of symmetry through
                the origin.
            pressure: Pressure at the start [kPa].

        Raises:
            ValueError: u is no displacement, the volume is not positive, the measure has no facets,
                or the volume that they enclose is not positive.
        """
        V = u.function_space
        d = V.mesh.geometry.dim
        if u.ufl_shape != (d,):
            raise ValueError(f"u has the shape {u.ufl_shape}: give a displacement, shape ({d},).")
        if not isinstance(ds, ufl.Measure) or ds.integral_type() != "exterior_facet":
            raise ValueError(f"ds is {ds}: give the measure of the inner surface, as ds(lumen).")
        require_finite(pressure=pressure)
        if volume is not None:
            require_positive(volume=volume)
        degree = max(
            element.embedded_superdegree
            for element in (V.ufl_element(), V.mesh.ufl_domain().ufl_coordinate_element())
        )
        if "quadrature_degree" not in ds.metadata():
            ds = ds(metadata={**ds.metadata(), "quadrature_degree": d * degree})
        self.u = u
        self._ds = ds
        self.form = enclosed_volume(u, ds, axis)
        self._compiled = dolfinx.fem.form(self.form)
        self.area = self._integral(
            dolfinx.fem.form(dolfinx.fem.Constant(V.mesh, np.float64(1.0)) * ds)
        )
        if self.area == 0.0:
            raise ValueError("ds has no facets: give the measure its tags and a tag among them.")
        enclosed = self.present_volume()
        if not enclosed > 0.0:
            raise ValueError(
                f"The surface of the cavity encloses {enclosed:g}, which is not positive: give the "
                "inner surface of the wall. If its open ends do not lie in planes through the "
                "origin, give axis=."
            )
        self.pressure = dolfinx.fem.Constant(V.mesh, np.float64(pressure))
        self.volume = None if volume is None else dolfinx.fem.Constant(V.mesh, np.float64(volume))

    def present_volume(self) -> float:
        """Return the volume that the surface encloses now [mm³]. Collective."""
        return self._integral(self._compiled)

    def spread(self, value: ufl.core.expr.Expr) -> ufl.Form:
        """Return a form of rank zero with the value of a constant expression: ∫ value/area ds."""
        return value / self.area * self._ds

    @property
    def work(self) -> ufl.Form:
        """The work of the pressure, −p δV, tested with v."""
        v = ufl.TestFunction(self.u.function_space)
        return ufl.derivative(-self.pressure * self.form, self.u, v)

    @property
    def equation(self) -> ScalarEquation:
        """The equation V(u) = V̄, with p as unknown."""
        if self.volume is None:
            raise ValueError("The cavity has no volume: give volume=, or a Windkessel.")
        return ScalarEquation(self.pressure, (self.form - self.spread(self.volume),), self.work)

    def check(self, bcs: Sequence[dolfinx.fem.DirichletBC]) -> None:
        """Check that the volume is positive, and that the rims are supported. Collective.

        −δV has to be the virtual work of a unit follower pressure on the surface. V has no
        integral over the caps of open rims, which is right for rims that are clamped or slide in
        certain planes. At another rim, the two differ at free dofs. They are compared at a
        displacement without symmetry.

        Raises:
            ValueError: They are not; on all processes.
        """
        self.check_values()
        V = self.u.function_space
        v = ufl.TestFunction(V)
        w = trial_displacement(V)
        for bc in bcs:
            bc.set(w.x.array)
        force = follower_pressure(1.0, w, v, self._ds)
        gradient = ufl.derivative(-ufl.replace(self.form, {self.u: w}), w, v)  # −δV
        if not free_norm(gradient - force, bcs) <= FORCE_RTOL * free_norm(force, ()):
            raise ValueError(
                "The surface of the cavity is open: it has a rim that is neither clamped nor "
                "slides in a plane of symmetry through the origin. Give axis= if open ends slide "
                "in planes normal to it; otherwise clamp the rim, or close the surface by a cap."
            )

    def check_values(self) -> None:
        """Check that the prescribed volume is positive."""
        if self.volume is not None:
            require_positive(volume=float(self.volume.value))

    def _facets(self) -> Indices:
        """Return the facets of the surface on this process; none if the measure has no tags."""
        tags = self._ds.subdomain_data()
        ids = self._ds.subdomain_id()
        wanted = ids if isinstance(ids, tuple) else (ids,)
        if tags is None or not hasattr(tags, "find") or "everywhere" in wanted:
            return np.zeros(0, dtype=np.int32)
        return np.concatenate([tags.find(i) for i in wanted])

    def overlaps(self, other: Cavity) -> bool:
        """Return True if two cavities share facets. Collective."""
        shared = len(np.intersect1d(self._facets(), other._facets())) > 0
        return bool(self.u.function_space.mesh.comm.allreduce(shared, op=MPI.LOR))

    def _integral(self, form: dolfinx.fem.Form) -> float:
        """Return the value of a form of rank zero. Collective."""
        comm = self.u.function_space.mesh.comm
        return float(comm.allreduce(dolfinx.fem.assemble_scalar(form)))
