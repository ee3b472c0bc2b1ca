# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""States with known values, and checkpoints of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from collective import COMM, agree, equal
from problems import cube
from wall_files import on_first

import dolfinx

from dolfinx_feti.loading.checkpoint import Checkpoint

PARAMETERS = {"kappa": 1000.0, "layers": [29, 62], "law": "HGO"}
ROUNDING = 1e-14


class Fields:
    """A quadratic vector and a number for each cell, in a cube."""

    def __init__(self, n: int = 2, *, degree: int = 2, scale: float = 1.0) -> None:
        mesh = cube(3, n)
        mesh.geometry.x[:] *= scale
        V = dolfinx.fem.functionspace(mesh, ("Lagrange", degree, (3,)))
        Q = dolfinx.fem.functionspace(mesh, ("DG", 0))
        self.functions = [dolfinx.fem.Function(V), dolfinx.fem.Function(Q)]

    def set(self, t: float) -> list[np.ndarray]:
        """Give the functions known values, and return them."""
        u, p = self.functions
        u.interpolate(lambda x: np.stack([x[0] ** 2, t + x[1] * x[2], 1 - t * x[2]]))
        p.interpolate(lambda x: t - x[0] + 2 * x[1])
        return [f.x.array.copy() for f in self.functions]


def opened(folder: Path, restart: bool = True, **other: object) -> Checkpoint:
    return Checkpoint(folder, COMM, parameters=PARAMETERS | other, restart=restart)


def written(folder: Path, state: Fields, *times: float) -> Checkpoint:
    """Write the states of some times, and leave the functions at zero."""
    checkpoint = opened(folder, restart=False)
    for t in times:
        state.set(t)
        checkpoint.write(state.functions, {"t": t})
    for f in state.functions:
        f.x.array[:] = 0.0
    return checkpoint


def check(folder: Path, state: Fields, t: float) -> None:
    """The folder holds the state of one time, on this number of processes."""
    checkpoint = opened(folder)
    past = checkpoint.read(state.functions)
    found = [f.x.array.copy() for f in state.functions]
    agree(past == [] and checkpoint.record == {"t": t}, checkpoint.record)
    for actual, expected in zip(found, state.set(t), strict=True):
        equal(actual, expected, ROUNDING)


def content(folder: Path) -> dict[str, bytes]:
    return on_first(
        lambda: {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*.*[!p]")}
    )
