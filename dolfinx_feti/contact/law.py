# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The law of frictionless contact, by an augmented Lagrangian: energy, virtual work and tangent.

With the signed distance g of the tool, a multiplier λ ≥ 0 and a penalty ε in the quadrature points,

.. math:: Π_c(u) = \int \frac{1}{2 ε} \left(⟨λ - ε\, g(X + u)⟩_+^2 - λ^2\right) \mathrm{d}A,
          \qquad λ ← ⟨λ - ε\, g⟩_+

after each equilibrium; it converges to λ ≥ 0, g ≥ 0 and λ g = 0. The residual is the derivative of
Π_c, a traction p = ⟨λ − ε g⟩₊ along ∇g. The tangent is that of the residual where p > 0, the
symmetric :math:`ε\, ∇g ⊗ ∇g - p\, ∇^2 g`, with two exceptions near p = 0 and at deep penetrations
(``ContactLaw.tangent``). UFL differentiates g; these forms are written out with its derivatives.
Source: P. Alart, A. Curnier, Comput. Methods Appl. Mech. Engrg. 92 (1991).
"""

from __future__ import annotations

import numpy as np

import dolfinx
import ufl
from ufl.core.expr import Expr

from dolfinx_feti.contact.points import create_point_space

__all__ = ["ContactLaw"]

#: Gap over the size of a cell up to which the tangent treats a point as touching: well above the
#: rounding of a position, and below any tolerance. At 1e-6 Newton's method takes twice as many
#: steps if the tolerance of penetrations is 1e-6.
CLOSED_GAP = 1e-9

#: Penetration over the size of a cell up to which the pressure contributes −p ∇²g, the part due to
#: the curvature of the tool, to the tangent: ten times the tolerance of penetrations. Without a
#: bound Newton's method starts with shifts if a tool moves by a tenth of a cell; at 1e-3 its last
#: steps converge linearly.
MAX_CURVATURE_DEPTH = 1e-2


class ContactLaw:
    """The forms of a contact in u, with its multiplier λ and penalty ε.

    λ and ε are Functions in the forms, and zero in a new law. Π_c divides by ε: set a positive
    value before Π_c is assembled.

    Attributes:
        u: The displacement.
        gap: g(X + u), the signed distance of the surface from the tool.
        ds: Measure of the surface, with its quadrature degree.
        weight: Factor of an area.
        multiplier: λ, at the quadrature points of all facets of all cells.
        penalty: ε, stress per length, one value for each cell.
        energy: Π_c, a form of rank zero.
    """

    def __init__(
        self, u: dolfinx.fem.Function, gap: Expr, ds: ufl.Measure, weight: float | Expr, name: str
    ) -> None:
        """Create λ, ε and the energy. Collective.

        Args:
            u: The displacement.
            gap: g(X + u).
            ds: Measure of the surface, with a quadrature degree.
            weight: Factor of an area.
            name: First part of the names of λ and ε.
        """
        mesh = u.function_space.mesh
        degree = ds.metadata()["quadrature_degree"]
        constants = dolfinx.fem.functionspace(mesh, ("DG", 0))
        self.u = u
        self.gap = gap
        self.ds = ds
        self.weight = weight
        self.multiplier = dolfinx.fem.Function(
            create_point_space(mesh, degree), name=f"{name}_multiplier"
        )
        self.penalty = dolfinx.fem.Function(constants, name=f"{name}_penalty")
        self._cell_sizes = dolfinx.fem.Function(constants, name=f"{name}_cell_sizes")
        cells = np.arange(len(constants.dofmap.list), dtype=np.int32)
        dofs = constants.dofmap.list[cells, 0]
        self._cell_sizes.x.array[dofs] = mesh.h(mesh.topology.dim, cells)
        λ = self.multiplier
        ε = self.penalty
        g = gap
        touching = -λ * g + ε / 2 * g**2  # ((λ − ε g)² − λ²)/(2 ε)
        density = ufl.conditional(ufl.gt(λ - ε * g, 0.0), touching, -(λ**2) / (2 * ε))
        self.energy: ufl.Form = weight * density * ds

    @property
    def virtual_work(self) -> ufl.Form:
        """δΠ_c = −∫ p δg dA, tested with v."""
        trial = self.multiplier - self.penalty * self.gap
        density = ufl.conditional(ufl.gt(trial, 0.0), -trial * self._virtual_gap(), 0.0)
        return self.weight * density * self.ds

    @property
    def tangent(self) -> ufl.Form:
        """The derivative of δΠ_c, ∫ ε δg Δg − p Δδg dA, with two exceptions.

        Points with a gap up to ``CLOSED_GAP`` count as touching. The residual has a kink at p = 0,
        and its tangent there is that of the stiffer side. With the tangent of the softer side, a
        Newton step could end at the kink again and again. In −p Δδg, p is at most the pressure at a
        penetration of ``MAX_CURVATURE_DEPTH``: no equilibrium has a deeper one.
        """
        λ = self.multiplier
        ε = self.penalty
        g = self.gap
        h = self._cell_sizes
        trial = λ - ε * g
        δg = self._virtual_gap()
        du = ufl.TrialFunction(self.u.function_space)
        dg = ufl.derivative(g, self.u, du)  # Δg
        d_δg = ufl.derivative(δg, self.u, du)  # Δδg
        p = ufl.max_value(ufl.min_value(trial, λ + ε * MAX_CURVATURE_DEPTH * h), 0.0)
        stiffness = ε * dg * δg - p * d_δg
        density = ufl.conditional(ufl.gt(trial + ε * CLOSED_GAP * h, 0.0), stiffness, 0.0)
        return self.weight * density * self.ds

    def _virtual_gap(self) -> Expr:
        """Return δg, the derivative of g in u in the direction of the test function."""
        return ufl.derivative(self.gap, self.u, ufl.TestFunction(self.u.function_space))
