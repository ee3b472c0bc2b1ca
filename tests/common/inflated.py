# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Bodies with cavities: a spherical balloon, a block with bowls, and their exact pressures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from collective import COMM
from problems import dirichlet, tagged

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, kinematics, materials
from dolfinx_feti.meshes.curved import create_curved_mesh
from dolfinx_feti.meshes.octant import create_octant
from dolfinx_feti.scalars import Cavity

Array = npt.NDArray[np.float64]
INNER = 1.0
OUTER = 1.1


@dataclass(frozen=True, slots=True)
class RubberBody:
    """A body with its unknowns; ``ds(i + 1)`` is the surface that marker i selects."""

    u: dolfinx.fem.Function
    p: dolfinx.fem.Function  #: Pressure in each cell, to be condensed
    bcs: list[dolfinx.fem.DirichletBC]
    ds: ufl.Measure
    energy: ufl.Form  #: Π(u, p)

    def problem(self, scalars, **options) -> NonlinearProblem:
        """Return the problem with scalars; ``options`` are arguments of ``NonlinearProblem``."""
        petsc = {"snes_max_it": 20, "snes_atol": 0.0} | options.pop("petsc_options", {})
        keywords = {"subdomains": 6, "quadrature_degree": 4} | options
        return NonlinearProblem(
            self.energy,
            self.u,
            bcs=self.bcs,
            condense=self.p,
            scalars=scalars,
            petsc_options=petsc,
            **keywords,
        )


def create_rubber_body(
    mesh: dolfinx.mesh.Mesh,
    planes: list[tuple[int, float]],
    surfaces: list[Callable[[Array], npt.NDArray[np.bool_]]],
    *,
    stiffness: float = 1.0,
    kappa: float = 1e4,
    pressure: tuple[str, int] = ("DG", 0),
) -> RubberBody:
    """Return a neo-Hookean body.

    Args:
        mesh: Mesh of the body.
        planes: Planes (axis, place) in which the body slides.
        surfaces: Markers of surfaces; surface i has the tag i + 1.
        stiffness: Shear modulus.
        kappa: κ over the shear modulus.
        pressure: Family and degree of the condensed pressure.
    """
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (3,)))
    u = dolfinx.fem.Function(V, name="u")
    p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, pressure), name="p")
    bcs = [
        dirichlet(V, lambda x, axis=axis, place=place: np.isclose(x[axis], place), component=axis)
        for axis, place in planes
    ]
    F = kinematics.deformation_gradient(u)
    C = kinematics.right_cauchy_green(F)
    J = kinematics.jacobian(F)
    psi = materials.neo_hookean(C, c=stiffness, J=J)
    psi += materials.perturbed_lagrangian(J, p, kappa * stiffness)
    return RubberBody(u, p, bcs, tagged(mesh, *surfaces), psi * ufl.dx)


def balloon(
    divisions: int = 4, *, unit: float = 1.0, stiffness: float = 1.0, kappa: float = 1e4
) -> RubberBody:
    """Return an octant of a hollow sphere, its inner surface with the tag 1."""
    mesh = create_octant(COMM, divisions, 1, INNER * unit, OUTER * unit)
    return create_rubber_body(
        mesh,
        [(0, 0.0), (1, 0.0), (2, 0.0)],
        [lambda x: np.isclose(np.linalg.norm(x, axis=0), INNER * unit)],
        stiffness=stiffness,
        kappa=kappa,
    )


def balloon_pressure(stretch: float) -> float:
    """Return P/μ of an incompressible neo-Hookean balloon at a stretch of its inner radius."""
    outside = np.cbrt(1.0 + (stretch**3 - 1.0) * (INNER / OUTER) ** 3)
    return float(np.subtract(*(2.0 / λ + 0.5 / λ**4 for λ in (outside, stretch))))


def balloon_cavity(ball: RubberBody, stretch: float = 1.0) -> Cavity:
    """Return the cavity of a balloon; its volume is that at a stretch of the inner radius."""
    cavity = Cavity(ball.u, ball.ds(1), volume=1.0)
    cavity.volume.value = cavity.present_volume() * stretch**3
    return cavity


def thick_tube(cells: tuple[int, int] = (3, 6), *, stiffness: float = 1.0) -> RubberBody:
    """Return a quarter of a slice of a thick tube in plane strain, Q2–P1d, with the lumen's tag 1.

    Its radii are 1 and 1.5, its length is 0.2; its energy is that of a neo-Hookean material with
    the shear modulus ``stiffness``, nearly incompressible.
    """
    hexahedron = dolfinx.mesh.CellType.hexahedron
    box = dolfinx.mesh.create_box(
        COMM, [(1.0, 0.0, 0.0), (1.5, np.pi / 2, 0.2)], (*cells, 1), cell_type=hexahedron
    )

    def round_the_axis(x: Array) -> Array:
        r, angle, z = x.T
        return np.column_stack((r * np.cos(angle), r * np.sin(angle), z))

    planes = [(0, 0.0), (1, 0.0), (2, 0.0), (2, 0.2)]
    lumen = [lambda x: np.isclose(np.hypot(x[0], x[1]), 1.0)]
    mesh = create_curved_mesh(box, round_the_axis)
    return create_rubber_body(mesh, planes, lumen, stiffness=stiffness, pressure=("DPC", 1))


def tube_volume(inner: float) -> float:
    """Return the volume in the lumen of the slice at an inner radius."""
    return np.pi / 4.0 * inner**2 * 0.2


def tube_pressure(volume: float) -> float:
    """Return P/μ of the incompressible tube with a volume in its lumen."""
    square = volume / tube_volume(1.0)  # a², with A = 1
    a = np.sqrt(square)
    b = np.sqrt(1.5**2 + square - 1.0) / 1.5  # stretches
    return float(np.log(a / b) + (b**-2 - a**-2) / 2.0)
