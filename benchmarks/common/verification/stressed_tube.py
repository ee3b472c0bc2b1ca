# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A quarter of the inflated tube with residual stress, to 100 mmHg.

The media opens by 160 degrees, the adventitia by 60, and they are stretched by 5 and 2 % along the
axis.
"""

from __future__ import annotations

from dataclasses import replace

from mpi4py import MPI

from ufl.core.expr import Expr

from benchmarks.common.verification.body import Body
from benchmarks.common.walls.inflated_tube import (
    create_inflated_tube,
    create_slice,
    residual_part,
)
from benchmarks.common.walls.oracle import KPA_PER_MMHG, LAYERS, Wall, inflate
from benchmarks.common.walls.problem import PLANES
from dolfinx_feti.wall import Wall as Mesh
from dolfinx_feti.wall import facets
from dolfinx_feti.wall.opening import Opening

__all__ = ["create_stressed_tube"]

PRESSURE = 100.0 * KPA_PER_MMHG
KAPPA = 1e5  # kPa
MEDIA, ADVENTITIA = (
    replace(layer, opening=angle, stretch=stretch)
    for layer, angle, stretch in zip(LAYERS, (160.0, 60.0), (1.05, 1.02), strict=True)
)


def create_stressed_tube(
    comm: MPI.Comm, *, size: float, subdomains: int = 4, by_shape: bool = False
) -> Body:
    """Build the tube with bricks of a size [mm]; G at each point, or found from its shape."""
    layers = (MEDIA, ADVENTITIA)
    element = "q2-p1d"
    wall = create_slice(comm, size=size, element=element)
    G = _by_shape(wall) if by_shape else residual_part(wall, layers)
    tube = create_inflated_tube(
        wall, c=3.0, kappa=KAPPA, subdomains=subdomains, element=element, G=G
    )
    body = tube.body
    truth = inflate(PRESSURE, Wall(kappa=KAPPA, layers=layers))

    def measure() -> dict[str, float]:
        found = tube.compare(truth)
        return {
            "u_r": found["u_r_inner"] / found["u_r_inner_exact"],
            "hoop": found["recovered_tt_error"],
            "radial": found["recovered_rr_error"],
        }

    def set_load(share: float) -> None:
        body.pressure.value = share * PRESSURE

    held = [(component, facets(wall, name)) for name, component in PLANES.items()]
    residuals = (body.residual, body.constraint)
    return Body(body.u, body.p, residuals, held, body.problem, set_load, measure)


def _by_shape(wall: Mesh) -> Expr:
    """Return the G that the package finds for a wall of any shape."""
    layers = {"media": MEDIA, "adventitia": ADVENTITIA}
    angles = {name: layer.opening for name, layer in layers.items()}
    return Opening(wall, angles, {name: layer.stretch for name, layer in layers.items()}).G
