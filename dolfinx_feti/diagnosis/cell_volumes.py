# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Inverted and distorted cells: detection between the quadrature points, and advice.

Newton's method keeps det F positive at the quadrature points only. Between them an accurate
displacement may turn part of a cell inside out, even if it preserves the mean volume of every cell.
Stresses there have no meaning.

Elements of second order help (docs/results/distorted_cells.md), except at the rim of a clamp, where
F is singular for any element and mesh.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import dolfinx

from dolfinx_feti.diagnosis.advice import Advice
from dolfinx_feti.fem.cell_samples import CellValues
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import bounding_box, total_of

__all__ = ["CellVolumes"]

#: Smallest det F over its mean in the cell, below which the cell is distorted. Away from clamps,
#: cells of Q2–P1disc stay above 0.9, and those of P2–P0 above 0.6
#: (docs/results/distorted_cells.md): a bound above 0.6 would warn of sound P2–P0 cells. A bound of
#: 0.25 would warn only of cells that are about to turn inside out.
MIN_RATIO = 0.5

#: Largest det F over its mean in the cell, above which the cell is distorted. Away from clamps,
#: cells of Q2–P1disc stay below 1.2, and those of P2–P0 below 1.5.
MAX_RATIO = 2.0

#: Share of the cells that may be distorted without a warning. A few cells at a corner of a load or
#: a support are distorted on any mesh. In an inflated tube with clamped ends 2 to 4 % of the cells
#: of P2–P0 are.
MAX_SHARE_DISTORTED = 1e-3

#: Advice on bad cells with a node at which all components of the displacement are prescribed.
CLAMPED = (
    "At a clamp det F degenerates with any element and on any mesh: support the body by soft "
    "springs, let it slide, or evaluate no stress in the cells next to the clamp."
)

#: Advice on bad cells away from clamps, if the pressure is constant in each cell.
SECOND_ORDER = (
    "Use elements of second order, which preserve the volume within the cells: Q2 with DPC 1, or "
    "P2 with bubbles and a linear pressure on a mesh as fine (docs: Which elements?)."
)

#: Advice on bad cells away from clamps, for all other elements.
REFINE = (
    "Refine the mesh there, and spread loads that end or change abruptly; a higher quadrature "
    "degree does not help."
)

#: Coordinates of a point, as many as the mesh has; none without a point.
Point: TypeAlias = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class CellVolumes:
    """Volume changes of the cells in a state. The same on all processes.

    The points are those of the quadrature, vertices, and midpoints of edges, faces and cells. A
    cell is *inverted*, inside out, if det F is not positive at one of them. It is *distorted* if it
    is inverted, or if det F is below half or above twice its mean over the cell at one of them.

    Attributes:
        name: The quantity: ``det F``, or ``volume_ratio`` if the user gave that argument.
        least: Its smallest value.
        greatest: Its largest value.
        cells: Number of cells.
        inverted: Number of inverted cells.
        distorted: Number of distorted cells. If the ``volume_ratio`` is not a determinant, only its
            sign has a meaning, and this is the number of inverted cells.
        clamped: Number of bad cells with a node at which all components of the displacement are
            prescribed. Bad cells are the inverted ones, or the distorted ones if none is inverted.
        worst: Midpoint of the cell with the smallest value, in the mesh's unit of length.
        low: Lower corner of the box around the midpoints of the bad cells; empty without any.
        high: Upper corner of that box.
    """

    name: str
    least: float
    greatest: float
    cells: int
    inverted: int
    distorted: int
    clamped: int
    worst: Point
    low: Point
    high: Point

    @property
    def share_distorted(self) -> float:
        """Share of the cells that are distorted."""
        return self.distorted / max(1, self.cells)

    @property
    def is_sound(self) -> bool:
        """True if no cell is inverted and at most one in a thousand is distorted."""
        return self.inverted == 0 and self.share_distorted <= MAX_SHARE_DISTORTED

    @property
    def bad(self) -> int:
        """Number of inverted cells, or of distorted ones if none is inverted."""
        return self.inverted or self.distorted

    def __str__(self) -> str:
        """Return the range of det F, how many cells are bad, and where they are."""
        text = f"{self.name} is {self.least:.3g} to {self.greatest:.3g} in {self.cells} cells"
        if self.inverted:
            text += f", and not positive in {self.inverted} cells, which are inside out"
        elif self.distorted:
            text += (
                f", and below {MIN_RATIO:g} or above {MAX_RATIO:g} times its mean in "
                f"{self.distorted} cells"
            )
        if self.bad == 1:
            text += f", at {_place(self.low)}"
        elif self.bad:
            where = f"{_place(self.low)} and {_place(self.high)}"
            text += f", the worst at {_place(self.worst)} and all between {where}"
        return text


def summarise_volumes(
    values: CellValues,
    mesh: dolfinx.mesh.Mesh,
    *,
    name: str,
    is_determinant: bool,
    has_clamped_node: npt.NDArray[np.bool_],
) -> CellVolumes:
    """Summarise the volume ratios of all cells of a mesh. Collective.

    Args:
        values: Volume ratios in the owned cells.
        mesh: The mesh.
        name: The quantity, ``det F`` or ``volume_ratio``.
        is_determinant: Whether the values are changes of volume. If not, only their sign has a
            meaning, and only inverted cells count as distorted.
        has_clamped_node: Mask of the owned cells with a node at which all components of the
            displacement are prescribed, (n_cells,).
    """
    comm = mesh.comm
    with np.errstate(invalid="ignore"):
        is_inverted = ~(values.minimum > 0.0)  # also if it is NaN
        is_distorted = is_inverted.copy()
        if is_determinant:
            is_distorted |= ~(values.minimum >= MIN_RATIO * values.mean)
            is_distorted |= ~(values.maximum <= MAX_RATIO * values.mean)
    n_inverted = int(comm.allreduce(int(is_inverted.sum())))
    is_bad = is_inverted if n_inverted else is_distorted
    counts = [len(is_bad), is_distorted.sum(), (is_bad & has_clamped_node).sum()]
    n_cells, n_distorted, n_clamped = map(int, total_of(np.array(counts, dtype=float), comm))
    low: Point = ()
    high: Point = ()
    if n_inverted or n_distorted:
        lower, upper = bounding_box(_midpoints(mesh, np.flatnonzero(is_bad)), comm)
        low = _point(lower, mesh)
        high = _point(upper, mesh)
    least, worst = _worst_cell(values, mesh)
    greatest = np.where(np.isfinite(values.maximum), values.maximum, np.inf)
    return CellVolumes(
        name=name,
        least=least,
        greatest=comm.allreduce(float(greatest.max(initial=-np.inf)), op=MPI.MAX),
        cells=n_cells,
        inverted=n_inverted,
        distorted=n_distorted,
        clamped=n_clamped,
        worst=worst,
        low=low,
        high=high,
    )


def _worst_cell(values: CellValues, mesh: dolfinx.mesh.Mesh) -> tuple[float, Point]:
    """Return the smallest value of all cells, and the midpoint of its cell. Collective."""
    least = np.where(np.isfinite(values.minimum), values.minimum, -np.inf)
    here: tuple[float, Point] = (np.inf, ())
    if len(least):
        worst = np.argmin(least, keepdims=True)
        here = (float(least[worst[0]]), _point(_midpoints(mesh, worst)[0], mesh))
    return min(mesh.comm.allgather(here), key=lambda pair: pair[0])


def advise_on_volumes(volumes: CellVolumes, *, has_constant_pressure: bool) -> list[Advice]:
    """Return advice on cells that are inverted or distorted; none if the state is sound.

    Args:
        volumes: The volumes of the cells.
        has_constant_pressure: Whether a condensed field is constant in each cell, as in P2–P0. It
            constrains only the mean volume of a cell.
    """
    if volumes.is_sound:
        return []
    what = f"cells where {volumes.name} is not positive"
    if not volumes.inverted:
        what = f"cells where {volumes.name} is far from its mean"
    advice = []
    if volumes.clamped:
        advice.append(Advice(CLAMPED, f"{what}, at a clamp", volumes.clamped, 0))
    elsewhere = volumes.bad - volumes.clamped
    if elsewhere:
        text = SECOND_ORDER if has_constant_pressure else REFINE
        advice.append(Advice(text, what, elsewhere, 0))
    return advice


def _midpoints(mesh: dolfinx.mesh.Mesh, cells: npt.NDArray[Any]) -> Array:
    """Return the midpoints of owned cells, (cells, 3)."""
    if not len(cells):
        return np.zeros((0, 3))
    dim = mesh.topology.dim
    return np.asarray(dolfinx.mesh.compute_midpoints(mesh, dim, cells.astype(np.int32)))


def _point(x: Array, mesh: dolfinx.mesh.Mesh) -> Point:
    """Return a point, (3,), as a tuple with as many coordinates as the mesh has."""
    return tuple(map(float, x[: mesh.geometry.dim]))


def _place(point: Sequence[float]) -> str:
    """Return a point as text."""
    return "(" + ", ".join(f"{x:.3g}" for x in point) + ")"
