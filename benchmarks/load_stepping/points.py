# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Five points of a wall, A to E, at which displacement and stress are followed."""

from __future__ import annotations

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import dolfinx

from benchmarks.common.walls.problem import WallProblem
from dolfinx_feti import kinematics
from dolfinx_feti.output import cell_values

__all__ = ["NAMES", "at_points", "five_points"]

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

NAMES = "ABCDE"


def five_points(mesh: dolfinx.mesh.Mesh) -> list[Indices]:
    """Choose five cells far from each other; return which of this process's cells each is, or none.

    The first is the one farthest from the centre of the mesh, each further one the one farthest
    from those before it.

    Collective.
    """
    n = mesh.topology.index_map(3).size_local
    X = dolfinx.mesh.compute_midpoints(mesh, 3, np.arange(n, dtype=np.int32))
    count, total = mesh.comm.allreduce(n), mesh.comm.allreduce(X.sum(axis=0))
    distance = np.linalg.norm(X - total / count, axis=1)
    points = []
    for _ in NAMES:
        best = (float(distance.max(initial=-1.0)), -mesh.comm.rank)
        owner = -mesh.comm.allreduce(best, op=MPI.MAX)[1]
        mine = [int(distance.argmax())] if mesh.comm.rank == owner else []
        points.append(np.array(mine, dtype=np.int64))
        x = mesh.comm.bcast(X[mine[0]] if mine else None, root=owner)
        nearest = np.linalg.norm(X - x, axis=1)
        distance = nearest if len(points) == 1 else np.minimum(distance, nearest)
    return points


def at_points(body: WallProblem, points: Sequence[Indices]) -> tuple[Array, Array]:
    """Return u_norm [mm] (eq. 57) and σ_mag [kPa] at the points, on all processes. Collective."""
    mesh = body.u.function_space.mesh
    norm = np.linalg.norm(cell_values(body.u, mesh), axis=1)
    stress = cell_values(kinematics.stress_magnitude(body.stress), mesh)
    own = np.array([[norm[cell].sum(), stress[cell].sum()] for cell in points])
    return tuple(mesh.comm.allreduce(own).T)
