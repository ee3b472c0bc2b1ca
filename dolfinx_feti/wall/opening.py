# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Residual stress of a wall whose layers, were they cut, would open by given angles.

:mod:`~dolfinx_feti.mechanics.residual_stress` has the equations. What they need of a wall of any
shape follows from the two potentials of its frame, t through the wall and l along it: the
directions ê₀, ê₁, ê₂ in each cell, the curvature around the vessel, κ = ê₀·(∇n ê₀), of the
transmural directions n at the vertices, and with t₀ of a layer's middle surface, a mean,

.. math:: ρ / ρ_0 = \exp\left(κ\, (t - t_0) / \|∇t\|\right) .

A tube has it exactly. Where κ is negative, as in a crotch, the wall counts as flat. The potentials
stay with the material when the mesh moves, and the rest is found anew.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

import dolfinx
import ufl

from dolfinx_feti.mechanics.residual_stress import opened, residual_stretch
from dolfinx_feti.mechanics.values import typed
from dolfinx_feti.wall.fibres import cell_mean, frame_of, gradient, potentials
from dolfinx_feti.wall.wall import Wall, by_layer

__all__ = ["Opening"]

#: Curvature times depth, at most: beyond, a bend counts like the inside of a thick tube.
MOST = 0.5


@typed
class Opening:
    """The part G of the deformation that opening angles stand for, on a wall of any shape.

    Attributes:
        G: The tensor in UFL, (3, 3), det G = 1, from the wall as meshed to the pieces without
            stress, for ``elastic_part`` and ``stress_free_direction``.
        curvature: κ, around the vessel [1/mm], in each cell.
        angle: Opening angle of each cell [degrees]; its values may change.
        middle: t of the middle surface of each cell's layer.
        directions: ê₀, ê₁ and ê₂ of the wall as meshed, vectors in each cell.
        potentials: t and l of the wall, see :func:`~dolfinx_feti.wall.fibres.potentials`.
    """

    def __init__(
        self,
        wall: Wall,
        angles: Mapping[str, float],
        stretches: Mapping[str, float] | None = None,
        **surfaces: Any,
    ) -> None:
        """Find the potentials. Collective.

        Args:
            wall: The wall.
            angles: Opening angle of each layer [degrees], below 360.
            stretches: Axial prestretch of each layer [-]; 1 if not given.
            surfaces: See :func:`~dolfinx_feti.wall.fibres.potentials`, whose errors are raised.

        Raises:
            ValueError: A layer has no angle or stretch, or one that is out of its range.
        """
        stretches = dict.fromkeys(wall.layers, 1.0) if stretches is None else stretches
        for name, angle in angles.items():
            residual_stretch(0.0, ufl.as_ufl(0.0), angle, stretches.get(name, 1.0))  # checks them
        self._wall = wall
        self.angle, stretch = by_layer(wall, angles), by_layer(wall, stretches)
        self.potentials = potentials(wall, **surfaces)
        Q = self.angle.function_space
        W = dolfinx.fem.functionspace(wall.mesh, ("DG", 0, (3,)))
        self.curvature = dolfinx.fem.Function(Q, name="curvature")
        self._thickness = dolfinx.fem.Function(Q)  # 1/|∇t|
        self.middle = by_layer(wall, self._means())
        self.directions = [dolfinx.fem.Function(W) for _ in range(3)]
        depth = (self.potentials[0] - self.middle) * self._thickness
        λ = residual_stretch(1.0, ufl.exp(self.curvature * depth) - 1, self.angle, stretch)
        self.G = opened(self.directions, λ, stretch)
        self.update()

    def update(self) -> None:
        """Find directions, slopes and curvatures of the mesh as it is. Collective."""
        frame = frame_of(self._wall, *self.potentials)
        directions = (frame.circumferential, frame.longitudinal, frame.transmural)
        for mine, e in zip(self.directions, directions, strict=True):
            mine.x.array[:] = e.x.array
        size = np.linalg.norm(gradient(self.potentials[0]), axis=1)
        self._thickness.x.array[:] = 1.0 / np.maximum(size, cell_mean(self._wall, size) / 4.0)
        e0 = frame.circumferential.x.array.reshape(-1, 3)
        around = np.einsum("ci,cij,cj->c", e0, gradient(self._normals()), e0)
        most = 2.0 * MOST / self._thickness.x.array
        self.curvature.x.array[:] = np.clip(around, 0.0, most)

    def _means(self) -> dict[str, float]:
        """Return the mean of t in each layer, weighted by ‖∇t‖^½.

        So weighted it is t at the middle radius of a tube, up to (h/ρ₀)⁴.
        """
        wall, t = self._wall, self.potentials[0]
        metadata = {"quadrature_degree": 4}
        dx = ufl.Measure("dx", wall.mesh, subdomain_data=wall.cell_tags, metadata=metadata)
        weight = ufl.inner(ufl.grad(t), ufl.grad(t)) ** 0.25
        means = {}
        for name, tag in wall.layers.items():
            forms = [dolfinx.fem.form(f * dx(tag)) for f in (t * weight, weight)]
            mine = np.array([float(dolfinx.fem.assemble_scalar(form)) for form in forms])
            total, size = wall.mesh.comm.allreduce(mine)
            means[name] = float(total / size)
        return means

    def _normals(self) -> dolfinx.fem.Function:
        """Return the transmural directions at the vertices, unit vectors (P1)."""
        V = dolfinx.fem.functionspace(self._wall.mesh, ("Lagrange", 1, (3,)))
        n, slope = dolfinx.fem.Function(V), ufl.grad(self.potentials[0])
        dx = ufl.dx(metadata={"quadrature_rule": "vertex", "quadrature_degree": 1})
        sums = dolfinx.fem.assemble_vector(
            dolfinx.fem.form(ufl.inner(slope, ufl.TestFunction(V)) * dx)
        )
        sums.scatter_reverse(dolfinx.la.InsertMode.add)
        n.x.array[:] = sums.array
        n.x.scatter_forward()
        at = n.x.array.reshape(-1, 3)
        at /= np.maximum(np.linalg.norm(at, axis=1, keepdims=True), np.finfo(float).tiny)
        return n
