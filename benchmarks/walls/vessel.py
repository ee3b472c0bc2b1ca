# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The two-layer vessel, clamped at its openings, with about a given number of dofs."""

from __future__ import annotations

from pathlib import Path

from mpi4py import MPI

from benchmarks.walls.problem import WallProblem, create_wall_problem
from dolfinx_feti import materials
from meshes.walls import create_wall

__all__ = ["FIRST_PRESSURE", "create_clamped_vessel"]

#: Length of the elements' edges [mm] that gives so many displacement dofs, P2.
SIZE, DOFS = 2.0, 71_430

#: Pressure of a first Newton step from rest [mmHg]. Under a larger one the tangent of the thin wall
#: is indefinite without the tension that the pressure makes.
FIRST_PRESSURE = 0.01


def create_clamped_vessel(
    comm: MPI.Comm,
    *,
    dofs: int,
    kappa: float,
    subdomains: int | None,
    options: dict[str, object],
    folder: Path,
) -> WallProblem:
    """Build the vessel at rest, P2–P0, clamped at its openings.

    Args:
        comm: Communicator of the mesh.
        dofs: Wanted number of displacement dofs, 50 000 or more; one element through each layer.
        kappa: κ [kPa].
        subdomains: Number of subdomains; None for the package's rule.
        options: PETSc options of the problem, prefix ``vessel_``.
        folder: Where meshes are kept.

    Raises:
        ValueError: The elements would be too long for a wall of 1 mm.

    Note:
        Collective.
    """
    size = SIZE * (DOFS / dofs) ** 0.5  # it is a surface
    wall, _ = create_wall("vessel", comm, size=size, folder=folder)
    return create_wall_problem(
        wall,
        degree=2,
        c=materials.ArteryParameters().c,
        kappa=kappa,
        subdomains=subdomains,
        options=options,
        prefix="vessel_",
    )
