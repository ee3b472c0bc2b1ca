# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Files of walls for tests, written by the first process."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx_feti.meshes.tube import write_tube
from dolfinx_feti.runtime import collective
from dolfinx_feti.wall import Wall, read_wall

T = TypeVar("T")

COMM = MPI.COMM_WORLD
ROOT = Path(__file__).parents[2]
DEMOS = ROOT / "demos"
EXAMPLE = ROOT / "meshes/example.msh"


def on_first(make: Callable[[], T]) -> T:
    """Call a function on the first process; all return its result, or raise its error."""
    return collective.on_root(make, COMM)


def tube_wall(folder: Path, **options: object) -> Wall:
    """Write ``tube.msh`` into a folder with the options of ``write_tube``, and read it."""
    path = folder / "tube.msh"
    on_first(lambda: write_tube(path, **options))
    return read_wall(path, COMM)


def centroids(wall: Wall) -> npt.NDArray[np.float64]:
    """Return the centroids of the local cells, (cells, 3)."""
    geometry = wall.mesh.geometry
    dofs = geometry.dofmaps[0] if hasattr(geometry, "dofmaps") else geometry.dofmap
    return geometry.x[np.asarray(dofs)].mean(axis=1)
