# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The two-layer tube and vessel, P_k–P0, clamped at their openings, with about so many dofs.

``subdomains`` is their number over all processes, None for the package's rule; ``options`` are
PETSc options, with the prefix ``tube_`` or ``vessel_``. All functions are collective.
"""

from __future__ import annotations

from pathlib import Path

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import dolfinx

from benchmarks.common.walls.problem import WallProblem, create_wall_problem
from dolfinx_feti import materials
from dolfinx_feti.wall.fibres import ANGLES
from meshes.tube import INNER_RADIUS, MEDIA
from meshes.walls import create_tube_wall, open_wall

__all__ = [
    "FIRST_PRESSURE",
    "INTERFACE",
    "create_clamped_tube",
    "create_clamped_vessel",
    "tube_fibres",
]

LENGTH = 3.0  # mm, of the tube
INTERFACE = INNER_RADIUS + MEDIA  # mm, between its layers

#: Displacement dofs of the tube over the square of its elements along the axis, by degree.
DOFS_ALONG = {1: 18.0, 2: 125.0}

#: Length of the elements' edges [mm] that gives the vessel so many displacement dofs, by degree.
SIZE, DOFS = 2.0, {1: 11_000, 2: 71_430}

#: Pressure of a first Newton step of the vessel [mmHg]. Under a larger one the tangent of the thin
#: wall at rest is indefinite without the tension that the pressure makes.
FIRST_PRESSURE = 0.01


def create_clamped_tube(
    comm: MPI.Comm,
    *,
    dofs: int,
    kappa: float,
    subdomains: int | None,
    options: dict[str, object],
    degree: int = 2,
) -> WallProblem:
    """Build the tube at rest, with three elements through its wall."""
    along = max(2, round(np.sqrt(dofs / DOFS_ALONG[degree])))
    wall = create_tube_wall(comm, length=LENGTH, through=(2, 1), around=3 * along // 2, along=along)
    return create_wall_problem(
        wall,
        degree=degree,
        c=materials.ArteryParameters().c,
        kappa=kappa,
        subdomains=subdomains,
        options=options,
        prefix="tube_",
        fibres=tube_fibres(wall.mesh),
    )


def create_clamped_vessel(
    comm: MPI.Comm,
    *,
    dofs: int,
    kappa: float,
    subdomains: int | None,
    options: dict[str, object],
    folder: Path,
    degree: int = 2,
) -> WallProblem:
    """Build the vessel at rest, with one element through each layer.

    Its mesh is kept in a folder.

    Raises:
        ValueError: For less than 50 000 dofs the elements would be too long for a wall of 1 mm.
    """
    size = SIZE * (DOFS[degree] / dofs) ** 0.5  # it is a surface
    wall, _ = open_wall("vessel", comm, size=size, folder=folder)
    return create_wall_problem(
        wall,
        degree=degree,
        c=materials.ArteryParameters().c,
        kappa=kappa,
        subdomains=subdomains,
        options=options,
        prefix="vessel_",
    )


def tube_fibres(mesh: dolfinx.mesh.Mesh) -> tuple[dolfinx.fem.Function, dolfinx.fem.Function]:
    """Return the two families of helices of a tube, constant in each cell."""
    space = dolfinx.fem.functionspace(mesh, ("DG", 0, (3,)))
    a1, a2 = dolfinx.fem.Function(space), dolfinx.fem.Function(space)
    a1.interpolate(lambda x: _helix(x, 1.0))
    a2.interpolate(lambda x: _helix(x, -1.0))
    return a1, a2


def _helix(x: npt.NDArray[np.float64], sign: float) -> npt.NDArray[np.float64]:
    """Return cos α e_θ ± sin α e_z, (3, n)."""
    r = np.hypot(x[0], x[1])
    α = np.deg2rad(np.where(r < INTERFACE, ANGLES["media"], ANGLES["adventitia"]))
    return np.array([-x[1] / r * np.cos(α), x[0] / r * np.cos(α), sign * np.sin(α)])
