# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The values of a contact at the quadrature points of its surface, and its resultant force."""

from __future__ import annotations

from functools import cached_property

import numpy as np

import dolfinx
import ufl

from dolfinx_feti.contact.law import ContactLaw
from dolfinx_feti.contact.surface import ContactSurface, PointExpression
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import total_of

__all__ = ["ContactEvaluation"]


class ContactEvaluation:
    """Values of a contact in the current state of body and tool.

    g and ∇g are compiled. The other values follow from them, λ and ε; only the area stretch is
    compiled as well, when it is first evaluated.

    Attributes:
        surface: The surface, with its points.
        law: The law, with λ and ε.
    """

    def __init__(self, surface: ContactSurface, law: ContactLaw) -> None:
        """Compile g and ∇g. Collective.

        Args:
            surface: The surface.
            law: The law.
        """
        self.surface = surface
        self.law = law
        self._gap = surface.compile(law.gap)
        V = law.u.function_space
        v = ufl.TestFunction(V)
        # in place of v: with a unit vector, the derivative of g is a component of ∇g
        self._direction = dolfinx.fem.Constant(V.mesh, np.zeros(len(law.u)))
        slope = ufl.replace(ufl.derivative(law.gap, law.u, v), {v: self._direction})
        self._slope = surface.compile(slope)

    def gap(self) -> Array:
        """Return g at the points, (points,). Collective."""
        return self._gap.evaluate()

    def normals(self) -> Array:
        """Return ∇g at the points, (points, d). Collective."""
        components = []
        for direction in np.eye(len(self.law.u)):
            self._direction.value = direction
            components.append(self._slope.evaluate())
        return np.column_stack(components)

    def multiplier(self) -> Array:
        """Return λ at the points, (points,)."""
        return np.asarray(self.law.multiplier.x.array[self.surface.dofs])

    def penalty(self) -> Array:
        """Return ε at the points, (points,)."""
        ε = self.law.penalty
        dofs = ε.function_space.dofmap.list[self.surface.cells, 0]
        return np.asarray(ε.x.array[dofs])

    def pressure(self) -> Array:
        """Return p = ⟨λ − ε g⟩₊ at the points, (points,). Collective."""
        return np.maximum(self.multiplier() - self.penalty() * self.gap(), 0.0)

    def force(self) -> Array:
        """Return the resultant force on the body, ∫ p ∇g dA, (d,). Collective."""
        p = self.pressure()
        is_touching = p > 0.0  # ∇g may be undefined elsewhere, as at the centre of a hollow sphere
        forces = (self.surface.weighted_areas * p)[is_touching]
        normals = self.normals()[is_touching]
        return total_of(forces @ normals, self.surface.mesh.comm)

    def area_stretch(self) -> Array:
        """Return da/dA = ‖cof F N‖ at the points, (points,). Collective."""
        return self._area_stretch.evaluate()

    @cached_property
    def _area_stretch(self) -> PointExpression:
        """The stretch, compiled when it is first evaluated."""
        u = self.law.u
        F = ufl.Identity(len(u)) + ufl.grad(u)
        N = ufl.FacetNormal(self.surface.mesh)
        normal = ufl.cofac(F) * N
        return self.surface.compile(ufl.sqrt(ufl.dot(normal, normal)))
