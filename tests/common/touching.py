# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Bodies that touch tools: blocks on plates, and a half space under a sphere."""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
from collective import COMM
from problems import Cell, Marker, dirichlet, tagged

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem
from dolfinx_feti.contact import Contact, half_space, sphere
from dolfinx_feti.scalars import ArcLength

EXACT = {"snes_rtol": 1e-12, "snes_atol": 0.0, "ksp_rtol": 1e-11}


@dataclass
class Touching:
    """A problem with one contact.

    Attributes:
        problem: The problem.
        contact: Its contact.
        u: Displacement.
        numbers: The ``height`` of the tool and the ``pressure`` on the upper face.
    """

    problem: NonlinearProblem
    contact: Contact
    u: dolfinx.fem.Function
    numbers: dict[str, dolfinx.fem.Constant]

    def pressures(self) -> tuple[float, float]:
        """Return the least and the greatest contact pressure on all processes."""
        p = self.contact.pressure.x.array
        least = COMM.allreduce(p.min(initial=np.inf), op=MPI.MIN)
        return least, COMM.allreduce(p.max(initial=-np.inf), op=MPI.MAX)


def plate(dim):
    """Return a function that creates a tool from its height: a plate below a block."""
    normal = (*[0.0] * (dim - 1), 1.0)
    return lambda height: half_space(normal, offset=height)


def bump(dim, length=1.0):
    """Return a function that creates a tool from its height: a sphere below a block."""
    radius = 0.7 * length
    centre = np.zeros(dim)
    centre[-1] = -radius

    def at(height):
        def distance(x):
            shift = ufl.as_vector([*[0.0] * (dim - 1), height])
            return sphere(radius, centre)(x - shift)

        return distance

    return at


def square_or_cube(dim: int, n: int, cell: Cell, length: float = 1.0) -> dolfinx.mesh.Mesh:
    """Mesh a square or cube of a length."""
    if dim == 2:
        return dolfinx.mesh.create_rectangle(COMM, [(0, 0), (length, length)], (n, n), cell)
    corners = [(0, 0, 0), (length, length, length)]
    return dolfinx.mesh.create_box(COMM, corners, (n, n, n), cell)


def compressible(u: dolfinx.fem.Function, stiffness: float) -> ufl.core.expr.Expr:
    """Return the energy of a compressible neo-Hookean material."""
    d = len(u)
    F = ufl.Identity(d) + ufl.grad(u)
    J = ufl.det(F)
    shear = ufl.tr(F.T * F) - d - 2 * ufl.ln(J)
    return stiffness / 2 * shear + stiffness * ufl.ln(J) ** 2


def block(
    tool,
    *,
    dim: int = 3,
    n: int = 3,
    cell: Cell = Cell.tetrahedron,
    degree: int = 2,
    stiffness: float = 1.0,
    length: float = 1.0,
    pressure: float | None = None,
    subdomains: int = 4,
    tolerance: float = 1e-3,
    as_residual: bool = False,
    options: dict[str, object] | None = None,
    volume_tolerance: float | None = None,
    along_arc: bool = False,
) -> Touching:
    """Set up a block that slides on planes through the origin, with a tool at its lower face.

    Args:
        tool: Creates the tool from its height along the last axis, a Constant.
        dim: 2 or 3.
        n: Cells along an edge.
        cell: Type of the cells.
        degree: Degree of the displacement.
        stiffness: Shear modulus.
        length: Edge of the block.
        pressure: Pressure on the upper face; None if its normal displacement is zero instead.
        subdomains: Number of subdomains.
        tolerance: ``contact_tolerance`` of the problem.
        as_residual: Whether the problem gets a residual instead of an energy.
        options: PETSc options without prefix; tight tolerances if not given.
        volume_tolerance: Of the problem; the material then has a condensed pressure.
        along_arc: Whether the pressure on the upper face is unknown.
    """
    mesh = square_or_cube(dim, n, cell, length)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", degree, (dim,)))
    u = dolfinx.fem.Function(V, name="u")
    last = dim - 1
    ds = tagged(mesh, lambda x: np.isclose(x[last], 0.0), lambda x: np.isclose(x[last], length))
    names = ("height", "pressure")
    numbers = {name: dolfinx.fem.Constant(mesh, 0.0) for name in names}
    dx = ufl.dx(metadata={"quadrature_degree": 2 * degree})
    energy = compressible(u, stiffness) * dx
    fields = []
    if volume_tolerance is not None:
        p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)), name="p")
        J = ufl.det(ufl.Identity(dim) + ufl.grad(u))
        energy += (p * (J - 1) - p**2 / (20 * stiffness)) * dx
        fields.append(p)

    def plane(i: int, place: float = 0.0) -> Marker:
        return lambda x: np.isclose(x[i], place)

    bcs = [dirichlet(V, plane(i), component=i) for i in range(last)]
    if pressure is None:
        bcs.append(dirichlet(V, plane(last, length), component=last))
    else:
        numbers["pressure"].value = pressure
        energy += numbers["pressure"] * u[last] * ds(2)
    contact = Contact(u, ds(1), tool(numbers["height"]))
    F = ufl.derivative(energy, u, ufl.TestFunction(V)) if as_residual else energy
    problem = NonlinearProblem(
        F,
        u,
        bcs=bcs,
        contacts=[contact],
        contact_tolerance=tolerance,
        condense=fields or None,
        volume_tolerance=volume_tolerance,
        scalars=[ArcLength(u, numbers["pressure"])] if along_arc else [],
        subdomains=subdomains,
        petsc_options=EXACT if options is None else options,
    )
    return Touching(problem, contact, u, numbers)
