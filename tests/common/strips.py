# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A strip whose cells are inside out only between the points of the quadrature."""

from __future__ import annotations

import numpy as np
from collective import COMM, logged_messages
from problems import Cell

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem
from dolfinx_feti.mechanics.materials import perturbed_lagrangian

ROWS = 4

#: Strains s of :class:`Strip`. With this one det F = −0.1 at all vertices with x = 1.
INVERTED = 1.1

#: Distorted cells: det F = 0.15 at these vertices, and 0.43 or 0.72 in the mean of a cell.
DISTORTED = 0.85

#: Sound cells: det F = 0.5 at these vertices.
SOUND = 0.5


class Strip:
    """Two columns of cells, the left one of which is compressed: det F = 1 − s x for x ≤ 1.

    Without a condensed pressure the load is chosen so that ``aim``, the compressed state, is an
    equilibrium.

    Args:
        kind: Type of the cells.
        degree: Degree of the displacement.
        unit: Width of a column of cells, and height of the strip.
        pressure: Whether a pressure in each cell is condensed.
        held: Marks the boundary where ``aim`` is prescribed; the right end if not given.
        **arguments: Further arguments of ``NonlinearProblem``.
    """

    def __init__(
        self, kind=Cell.triangle, *, degree=2, unit=1.0, pressure=False, held=None, **arguments
    ):
        corners = [(0, 0), (2 * unit, unit)]
        mesh = dolfinx.mesh.create_rectangle(COMM, corners, (2, ROWS), cell_type=kind)
        self.mesh = mesh
        self.unit = unit
        V = dolfinx.fem.functionspace(mesh, ("Lagrange", degree, (2,)))
        self.u = dolfinx.fem.Function(V)
        self.aim = dolfinx.fem.Function(V)
        fields = {}
        J = ufl.det(ufl.Identity(2) + ufl.grad(self.u))
        energy = self.density(self.u) * ufl.dx
        if pressure:
            p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)))
            energy += perturbed_lagrangian(J, p, kappa=1.0) * ufl.dx
            fields["condense"] = p
        else:
            v = ufl.TestFunction(V)
            energy = ufl.derivative(energy, self.u, v)
            energy -= ufl.derivative(self.density(self.aim) * ufl.dx, self.aim, v)
        self.problem = NonlinearProblem(
            energy,
            self.u,
            bcs=self.conditions(held),
            subdomains=4,
            quadrature_degree=2 * degree,
            **fields,
            **arguments,
        )

    def conditions(self, held):
        """Prescribe the compression on a part of the boundary, the right end if none is given."""
        V = self.u.function_space

        def right_end(x):
            return np.isclose(x[0], 2 * self.unit)

        where = right_end if held is None else held
        facets = dolfinx.mesh.locate_entities_boundary(self.mesh, 1, where)
        dofs = dolfinx.fem.locate_dofs_topological(V, 1, facets)
        return [dolfinx.fem.dirichletbc(self.aim, dofs)]

    @staticmethod
    def density(u):
        """Return the stored energy per area, (|F|² − 2 ln det F)."""
        F = ufl.Identity(2) + ufl.grad(u)
        return ufl.inner(F, F) - 2 * ufl.ln(ufl.det(F))

    def place(self, f, strain):
        """Interpolate into a function f the compression with this strain."""

        def compressed(x):
            ξ = np.minimum(x[0] / self.unit, 1.0)
            return np.stack([-strain / 2 * ξ**2 * self.unit, 0 * x[1]])

        f.interpolate(compressed)

    def solve(self, strain):
        """Solve for the compression with this strain, from a first guess that is its solution."""
        self.place(self.aim, strain)
        self.place(self.u, strain)
        self.problem.solve()


def volume_warnings(caplog):
    """Return the warnings of det F, which the first process has logged."""
    return [text for text in logged_messages(caplog) if "det F is" in text]
