# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The values of a contact at the quadrature points of its surface, and its resultant force."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np

import dolfinx
import ufl
from ufl.core.expr import Expr

from dolfinx_feti.contact.surface import ContactSurface
from dolfinx_feti.runtime.arrays import Array

__all__ = ["ContactEvaluation"]


class ContactEvaluation:
    """Compiled expressions of a contact, in the present state of body and tool.

    Attributes:
        surface: The surface, with its points.
    """

    def __init__(
        self,
        surface: ContactSurface,
        gap: Expr,
        u: dolfinx.fem.Function,
        multiplier: dolfinx.fem.Function,
        penalty: dolfinx.fem.Function,
        virtual_work: ufl.Form,
    ) -> None:
        """Compile the expressions. Collective.

        Args:
            surface: The surface.
            gap: Signed distance g of its points from the tool.
            u: The displacement.
            multiplier: λ.
            penalty: ε.
            virtual_work: δΠ_c, with a test function of the space of u.
        """
        self.surface = surface
        self._u = u
        self._multiplier = multiplier
        trial = multiplier - penalty * gap
        self._gap = surface.evaluator(gap)
        self._pressure = surface.evaluator(ufl.conditional(ufl.gt(trial, 0.0), trial, 0.0))
        self._penalty = surface.evaluator(ufl.as_ufl(penalty))
        V = u.function_space
        v = ufl.TestFunction(V)
        # in place of v: with a unit vector, the derivative of g is a component of ∇g
        self._direction = dolfinx.fem.Constant(V.mesh, np.zeros(len(u)))
        slope = ufl.replace(ufl.derivative(gap, u, v), {v: self._direction})
        self._slope = surface.evaluator(slope)
        self._force = surface.integrator(ufl.replace(-virtual_work, {v: self._direction}))

    def gap(self) -> Array:
        """Return g at the points, (points,). Collective."""
        return self._gap()

    def multiplier(self) -> Array:
        """Return λ at the points, (points,)."""
        return np.asarray(self._multiplier.x.array[self.surface.dofs])

    def penalty(self) -> Array:
        """Return ε at the points, (points,). Collective."""
        return self._penalty()

    def pressure(self) -> Array:
        """Return p = ⟨λ − ε g⟩₊ at the points, (points,). Collective."""
        return np.maximum(self._pressure(), 0.0)

    def normals(self) -> Array:
        """Return ∇g at the points, (points, d). Collective."""
        components = []
        for direction in np.eye(len(self._u)):
            self._direction.value = direction
            components.append(self._slope())
        return np.column_stack(components)

    def force(self) -> Array:
        """Return the resultant force on the body, ∫ p ∇g dA, (d,). Collective."""
        components = []
        for direction in np.eye(len(self._u)):
            self._direction.value = direction
            components.append(self._force())
        return np.array(components)

    def area_stretch(self) -> Array:
        """Return da/dA = ‖cof F N‖ at the points, (points,). Collective."""
        return self._area_stretch()

    @cached_property
    def _area_stretch(self) -> Callable[[], Array]:
        """Function that evaluates the stretch; compiled at its first use."""
        F = ufl.Identity(len(self._u)) + ufl.grad(self._u)
        N = ufl.FacetNormal(self._u.function_space.mesh)
        normal = ufl.cofac(F) * N
        return self.surface.evaluator(ufl.sqrt(ufl.dot(normal, normal)))
