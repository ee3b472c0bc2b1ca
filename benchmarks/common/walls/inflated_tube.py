# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A quarter of the two-layer tube at a given length, and its errors.

Its elements are those of :data:`ELEMENTS`: P2–P0 on tetrahedra with straight edges, and on curved
cells Q2–P1 and quadratic tetrahedra with bubbles, whose pressure is linear in each cell. The tube
slides in the planes of its ends and of symmetry, so that it remains a tube.
:mod:`benchmarks.common.walls.oracle` computes its radius, volume and stress.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
from scipy.interpolate import CubicSpline

import basix
import dolfinx
import ufl
from ufl.core.expr import Expr

from benchmarks.common.bodies import Body
from benchmarks.common.walls.oracle import Layer, Tube
from benchmarks.common.walls.problem import INTERFACE, create_wall_problem, tube_fibres
from dolfinx_feti import kinematics
from dolfinx_feti.fem.elements import quadratic_with_bubbles
from dolfinx_feti.mechanics.residual_stress import opening_deformation, residual_stretch
from dolfinx_feti.meshes.bricks import create_brick_tube
from dolfinx_feti.meshes.tube import ADVENTITIA, INNER_RADIUS, count_around
from dolfinx_feti.meshes.walls import create_tube_wall
from dolfinx_feti.output import Patches, balanced_stress, create_patches, recovered_field
from dolfinx_feti.runtime.arrays import Array, Numbers
from dolfinx_feti.wall import Wall, by_layer, facets
from dolfinx_feti.wall.fibres import ANGLES

#: Degree of the quadrature at whose points errors are measured.
QUADRATURE = 4
#: Length of the elements' edges to which the numbers of bricks refer [mm].
STANDARD = 0.09
#: Thickness of the outermost bricks of the media over that of the innermost ones.
GROWTH = 8.0


@dataclass(frozen=True, slots=True)
class Element:
    """A pair of elements, and the mesh of the tube that it is used on.

    ``bricks`` are the numbers of curved bricks through the media, through the adventitia and around
    a quarter at :data:`STANDARD` size; None for a tube of straight tetrahedra.
    """

    degree: int  # that of u; with bubbles half of the quadrature's
    pressures: tuple[str, int] = ("DG", 0)
    bricks: tuple[int, int, int] | None = None
    has_bubbles: bool = False  # in cells and on faces
    has_tetrahedra: bool = True  # or else hexahedra


#: Curved cells are longer around the wall and outside, where stresses vary less. With these numbers
#: no pair has more dofs than P2–P0.
ELEMENTS = {
    "p2-p0": Element(2),
    "q2-p1d": Element(2, ("DPC", 1), bricks=(5, 1, 8), has_tetrahedra=False),
    "p2b-p1d": Element(3, ("DG", 1), bricks=(5, 1, 4), has_bubbles=True),
}
OUTER_RADIUS = INTERFACE + ADVENTITIA

#: Surfaces of a quarter of a tube, and the component that is held there.
PLANES = {"opening_1": 2, "opening_2": 2, "symmetry_x": 0, "symmetry_y": 1}


@dataclass(frozen=True, slots=True)
class InflatedTube:
    """The problem of a tube, and its quadrature points, where errors are measured."""

    body: Body
    frame: tuple[Expr, Expr]  # e_r and e_θ in the reference
    patches: Patches | None  # to recover the stress of P2–P0; None for second-order elements
    points: Array  # of the quadrature in the reference cell, (points, 3)
    radii: Array  # of the quadrature points in the owned cells [mm], (cells, points)
    weights: Array  # volume of each of these points [mm³], (cells, points)
    layer: Numbers  # 0 for the cells of the media, 1 for the others, (cells,)

    @property
    def mesh(self) -> dolfinx.mesh.Mesh:
        """Mesh of the tube."""
        return self.body.u.function_space.mesh

    @property
    def recovered_stress(self) -> Expr:
        """The Cauchy stress, recovered with the normal of the deformed wall [kPa].

        Second-order elements keep their own stress, with a corrected pressure; see
        ``balanced_stress``.
        """
        normal = ufl.inv(kinematics.deformation_gradient(self.body.u)).T * self.frame[0]
        if self.patches is None:
            return balanced_stress(self.body.stress, self.body.u, normal=normal, degree=QUADRATURE)
        return recovered_field(self.body.stress, self.patches, normal=normal)

    def compare(self, truth: Tube) -> dict[str, float]:
        """Compare radius, thickness, volume and stress with the exact solution. Collective.

        Errors of stresses are in the L2 norm over the wall, relative to that of the exact solution.
        """
        inner, outer = (self._radial(radius) for radius in (INNER_RADIUS, OUTER_RADIUS))
        comm = self.mesh.comm
        J = self.at_points(kinematics.jacobian(kinematics.deformation_gradient(self.body.u)))
        return {
            "u_r_inner": float(inner.mean()),
            "u_r_inner_exact": float(truth.inner_displacement),
            "u_r_inner_error": float(np.abs(inner / truth.inner_displacement - 1.0).max()),
            "thickness": float(OUTER_RADIUS - INNER_RADIUS + outer.mean() - inner.mean()),
            "thickness_exact": float(truth.thickness),
            "min_J": comm.allreduce(float(J.min(initial=np.inf)), op=MPI.MIN),
            "max_J": comm.allreduce(float(J.max(initial=-np.inf)), op=MPI.MAX),
            "mean_J": self._integral(J) / self._integral(np.ones_like(J)),
            "mean_J_exact": float(truth.mean_jacobian),
            **self.stress_errors(truth, self.body.stress, "stress"),
            **self.stress_errors(truth, self.recovered_stress, "recovered"),
        }

    def stress_errors(self, truth: Tube, stress: Expr, name: str) -> dict[str, float]:
        """Return the relative errors of σ_rr and σ_θθ in the L2 norm. Collective.

        Args:
            truth: The exact solution.
            stress: Cauchy stress [kPa], (3, 3).
            name: Beginning of the keys of both errors.
        """
        errors = {}
        exact = _stresses(truth, self.radii, self.layer)
        for ending, e, there in zip(("rr", "tt"), self.frame, exact, strict=True):
            difference = self.at_points(ufl.inner(e, stress * e)) - there
            error, norm = (self._integral(values**2) for values in (difference, there))
            errors[f"{name}_{ending}_error"] = float(np.sqrt(error / norm))
        return errors

    def at_points(self, expression: Expr) -> Array:
        """Evaluate a scalar at the quadrature points, (cells, points). Collective."""
        return _at_points(expression, self.mesh, self.points)

    def _integral(self, values: Array) -> float:
        return self.mesh.comm.allreduce(float((self.weights * values).sum()))

    def _radial(self, radius: float) -> Array:
        """Return u_r of the nodes at a radius, on all processes; nodes on chords are left out."""
        V = self.body.u.function_space
        n = V.dofmap.index_map.size_local
        x = V.tabulate_dof_coordinates()[:n]
        u = self.body.u.x.array.reshape(-1, 3)[:n]
        r = np.hypot(x[:, 0], x[:, 1])
        outwards = np.einsum("ij,ij->i", x[:, :2], u[:, :2]) / r
        parts = V.mesh.comm.allgather(outwards[np.isclose(r, radius, rtol=1e-9)])
        return np.concatenate(parts)


def create_slice(comm: MPI.Comm, *, size: float, element: str = "p2-p0") -> Wall:
    """Mesh a quarter of a tube, one element long. Collective.

    Args:
        comm: Communicator.
        size: Length of the elements' edges [mm].
        element: A key of :data:`ELEMENTS`.
    """
    kind = ELEMENTS[element]
    if kind.bricks is not None:
        media, adventitia, around = (max(1, round(n * STANDARD / size)) for n in kind.bricks)
        return create_brick_tube(
            comm,
            length=size,
            size=size,
            quarter=True,
            around=around,
            along=1,
            through=(media, adventitia),
            growth=GROWTH,
            tetrahedra=kind.has_tetrahedra,
        )
    around = count_around(size, quarter=True)
    return create_tube_wall(comm, length=size, size=size, quarter=True, around=around)


def create_inflated_tube(wall: Wall, *, element: str = "p2-p0", **settings: object) -> InflatedTube:
    """Build the tube; PETSc options have the prefix ``tube_``.

    Args:
        wall: A wall of :func:`create_slice` with the same element.
        element: A key of :data:`ELEMENTS`.
        settings: Further arguments of :func:`create_wall_problem`; ``kappa`` and ``subdomains``
            are required.
    """
    mesh = wall.mesh
    kind = ELEMENTS[element]
    body = create_wall_problem(
        wall,
        degree=kind.degree,
        pressures=kind.pressures,
        element=quadratic_with_bubbles("tetrahedron", faces=True) if kind.has_bubbles else None,
        petsc_options={},
        prefix="tube_",
        fibres=tube_fibres(mesh) if kind.bricks is None else _helices(wall),
        supports=[(component, facets(wall, name)) for name, component in PLANES.items()],
        axis=(0.0, 0.0, 1.0),
        **settings,
    )
    r, e_r, e_t = _polar(mesh)
    cell = getattr(basix.CellType, mesh.topology.cell_name())
    points, weights = basix.make_quadrature(cell, QUADRATURE)
    volume = _at_points(abs(ufl.JacobianDeterminant(mesh)), mesh, points)
    layer = np.zeros(len(volume), dtype=np.int64)
    outer = wall.cell_tags.find(wall.layers["adventitia"])
    layer[outer[outer < len(layer)]] = 1
    is_straight = kind.bricks is None
    return InflatedTube(
        body,
        frame=(e_r, e_t),
        patches=create_patches(mesh, wall.cell_tags, degree=QUADRATURE) if is_straight else None,
        points=points,
        radii=_at_points(r, mesh, points),
        weights=volume * weights,
        layer=layer,
    )


def _polar(mesh: dolfinx.mesh.Mesh) -> tuple[Expr, Expr, Expr]:
    """Return the distance from the axis, e_r and e_θ at each point."""
    x = ufl.SpatialCoordinate(mesh)
    r = ufl.sqrt(x[0] ** 2 + x[1] ** 2)
    e_r = ufl.as_vector([x[0], x[1], 0.0]) / r
    e_t = ufl.as_vector([-x[1], x[0], 0.0]) / r
    return r, e_r, e_t


def _helices(wall: Wall) -> tuple[Expr, Expr]:
    """Return both families of fibres, unit vectors that vary inside the cells."""
    _, _, around = _polar(wall.mesh)
    α = by_layer(wall, {layer: np.deg2rad(angle) for layer, angle in ANGLES.items()})
    along = ufl.as_vector([0.0, 0.0, 1.0])
    return ufl.cos(α) * around + ufl.sin(α) * along, ufl.cos(α) * around - ufl.sin(α) * along


def residual_part(wall: Wall, layers: Sequence[Layer]) -> Expr:
    """Return G, the deformation without energy of media and adventitia, at each point.

    Args:
        wall: Mesh and tags.
        layers: Media and adventitia with their opening angles and stretches.
    """
    r, e_r, e_t = _polar(wall.mesh)
    values = [((part.inner + part.outer) / 2, part.opening, part.stretch) for part in layers]
    middle, angle, stretch = (
        by_layer(wall, dict(zip(("media", "adventitia"), column, strict=True)))
        for column in zip(*values, strict=True)
    )
    λ = residual_stretch(1 / middle, r - middle, angle, stretch)
    return opening_deformation([e_t, ufl.as_vector([0.0, 0.0, 1.0]), e_r], λ, stretch)


def _at_points(expression: Expr, mesh: dolfinx.mesh.Mesh, points: Array) -> Array:
    """Evaluate a scalar in the owned cells, (cells, points)."""
    owned = np.arange(mesh.topology.index_map(3).size_local, dtype=np.int32)
    values = dolfinx.fem.Expression(expression, points).eval(mesh, owned)
    return np.asarray(values).reshape(len(owned), len(points))


def _stresses(truth: Tube, r: Array, layer: Numbers) -> tuple[Array, Array]:
    """Return the exact σ_rr and σ_θθ at reference radii, from splines through each layer.

    Chords lie inside their circle, so some radii lie below a layer; its spline is continued there.
    """
    rr = np.zeros_like(r)
    tt = np.zeros_like(r)
    for i, part in enumerate(truth.wall.layers):
        R = np.linspace(part.inner, part.outer, 100)
        R[0] += 1e-9  # at an interface the oracle takes the inner layer
        values = CubicSpline(R, [truth.stress(x) for x in R])(r[layer == i])
        rr[layer == i], tt[layer == i] = np.moveaxis(values, -1, 0)
    return rr, tt
