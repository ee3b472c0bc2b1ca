# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Blocks of materials that a user writes in UFL, as an energy alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from collective import COMM
from problems import cube, dirichlet, free_residual, left

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem

PREFIX = "newton_"


@dataclass(frozen=True, slots=True)
class Body:
    """A block, clamped on the left, under a force per volume."""

    energy: ufl.Form  #: Π(u), the load's potential included
    u: dolfinx.fem.Function
    load: dolfinx.fem.Constant
    bcs: list[dolfinx.fem.DirichletBC]

    def problem(self, options: dict[str, object] | None = None, **arguments: object):
        """Create the FETI problem with four subdomains; ``options`` are without prefix."""
        return NonlinearProblem(
            self.energy,
            self.u,
            bcs=self.bcs,
            subdomains=4,
            petsc_options_prefix=PREFIX,
            petsc_options=options,
            **arguments,
        )

    def residual(self) -> float:
        """Return the norm of the residual on the free dofs, assembled without the package."""
        F = ufl.derivative(self.energy, self.u, ufl.TestFunction(self.u.function_space))
        return free_residual(F, self.bcs)[0]


def yeoh(F: ufl.core.expr.Expr) -> ufl.core.expr.Expr:
    """Return the energy of Yeoh's rubber, in plane strain for d = 2, with a volumetric part."""
    d = F.ufl_shape[0]
    J = ufl.det(F)
    x = J ** (-2 / 3) * (ufl.inner(F, F) + (3 - d)) - 3
    return 1.0 * x + 0.2 * x**2 + 0.1 * x**3 + 5.0 * (J - 1) ** 2


def logarithmic(F: ufl.core.expr.Expr) -> ufl.core.expr.Expr:
    """Return a neo-Hookean energy that is NaN once a cell turns inside out."""
    J = ufl.det(F)
    return (ufl.inner(F, F) - F.ufl_shape[0]) / 2 - ufl.ln(J) + 0.5 * ufl.ln(J) ** 2


def gent(F: ufl.core.expr.Expr) -> ufl.core.expr.Expr:
    """Return the energy of chains of limited length, NaN where they would be overstretched."""
    x = (ufl.inner(F, F) - F.ufl_shape[0] - 2 * ufl.ln(ufl.det(F))) / 2.0
    return -ufl.ln(1 - x) + (ufl.det(F) - 1) ** 2


def block(
    density: Callable[[ufl.core.expr.Expr], ufl.core.expr.Expr],
    force: tuple[float, ...],
    *,
    degree: int = 1,
) -> Body:
    """Return a unit square or cube of a material, clamped on the left.

    Args:
        density: Energy per volume, by F.
        force: Force per volume, (2,) or (3,); its length is the dimension.
        degree: Degree of the displacement.
    """
    d = len(force)
    mesh = cube(d, 3)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", degree, (d,)))
    u = dolfinx.fem.Function(V)
    load = dolfinx.fem.Constant(mesh, np.array(force))
    degrees = {"quadrature_degree": 2 * degree}
    energy = density(ufl.Identity(d) + ufl.grad(u)) * ufl.dx(metadata=degrees)
    energy -= ufl.inner(load, u) * ufl.dx(metadata=degrees)
    return Body(energy, u, load, [dirichlet(V, left)])


def least_ratio(u: dolfinx.fem.Function) -> float:
    """Return the least mean of det F over a cell, on all processes."""
    mesh = u.function_space.mesh
    Q = dolfinx.fem.functionspace(mesh, ("DG", 0))
    J = ufl.det(ufl.Identity(mesh.geometry.dim) + ufl.grad(u)) * ufl.TestFunction(Q) * ufl.dx
    size = ufl.TestFunction(Q) * ufl.dx(mesh)
    n = Q.dofmap.index_map.size_local
    values = [dolfinx.fem.assemble_vector(dolfinx.fem.form(form)).array[:n] for form in (J, size)]
    return min(COMM.allgather((values[0] / values[1]).min(initial=np.inf)))


def two_wells() -> tuple[dolfinx.fem.Function, ufl.Form, list[dolfinx.fem.DirichletBC]]:
    """Return u, Π = ∫ ε/2 |∇u|² + (u² − 1)²/4 and conditions.

    u = 0 solves Π' = 0, but is a ridge between the two valleys u = ±1.
    """
    mesh = cube(2, 8)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1))
    u = dolfinx.fem.Function(V)
    energy = 0.1 * ufl.inner(ufl.grad(u), ufl.grad(u)) / 2 * ufl.dx + (u**2 - 1) ** 2 / 4 * ufl.dx
    edge = dirichlet(V, lambda x: np.isclose(x[0], 0.0), lambda x: 0.0 * x[0])
    u.interpolate(lambda x: 0.2 * np.sin(np.pi * x[0] / 2) * (1.0 + 0.3 * np.cos(3 * x[1])))
    return u, energy, [edge]
