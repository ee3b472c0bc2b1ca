# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Directions of the collagen fibres from two Laplace problems and an angle.

Two potentials, with zero flux through all other surfaces, are

- t, through the wall: 0 on the lumen, 1 on the outer wall,
- l, along the wall: 0 on the inlet, 1 on the other openings.

In each cell the orthonormal, right-handed frame is (after Bayer et al. 2012)

.. math:: \hat e_2 = \frac{∇t}{|∇t|}, \qquad
    \hat e_1 = \frac{∇l - (∇l·\hat e_2)\, \hat e_2}{|∇l - (∇l·\hat e_2)\, \hat e_2|}, \qquad
    \hat e_0 = \hat e_1 × \hat e_2 ,

transmural, longitudinal and circumferential; in a tube along z it is (e_r, e_z, e_θ). The two
families have the directions cos α ê₀ ± sin α ê₁. (Those of eq. 55 of the paper are orthogonal:
``docs/equations.md``.) The potentials are P2; their gradients are those at the centroids.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

import dolfinx

from dolfinx_feti.runtime.arrays import Array, Mask
from dolfinx_feti.runtime.events import event
from dolfinx_feti.runtime.values import require_type
from dolfinx_feti.wall.laplace import gradient, solve_laplace
from dolfinx_feti.wall.wall import Wall, area, by_layer, openings, require_surface

__all__ = [
    "ANGLES",
    "Frame",
    "Potentials",
    "fibre_families",
    "fibre_frame",
    "frame_of",
    "solve_potentials",
]

#: Angle α of the fibres in each layer [degrees] (Holzapfel, Gasser, Ogden 2000).
ANGLES = {"media": 29.0, "adventitia": 62.0}

#: Length of a gradient over its mean in the wall, below which the direction comes from the cells
#: around, as at stagnation points. A choice that was not measured.
MIN_GRADIENT_FOR_DIRECTION = 2e-3

#: Length of a mean of unit vectors below which they cancel, and the mean has no direction. A choice
#: that was not measured; the mean of nearly parallel vectors has a length of about one.
MIN_MEAN_LENGTH = 1e-3

#: Relative difference below which two openings have the same area: a rounding margin.
AREA_RTOL = 1e-9


@dataclass(frozen=True, slots=True)
class Potentials:
    """The two potentials of a wall (P2), which stay with the material if the mesh moves.

    Attributes:
        through: t, through the wall: 0 on the inner surface, 1 on the outer one.
        along: l, along the wall: 0 on the inlet, 1 on the other openings.
    """

    through: dolfinx.fem.Function
    along: dolfinx.fem.Function


@dataclass(frozen=True, slots=True)
class Frame:
    """An orthonormal right-handed frame ê₀, ê₁, ê₂, constant in each cell (vector DG0)."""

    circumferential: dolfinx.fem.Function
    longitudinal: dolfinx.fem.Function
    transmural: dolfinx.fem.Function


@event("WallFibres")
def fibre_frame(
    wall: Wall,
    *,
    inner: str = "lumen",
    outer: str = "outer",
    ends: Sequence[str] | None = None,
    inlet: str | None = None,
) -> Frame:
    """Return the frame of a wall. Collective.

    Args:
        wall: The wall, with at least two openings.
        inner: The surface at t = 0.
        outer: The surface at t = 1.
        ends: The openings; those named `opening_…` if not given.
        inlet: The opening at l = 0; the one with the largest area if not given.

    Raises:
        ValueError: There are fewer than two openings, or there is no such surface or inlet.
        ArithmeticError: A Laplace problem was not solved, or cells have no direction.
    """
    potentials = solve_potentials(wall, inner=inner, outer=outer, ends=ends, inlet=inlet)
    return frame_of(wall, potentials)


def solve_potentials(
    wall: Wall,
    *,
    inner: str = "lumen",
    outer: str = "outer",
    ends: Sequence[str] | None = None,
    inlet: str | None = None,
) -> Potentials:
    """Solve the two Laplace problems of a wall. Collective.

    If the mesh moves afterwards, :func:`frame_of` returns the frame of the moved wall.

    Args:
        wall: The wall, with at least two openings.
        inner: The surface at t = 0.
        outer: The surface at t = 1.
        ends: The openings; those named `opening_…` if not given.
        inlet: The opening at l = 0; the one with the largest area if not given, the first of equal
            ones.

    Raises:
        ValueError: There are fewer than two openings, or there is no such surface or inlet.
        ArithmeticError: A Laplace problem was not solved.
    """
    require_type(Wall, wall=wall)
    names = openings(wall) if ends is None else list(ends)
    surfaces = [inner, outer, *names]
    for name in surfaces:
        require_surface(wall, name)
    if len(set(surfaces)) < len(surfaces):
        raise ValueError(f"inner={inner!r}, outer={outer!r} and ends={names} name a surface twice")
    if len(names) < 2:
        found = "No surface is called opening_…"
        if names:
            found = f"There is one opening, {names[0]!r}"
        raise ValueError(
            f"{found}, but the longitudinal direction needs two surfaces: pass their names, such "
            f"as ends=['inlet', 'outlet']; the wall has {', '.join(wall.surfaces)}"
        )
    if inlet is None:
        areas = np.array([area(wall, name) for name in names])
        inlet = names[int(np.argmax(areas >= (1.0 - AREA_RTOL) * areas.max()))]
    if inlet not in names:
        raise ValueError(f"inlet={inlet!r} is not an opening; choose one of {', '.join(names)}")
    through = solve_laplace(wall, {inner: 0.0, outer: 1.0})
    along = solve_laplace(wall, {name: float(name != inlet) for name in names})
    return Potentials(through, along)


def frame_of(wall: Wall, potentials: Potentials) -> Frame:
    """Return the frame of two potentials on the current mesh. Collective.

    Args:
        wall: The wall.
        potentials: Its potentials, from :func:`solve_potentials`.

    Raises:
        ArithmeticError: Cells have no direction.
    """
    grad_t = gradient(potentials.through)
    grad_l = gradient(potentials.along)
    e2 = _unit_directions(wall, grad_t, np.zeros_like(grad_t))
    e1 = _unit_directions(wall, grad_l, e2)
    W = dolfinx.fem.functionspace(wall.mesh, ("DG", 0, (3,)))
    e0 = np.asarray(np.cross(e1, e2), dtype=np.float64)
    directions = {"circumferential": e0, "longitudinal": e1, "transmural": e2}
    return Frame(**{name: _function(W, e, name) for name, e in directions.items()})


def fibre_families(
    wall: Wall, frame: Frame, angles: Mapping[str, float] | None = None
) -> tuple[dolfinx.fem.Function, dolfinx.fem.Function]:
    """Return the directions of the two fibre families, cos α ê₀ ± sin α ê₁.

    Example::

        a1, a2 = fibre_families(wall, fibre_frame(wall), {"media": 29.0, "adventitia": 62.0})
        psi = materials.holzapfel_gasser_ogden(
            kinematics.right_cauchy_green(F), a1, a2, c=3.0, k1=2.3632, k2=0.8393, J=J
        )

    Args:
        wall: The wall.
        frame: Its frame, from :func:`fibre_frame`.
        angles: α of each layer [degrees]; those of :data:`ANGLES` if not given.

    Raises:
        ValueError: A layer has no angle, or one that is not finite.
    """
    if angles is None:
        angles = {name: angle for name, angle in ANGLES.items() if name in wall.layers}
    α = np.deg2rad(by_layer(wall, angles).x.array)[:, None]
    W = frame.circumferential.function_space
    e0 = frame.circumferential.x.array.reshape(-1, 3)
    e1 = frame.longitudinal.x.array.reshape(-1, 3)
    around = np.cos(α) * e0
    along = np.sin(α) * e1
    first = _function(W, around + along, "fibres_1")
    second = _function(W, around - along, "fibres_2")
    return first, second


def _unit_directions(wall: Wall, gradients: Array, normal: Array) -> Array:
    """Return unit vectors along gradients, orthogonal to normals, (cells, 3). Collective.

    If a gradient, or its orthogonal part, is too small, the direction is the mean over the cells at
    the cell's vertices that have one. This is repeated until every cell has a direction; the result
    does not depend on the number of processes.

    Args:
        wall: The wall.
        gradients: Gradients, (cells, 3).
        normal: Unit normals, or zero for no condition, (cells, 3).

    Raises:
        ArithmeticError: Cells have no direction.
    """
    comm = wall.mesh.comm
    n_owned = wall.mesh.topology.index_map(3).size_local
    shortest = MIN_GRADIENT_FOR_DIRECTION * cell_mean(wall, np.linalg.norm(gradients, axis=1))
    e, has_direction = _unit(gradients, normal, shortest)
    missing = comm.allreduce(int(np.sum(~has_direction[:n_owned])))
    missing_before = -1
    while missing:
        if missing == missing_before:
            raise ArithmeticError(
                f"{missing} cells of the wall have no direction: check that lumen, outer and the "
                "openings are tagged correctly"
            )
        mean, has_mean = _unit(_mean_around(wall, e), normal, MIN_MEAN_LENGTH)
        e = np.where(has_direction[:, None], e, mean)
        has_direction |= has_mean
        missing_before = missing
        missing = comm.allreduce(int(np.sum(~has_direction[:n_owned])))
    return e


def _unit(v: Array, normal: Array, shortest: float) -> tuple[Array, Mask]:
    """Return unit vectors along the parts of vectors that are orthogonal to normals.

    Args:
        v: Vectors, (cells, 3).
        normal: Unit normals, or zero for no condition, (cells, 3).
        shortest: Length up to which an orthogonal part has no direction.

    Returns:
        Unit vectors, zero without a direction, (cells, 3), and a mask of those with one, (cells,).
    """
    v = v - np.sum(v * normal, axis=1, keepdims=True) * normal
    length = np.linalg.norm(v, axis=1)
    is_long = length > shortest
    inverse = np.where(is_long, 1 / np.where(is_long, length, 1), 0.0)
    return inverse[:, None] * v, is_long


def _mean_around(wall: Wall, e: Array) -> Array:
    """Average vectors over the cells at each vertex, then over the vertices of each cell.

    Vertices without a vector in their cells count as zero. Collective.

    Args:
        wall: The wall.
        e: Unit vectors, zero for a cell without one, (cells, 3).

    Returns:
        The means, (cells, 3).
    """
    V = dolfinx.fem.functionspace(wall.mesh, ("Lagrange", 1, (4,)))
    sums = dolfinx.fem.Function(V)  # three components of the sum, and the number of vectors
    n_owned = wall.mesh.topology.index_map(3).size_local
    vertices = V.dofmap.list
    at_vertex = sums.x.array.reshape(-1, 4)
    with_count = np.column_stack([e, np.linalg.norm(e, axis=1)])
    np.add.at(at_vertex, vertices[:n_owned], with_count[:n_owned, None])
    sums.x.scatter_reverse(dolfinx.la.InsertMode.add)
    sums.x.scatter_forward()
    count = np.maximum(at_vertex[:, 3:], 1)  # a sum of no vectors is zero, over one as well
    means = at_vertex[:, :3] / count
    return np.asarray(means[vertices].mean(axis=1))


def cell_mean(wall: Wall, values: Array) -> float:
    """Return the mean of values of cells, (cells,), over the wall. Collective."""
    owned = values[: wall.mesh.topology.index_map(3).size_local]
    total, count = wall.mesh.comm.allreduce(np.array([owned.sum(), len(owned)]))
    return float(total / count)


def _function(W: dolfinx.fem.FunctionSpace, values: Array, name: str) -> dolfinx.fem.Function:
    """Create a function with the values of all local dofs."""
    f = dolfinx.fem.Function(W, name=name)
    f.x.array[:] = values.ravel()
    return f
