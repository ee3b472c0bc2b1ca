# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The two-layer tube: its fibres, and a clamped one with about a given number of dofs."""

from __future__ import annotations

from collections.abc import Callable

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import dolfinx

from benchmarks.walls.problem import WallProblem, create_wall_problem
from dolfinx_feti import materials
from dolfinx_feti.wall.fibres import ANGLES
from meshes.tube import INNER_RADIUS, MEDIA
from meshes.walls import create_tube_wall

__all__ = ["INTERFACE", "create_clamped_tube", "tube_fibres"]

LENGTH = 3.0  # mm
INTERFACE = INNER_RADIUS + MEDIA  # mm


def create_clamped_tube(
    comm: MPI.Comm, *, dofs: int, kappa: float, subdomains: int | None, options: dict[str, object]
) -> WallProblem:
    """Build the tube at rest, P2–P0, clamped at its ends.

    Args:
        comm: Communicator of the mesh.
        dofs: Wanted number of displacement dofs; three elements through the wall.
        kappa: κ [kPa].
        subdomains: Number of subdomains; None for the package's rule.
        options: PETSc options of the problem, prefix ``tube_``.

    Note:
        Collective.
    """
    along = max(2, round(np.sqrt(dofs / 125.0)))
    wall = create_tube_wall(comm, length=LENGTH, through=(2, 1), around=3 * along // 2, along=along)
    return create_wall_problem(
        wall,
        degree=2,
        c=materials.ArteryParameters().c,
        kappa=kappa,
        subdomains=subdomains,
        options=options,
        prefix="tube_",
        fibres=tube_fibres(wall.mesh),
    )


def tube_fibres(mesh: dolfinx.mesh.Mesh) -> tuple[dolfinx.fem.Function, dolfinx.fem.Function]:
    """Return the two families of helices, constant in each cell."""
    space = dolfinx.fem.functionspace(mesh, ("DG", 0, (3,)))
    a1, a2 = dolfinx.fem.Function(space), dolfinx.fem.Function(space)
    a1.interpolate(_helix(1.0))
    a2.interpolate(_helix(-1.0))
    return a1, a2


def _helix(sign: float) -> Callable[[npt.NDArray[np.float64]], npt.NDArray[np.float64]]:
    def direction(x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        r = np.hypot(x[0], x[1])
        α = np.deg2rad(np.where(r < INTERFACE, ANGLES["media"], ANGLES["adventitia"]))
        return np.array([-x[1] / r * np.cos(α), x[0] / r * np.cos(α), sign * np.sin(α)])

    return direction
