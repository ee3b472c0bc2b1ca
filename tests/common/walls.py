# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Bodies under a follower pressure, small enough for tests, as a dolfinx user writes them.

There are two. The first is the two-layer tube. The second is the beam of S. Land et al.,
*Verification of cardiac mechanics software*, Proc. R. Soc. A 471 (2015) 20150641, problem 1:
Guccione's law with C = 2 kPa, b_f, b_t, b_fs = 8, 2, 4, and fibres along x. It is soft and slender,
and the rim of its loaded face is free except for one edge.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from problems import dirichlet, left, tagged

import basix.ufl
import dolfinx
import ufl

import dolfinx_feti
from dolfinx_feti import kinematics, loads, materials
from dolfinx_feti.meshes.lattice import lattice_cells

Array = npt.NDArray[np.float64]
Marker = npt.NDArray[np.bool_]

INNER = 0.71
INTERFACE = 0.97
OUTER = 1.10
MEDIA = np.radians(29.0)
ADVENTITIA = np.radians(62.0)
LUMEN = 1
PREFIX = "wall_"


@dataclass(frozen=True, slots=True)
class Wall:
    """Forms, unknowns and boundary conditions of a P_k–P_0 wall."""

    u: dolfinx.fem.Function  #: Displacement [mm]
    p: dolfinx.fem.Function  #: Pressure of the material [kPa]
    load: dolfinx.fem.Constant  #: Pressure in the lumen [kPa]
    bcs: list[dolfinx.fem.DirichletBC]  #: Dirichlet conditions
    energy: ufl.Form  #: Π(u, p) without the load
    F_u: ufl.Form  #: Residual tested with v, with the follower load
    F_p: ufl.Form  #: Residual tested with q
    J: ufl.Form | None  #: Tangent of F_u in u

    @property
    def fields(self) -> tuple[dolfinx.fem.Function, ...]:
        """The condensed fields: the pressure."""
        return (self.p,)

    @property
    def F_fields(self) -> tuple[ufl.Form, ...]:
        """Residuals of the condensed fields."""
        return (self.F_p,)

    def problem(
        self, subdomains: int | npt.NDArray[np.integer], options: Mapping[str, object] | None = None
    ) -> dolfinx_feti.NonlinearProblem:
        """Create the FETI problem; ``options`` are PETSc options without prefix."""
        return dolfinx_feti.NonlinearProblem(
            [self.F_u, self.F_p],
            self.u,
            bcs=self.bcs,
            J=self.J,
            condense=self.p,
            subdomains=subdomains,
            petsc_options_prefix=PREFIX,
            petsc_options=options,
        )

    def inflate(
        self, problem: dolfinx_feti.NonlinearProblem, pressures: Sequence[float]
    ) -> list[dolfinx_feti.problems.history.NewtonStep]:
        """Solve at one pressure [mmHg] after the other; return all Newton steps."""
        steps = []
        for pressure in pressures:
            self.load.value = loads.mmhg(pressure)
            problem.solve()
            steps += problem.history
        return steps


def tube(
    comm: MPI.Comm = MPI.COMM_WORLD,
    *,
    media: int = 1,
    adventitia: int = 1,
    around: int = 8,
    along: int = 2,
    length: float = 0.8,
    quarter: bool = False,
) -> dolfinx.mesh.Mesh:
    """Mesh a tube, or its part in the first quadrant, with bricks cut into six tetrahedra.

    Args:
        comm: Communicator.
        media: Bricks through the media.
        adventitia: Bricks through the adventitia.
        around: Bricks around the tube, or around its quarter.
        along: Bricks along the axis.
        length: Length [mm].
        quarter: Whether only the part in the first quadrant is meshed.
    """
    inside = np.linspace(INNER, INTERFACE, media + 1)
    radii = np.append(inside, np.linspace(INTERFACE, OUTER, adventitia + 1)[1:])
    columns = around + 1 if quarter else around
    angles = np.linspace(0.0, np.pi / 2 if quarter else 2 * np.pi, around + 1)[:columns]
    heights = np.linspace(0.0, length, along + 1)
    r, θ, z = (a.ravel() for a in np.meshgrid(radii, angles, heights, indexing="ij"))
    x = np.column_stack([r * np.cos(θ), r * np.sin(θ), z])
    number = np.arange(len(x)).reshape(len(radii), columns, along + 1)
    if not quarter:
        number = np.concatenate([number, number[:, :1]], axis=1)
    cells = lattice_cells(number, 1, simplices=True)  # six beside each other for each brick
    return create_mesh(comm, x, cells.reshape(-1, 6, 4).swapaxes(0, 1).reshape(-1, 4))


def create_mesh(comm: MPI.Comm, x: Array, cells: npt.NDArray[np.integer]) -> dolfinx.mesh.Mesh:
    """Create a mesh of tetrahedra, with ghost cells, from the arrays of the first process."""
    if comm.rank > 0:
        x = x[:0]
        cells = cells[:0]
    element = basix.ufl.element("Lagrange", "tetrahedron", 1, shape=(3,))
    mode = dolfinx.mesh.GhostMode.shared_facet
    try:
        ghosts = dolfinx.mesh.create_cell_partitioner(mode, 2)  # cells at a facet
    except TypeError:  # until dolfinx 0.10
        ghosts = dolfinx.mesh.create_cell_partitioner(mode)
    return dolfinx.mesh.create_mesh(
        comm, cells=cells.astype(np.int64), x=x, e=element, partitioner=ghosts
    )


def wall(
    mesh: dolfinx.mesh.Mesh,
    *,
    degree: int = 2,
    kappa: float = 1000.0,
    tangent: str = "symmetric",
    quarter: bool = False,
) -> Wall:
    """Set up the two-layer wall: P_k–P_0, two families of fibres, a follower pressure.

    Args:
        mesh: Mesh of :func:`tube`.
        degree: k.
        kappa: κ [kPa].
        tangent: Kind of the pressure's tangent, or ``exact``, by UFL.
        quarter: Whether the mesh is a quarter, which slides in its planes of symmetry and ends; a
            whole tube is clamped at its ends.
    """
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", degree, (3,)))
    Q = dolfinx.fem.functionspace(mesh, ("DG", 0))
    u = dolfinx.fem.Function(V, name="u")
    p = dolfinx.fem.Function(Q, name="p")
    a1, a2 = (fibres(mesh, sign) for sign in (1.0, -1.0))
    metadata = {"quadrature_degree": 2 * degree}
    F = kinematics.deformation_gradient(u)
    J = kinematics.jacobian(F)
    psi = materials.holzapfel_gasser_ogden(
        kinematics.right_cauchy_green(F), a1, a2, c=3.0, k1=2.3632, k2=0.8393, J=J
    )
    kappa_ = dolfinx.fem.Constant(mesh, float(kappa))
    energy = (psi + materials.perturbed_lagrangian(J, p, kappa_)) * ufl.dx(metadata=metadata)
    bcs = symmetric(V) if quarter else clamped(V)
    return under_pressure(u, p, bcs, energy, lumen_measure(mesh)(LUMEN, metadata=metadata), tangent)


def under_pressure(
    u: dolfinx.fem.Function,
    p: dolfinx.fem.Function,
    bcs: list[dolfinx.fem.DirichletBC],
    energy: ufl.Form,
    surface: ufl.Measure,
    tangent: str,
) -> Wall:
    """Create a wall from its stored energy and a follower pressure on a surface.

    Args:
        u: Displacement.
        p: Pressure of the material.
        bcs: Dirichlet conditions.
        energy: Π(u, p) without the load.
        surface: Measure of the loaded surface.
        tangent: Kind of the pressure's tangent, or ``exact``, by UFL.
    """
    V = u.function_space
    Q = p.function_space
    v = ufl.TestFunction(V)
    q = ufl.TestFunction(Q)
    du = ufl.TrialFunction(V)
    load = dolfinx.fem.Constant(V.mesh, 0.0)
    F_u = ufl.derivative(energy, u, v)
    F_p = ufl.derivative(energy, p, q)
    K = None if tangent == "exact" else ufl.derivative(F_u, u, du)
    if K is not None:
        K += loads.follower_pressure_tangent(load, u, v, du, surface, tangent, bcs=bcs)
    F_u += loads.follower_pressure(load, u, v, surface)
    return Wall(u, p, load, bcs, energy, F_u, F_p, K)


def fibres(mesh: dolfinx.mesh.Mesh, sign: float) -> dolfinx.fem.Function:
    """Return a unit vector for each cell at the layer's angle to the circumference."""

    def direction(x: Array) -> Array:
        r = np.hypot(x[0], x[1])
        α = np.where(r < INTERFACE, MEDIA, ADVENTITIA)
        return np.stack([-x[1] / r * np.cos(α), x[0] / r * np.cos(α), sign * np.sin(α)])

    a = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0, (3,))))
    a.interpolate(direction)
    return a


def lumen_measure(mesh: dolfinx.mesh.Mesh) -> ufl.Measure:
    """Return the measure whose part ``LUMEN`` is the inner surface."""
    return tagged(mesh, lambda x: np.hypot(x[0], x[1]) < INNER * (1 + 1e-8))


def clamped(V: dolfinx.fem.FunctionSpace) -> list[dolfinx.fem.DirichletBC]:
    """Clamp both ends."""
    return [dirichlet(V, at_ends(V.mesh))]


def symmetric(V: dolfinx.fem.FunctionSpace) -> list[dolfinx.fem.DirichletBC]:
    """Return the conditions of planes of symmetry and ends: no normal displacement."""
    planes = (lambda x: np.isclose(x[0], 0.0), lambda x: np.isclose(x[1], 0.0), at_ends(V.mesh))
    return [dirichlet(V, where, component=k) for k, where in enumerate(planes)]


def at_ends(mesh: dolfinx.mesh.Mesh) -> Callable[[Array], Marker]:
    """Return the marker of both ends."""
    length = mesh.comm.allreduce(mesh.geometry.x[:, 2].max(initial=0.0), op=MPI.MAX)
    return lambda x: np.isclose(x[2], 0.0) | np.isclose(x[2], length)


def beam(
    comm: MPI.Comm = MPI.COMM_WORLD,
    tangent: str = "auto",
    *,
    kappa: float = 1000.0,
    cells: tuple[int, int, int] = (8, 1, 1),
) -> Wall:
    """Set up the beam of 10 × 1 × 1 mm, P2–P0, clamped at x = 0, under a pressure on z = 0.

    Args:
        comm: Communicator.
        tangent: Kind of the pressure's tangent, or ``exact``, by UFL.
        kappa: κ [kPa].
        cells: Bricks along x, y and z, of six tetrahedra each.
    """
    corners = [np.zeros(3), np.array([10.0, 1.0, 1.0])]
    mesh = dolfinx.mesh.create_box(comm, corners, cells)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (3,)))
    u = dolfinx.fem.Function(V)
    p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)))
    metadata = {"quadrature_degree": 4}
    F = kinematics.deformation_gradient(u)
    J = kinematics.jacobian(F)
    E = (J ** (-2 / 3) * kinematics.right_cauchy_green(F) - ufl.Identity(3)) / 2
    across = E[1, 1] ** 2 + E[2, 2] ** 2 + 2 * E[1, 2] ** 2
    exponent = 8 * E[0, 0] ** 2 + 2 * across + 8 * (E[0, 1] ** 2 + E[0, 2] ** 2)
    kappa_ = dolfinx.fem.Constant(mesh, float(kappa))
    psi = 1.0 * (ufl.exp(exponent) - 1) + materials.perturbed_lagrangian(J, p, kappa_)
    below = tagged(mesh, lambda x: np.isclose(x[2], 0.0))(1, metadata=metadata)
    clamped = [dirichlet(V, left)]
    return under_pressure(u, p, clamped, psi * ufl.dx(metadata=metadata), below, tangent)
