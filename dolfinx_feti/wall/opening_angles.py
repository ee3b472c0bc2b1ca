# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Residual stress of a wall whose layers would open by known angles if they were cut.

The openings of a wall, the faces where the vessel was cut, have nothing to do with these angles.

:mod:`~dolfinx_feti.mechanics.residual_stress` has the equations. Their data on a wall of any shape
follow from the two potentials of its frame, t through the wall and l along it:

- the directions ê₀, ê₁, ê₂ in each cell,
- the curvature around the vessel, c = ê₀·(∇n ê₀), with the transmural directions n at the vertices,
- the thickness :math:`h = 1/|∇t|`,
- with the mean t₀ of t in a layer, the ratio of radii

.. math:: ρ / ρ_0 = \exp\left(c\, h\, (t - t_0)\right) ,

which is exact for a tube. Where c is negative, as in a crotch, the wall counts as flat. If the mesh
moves, the potentials stay with the material, and everything else is computed again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

import dolfinx
import ufl

from dolfinx_feti.mechanics.residual_stress import (
    check_opening,
    opening_deformation,
    residual_stretch,
)
from dolfinx_feti.runtime.values import require_type
from dolfinx_feti.wall.fibres import cell_mean, frame_of, solve_potentials
from dolfinx_feti.wall.laplace import gradient
from dolfinx_feti.wall.wall import Wall, by_layer

__all__ = ["OpeningAngles"]

#: Upper bound of c h, curvature times thickness. A sharper bend counts as a tube whose middle
#: radius is the thickness; the inner radius of such a tube is h/2.
MAX_CURVATURE_TIMES_THICKNESS = 1.0

#: Lower bound of |∇t| over its mean in the wall, so that the thickness 1/|∇t| is finite where the
#: gradient vanishes, as at a stagnation point. A choice that was not measured.
MIN_GRADIENT_FOR_THICKNESS = 0.25


class OpeningAngles:
    """The part G of the deformation due to opening angles, on a wall of any shape.

    Attributes:
        G: The tensor in UFL, (3, 3), det G = 1, from the wall as meshed to the pieces without
            stress, for ``elastic_part`` and ``stress_free_direction``.
        curvature: c, around the vessel [1/mm], in each cell.
        angle: Opening angle of each cell [degrees]. The user may change its values between solves;
            they are not checked then.
        middle: t of the middle surface of each cell's layer.
        directions: ê₀, ê₁ and ê₂ of the wall as meshed, vectors in each cell.
        potentials: t and l of the wall.
    """

    def __init__(
        self,
        wall: Wall,
        angles: Mapping[str, float],
        stretches: Mapping[str, float] | None = None,
        *,
        inner: str = "lumen",
        outer: str = "outer",
        ends: Sequence[str] | None = None,
        inlet: str | None = None,
    ) -> None:
        """Compute the potentials and G. Collective.

        Args:
            wall: The wall.
            angles: Opening angle of each layer [degrees], below 360.
            stretches: Axial prestretch of each layer [-]; 1 if not given.
            inner: The surface at t = 0.
            outer: The surface at t = 1.
            ends: The openings; those named `opening_…` if not given.
            inlet: The opening at l = 0; the one with the largest area if not given.

        Raises:
            ValueError: A layer has no angle or stretch, or one out of its range, there are fewer
                than two openings, or there is no such surface or inlet.
            ArithmeticError: A Laplace problem was not solved.
        """
        require_type(Wall, wall=wall)
        stretches = dict.fromkeys(wall.layers, 1.0) if stretches is None else stretches
        for name, angle in angles.items():
            check_opening(angle, stretches.get(name, 1.0))
        self._wall = wall
        self.angle = by_layer(wall, angles)
        stretch = by_layer(wall, stretches)
        self.potentials = solve_potentials(wall, inner=inner, outer=outer, ends=ends, inlet=inlet)
        Q = self.angle.function_space
        W = dolfinx.fem.functionspace(wall.mesh, ("DG", 0, (3,)))
        self.curvature = dolfinx.fem.Function(Q, name="curvature")
        self._thickness = dolfinx.fem.Function(Q)  # 1/|∇t|
        self.middle = by_layer(wall, self._middles())
        self.directions = [dolfinx.fem.Function(W) for _ in range(3)]
        depth = (self.potentials.through - self.middle) * self._thickness
        ratio = ufl.exp(self.curvature * depth)  # ρ/ρ₀
        # in units of ρ₀, a curvature of 1/ρ₀ is 1, and a depth of ρ − ρ₀ is ρ/ρ₀ − 1
        λ = residual_stretch(1.0, ratio - 1, self.angle, stretch)
        self.G = opening_deformation(self.directions, λ, stretch)
        self.update()

    def update(self) -> None:
        """Compute directions, gradients and curvatures for the current mesh. Collective."""
        frame = frame_of(self._wall, self.potentials)
        directions = (frame.circumferential, frame.longitudinal, frame.transmural)
        for target, e in zip(self.directions, directions, strict=True):
            target.x.array[:] = e.x.array
        slope = np.linalg.norm(gradient(self.potentials.through), axis=1)  # |∇t|
        min_slope = MIN_GRADIENT_FOR_THICKNESS * cell_mean(self._wall, slope)
        self._thickness.x.array[:] = 1.0 / np.maximum(slope, min_slope)
        e0 = frame.circumferential.x.array.reshape(-1, 3)
        around = np.einsum("ci,cij,cj->c", e0, gradient(self._normals()), e0)
        largest = MAX_CURVATURE_TIMES_THICKNESS / self._thickness.x.array
        self.curvature.x.array[:] = np.clip(around, 0.0, largest)  # 0: negative ones count as flat

    def _middles(self) -> dict[str, float]:
        """Return t of the middle surface of each layer. Collective.

        It is the mean of t weighted by |∇t|^½: in a tube, t at the middle radius up to (h/ρ₀)⁴.
        """
        wall = self._wall
        t = self.potentials.through
        metadata = {"quadrature_degree": 4}
        dx = ufl.Measure("dx", wall.mesh, subdomain_data=wall.cell_tags, metadata=metadata)
        weight = ufl.inner(ufl.grad(t), ufl.grad(t)) ** 0.25
        middles = {}
        for name, tag in wall.layers.items():
            forms = [dolfinx.fem.form(f * dx(tag)) for f in (t * weight, weight)]
            local = np.array([float(dolfinx.fem.assemble_scalar(form)) for form in forms])
            integral, total_weight = wall.mesh.comm.allreduce(local)
            middles[name] = float(integral / total_weight)
        return middles

    def _normals(self) -> dolfinx.fem.Function:
        """Return the transmural directions at the vertices, unit vectors (P1)."""
        V = dolfinx.fem.functionspace(self._wall.mesh, ("Lagrange", 1, (3,)))
        n = dolfinx.fem.Function(V)
        slope = ufl.grad(self.potentials.through)
        # the vertex rule gives each vertex the gradients of its cells, weighted by their volumes
        dx = ufl.dx(metadata={"quadrature_rule": "vertex", "quadrature_degree": 1})
        sums = dolfinx.fem.assemble_vector(
            dolfinx.fem.form(ufl.inner(slope, ufl.TestFunction(V)) * dx)
        )
        sums.scatter_reverse(dolfinx.la.InsertMode.add)
        n.x.array[:] = sums.array
        n.x.scatter_forward()
        normals = n.x.array.reshape(-1, 3)
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        normals /= np.maximum(lengths, np.finfo(float).tiny)
        return n
