# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Directions of the collagen fibres from two Laplace problems and an angle.

In each cell the orthonormal, right-handed frame is (after Bayer et al. 2012)::

    ê₂ = ∇t / |∇t|            Δt = 0,  t = 0 on the lumen, 1 on the outer wall      transmural,
    ê₁ ∥ ∇l − (∇l·ê₂) ê₂      Δl = 0,  l = 0 on the inlet, 1 on the other openings  longitudinal,
    ê₀ = ê₁ × ê₂                                                                    circumferential,

with zero flux elsewhere; in a tube along z it is (e_θ, e_z, e_r). The two families lie at ±α,
a₀ = cos α ê₀ ± sin α ê₁ (eq. 55, Augustin_eq:rotation, but for its orthogonal families:
``docs/equations.md``). The potentials are P2, their gradients taken at the centroids.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from petsc4py import PETSc

import numpy as np

import dolfinx
import dolfinx.fem.petsc
import ufl

from dolfinx_feti.mechanics.values import typed
from dolfinx_feti.runtime.arrays import Array, Mask
from dolfinx_feti.runtime.compat import interpolation_points
from dolfinx_feti.runtime.events import event
from dolfinx_feti.runtime.petsc_options import inserted
from dolfinx_feti.wall.wall import Wall, area, by_layer, facets, openings

__all__ = ["ANGLES", "Frame", "fibre_families", "fibre_frame", "frame_of", "potentials"]

#: Of PETSc's options.
PREFIX = "fibres_"

# Solved to rounding, so that a nearly flat potential (in a sac) has a consistent direction.
# Without couplings below the threshold in its aggregates GAMG takes two thirds of the time.
OPTIONS: dict[str, object] = {
    "ksp_type": "cg",
    "ksp_rtol": 1e-14,
    "ksp_max_it": 1000,
    "pc_type": "gamg",
    "pc_gamg_threshold": 0.03,
}

# Where that fails, as it does on meshes with slivers.
DIRECT: dict[str, object] = {
    "ksp_type": "preonly",
    "pc_type": "cholesky",
    "pc_factor_mat_solver_type": "mumps",
}

# Angle from the circumferential direction, in degrees (Holzapfel, Gasser, Ogden 2000).
ANGLES = {"media": 29.0, "adventitia": 62.0}

# Below this fraction of the mean a gradient has no reliable direction (at stagnation points).
WEAK = 2e-3

# Relative difference below which two openings have the same area.
SAME_AREA = 1e-9


def solve_laplace(wall: Wall, values: Mapping[str, float]) -> dolfinx.fem.Function:
    """Solve Δu = 0 with values on some surfaces, by name, and zero flux through the others (P2).

    CG with GAMG solves to 1e-14, and MUMPS what that does not; PETSc's options with the prefix
    ``fibres_`` prevail. What neither solves is an ArithmeticError. Collective.
    """
    V = dolfinx.fem.functionspace(wall.mesh, ("Lagrange", 2))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    scalar = dolfinx.default_scalar_type
    a = dolfinx.fem.form(ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx)
    L = dolfinx.fem.form(dolfinx.fem.Constant(wall.mesh, scalar(0)) * v * ufl.dx)
    dofs = {name: dolfinx.fem.locate_dofs_topological(V, 2, facets(wall, name)) for name in values}
    bcs = [dolfinx.fem.dirichletbc(scalar(t), dofs[name], V) for name, t in values.items()]
    A = dolfinx.fem.petsc.assemble_matrix(a, bcs=bcs)
    A.assemble()
    b = dolfinx.fem.petsc.assemble_vector(L)
    dolfinx.fem.petsc.apply_lifting(b, [a], [bcs])
    b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    dolfinx.fem.petsc.set_bc(b, bcs)
    x, solution = A.createVecRight(), dolfinx.fem.Function(V)
    try:
        if not any((reason := _solve(A, b, x, options)) > 0 for options in (OPTIONS, DIRECT)):
            raise ArithmeticError(
                f"A Laplace problem for the fibres was not solved (reason {reason}): every part of "
                f"the wall has to touch an opening; -{PREFIX}ksp_type chooses another solver"
            )
        solution.x.array[: x.getLocalSize()] = x.array_r
    finally:
        for owned in (A, b, x):
            owned.destroy()
    solution.x.scatter_forward()
    return solution


def _solve(A: PETSc.Mat, b: PETSc.Vec, x: PETSc.Vec, options: Mapping[str, object]) -> int:
    """Solve A x = b with the options, behind the user's; return PETSc's reason."""
    ksp, users = PETSc.KSP().create(A.comm), PETSc.Options(PREFIX)
    try:
        ksp.setOptionsPrefix(PREFIX)
        ksp.setOperators(A)
        with inserted(PREFIX, {k: v for k, v in options.items() if not users.hasName(k)}):
            ksp.setFromOptions()
            ksp.solve(b, x)
        return int(ksp.getConvergedReason())
    finally:
        ksp.destroy()


def gradient(u: dolfinx.fem.Function) -> Array:
    """Return ∇u at the centroids of the local cells, (cells, 3), or (cells, 3, 3) of a vector."""
    shape = (*u.ufl_shape, 3)
    W = dolfinx.fem.functionspace(u.function_space.mesh, ("DG", 0, shape))
    g = dolfinx.fem.Function(W)
    g.interpolate(dolfinx.fem.Expression(ufl.grad(u), interpolation_points(W)))
    g.x.scatter_forward()
    return np.asarray(g.x.array.reshape(-1, *shape))


@dataclass(frozen=True, slots=True)
class Frame:
    """An orthonormal right-handed frame ê₀, ê₁, ê₂, constant in each cell (vector DG0)."""

    circumferential: dolfinx.fem.Function
    longitudinal: dolfinx.fem.Function
    transmural: dolfinx.fem.Function


@typed
@event("WallFibres")
def fibre_frame(wall: Wall, **surfaces: Any) -> Frame:
    """Return the frame of a wall, whose surfaces are named as in :func:`potentials`. Collective."""
    return frame_of(wall, *potentials(wall, **surfaces))


@typed
def potentials(
    wall: Wall,
    *,
    inner: str = "lumen",
    outer: str = "outer",
    ends: Sequence[str] | None = None,
    inlet: str | None = None,
) -> tuple[dolfinx.fem.Function, dolfinx.fem.Function]:
    """Return the two potentials of a frame, t through the wall and l along it (P2). Collective.

    If the mesh moves afterwards, :func:`frame_of` has the frame of the moved wall.

    Args:
        wall: The wall, with at least two openings.
        inner: The surface from which the transmural direction leads.
        outer: That to which it leads.
        ends: The surfaces where the vessel was cut; None for those named `opening_…`.
        inlet: The opening where the vessel begins; None for the one with the largest area (the
            first of equal ones).

    Raises:
        ValueError: There are fewer than two openings, or there is no such surface or inlet.
        ArithmeticError: A Laplace problem was not solved.
    """
    names = openings(wall) if ends is None else list(ends)
    for name in (given := [inner, outer, *names]):
        facets(wall, name)  # must be there
    if len(set(given)) < len(given):
        raise ValueError(f"inner={inner!r}, outer={outer!r} and ends={names} name a surface twice")
    if len(names) < 2:
        raise ValueError(
            f"The wall has the openings {', '.join(names) or 'none'}: the longitudinal direction "
            "needs at least two; name them by ends="
        )
    if inlet is None:
        areas = np.array([area(wall, name) for name in names])
        inlet = names[int(np.argmax(areas >= (1.0 - SAME_AREA) * areas.max()))]
    if inlet not in names:
        raise ValueError(f"inlet={inlet!r} is not an opening; choose one of {', '.join(names)}")
    through = solve_laplace(wall, {inner: 0.0, outer: 1.0})
    return through, solve_laplace(wall, {name: float(name != inlet) for name in names})


@typed
def frame_of(wall: Wall, through: dolfinx.fem.Function, along: dolfinx.fem.Function) -> Frame:
    """Return the frame of the two potentials t and l on the mesh as it is. Collective.

    Cells that are left without a direction are an ArithmeticError.
    """
    grad_t, grad_l = gradient(through), gradient(along)
    e2 = _unit_directions(wall, grad_t, np.zeros_like(grad_t))
    e1 = _unit_directions(wall, grad_l, e2)
    W = dolfinx.fem.functionspace(wall.mesh, ("DG", 0, (3,)))
    e0 = np.asarray(np.cross(e1, e2), dtype=np.float64)
    directions = {"circumferential": e0, "longitudinal": e1, "transmural": e2}
    return Frame(**{name: _function(W, e, name) for name, e in directions.items()})


@typed
def fibre_families(
    wall: Wall, frame: Frame, angles: Mapping[str, float] | None = None
) -> tuple[dolfinx.fem.Function, dolfinx.fem.Function]:
    """Return the directions of the two fibre families, cos α ê₀ ± sin α ê₁.

    ``angles`` are α for each layer [degrees]; those of :data:`ANGLES` if not given. A layer without
    an angle, or with one that is not finite, is a ValueError.
    """
    if angles is None:
        angles = {name: angle for name, angle in ANGLES.items() if name in wall.layers}
    α = np.deg2rad(by_layer(wall, angles).x.array)[:, None]
    W = frame.circumferential.function_space
    e0, e1 = (f.x.array.reshape(-1, 3) for f in (frame.circumferential, frame.longitudinal))
    a0, a1 = np.cos(α) * e0, np.sin(α) * e1
    return _function(W, a0 + a1, "fibres_1"), _function(W, a0 - a1, "fibres_2")


def _unit_directions(wall: Wall, along: Array, normal: Array) -> Array:
    """Return unit vectors along gradients, orthogonal to unit normals or to zero, (cells, 3).

    Where a gradient, or its orthogonal part, is too weak, the direction is the mean of those at the
    cell's vertices, again and again until every cell has one, whatever the number of processes.
    """
    comm, n_owned = wall.mesh.comm, wall.mesh.topology.index_map(3).size_local
    weak = WEAK * cell_mean(wall, np.linalg.norm(along, axis=1))
    e, known = _unit(along, normal, weak)
    left, before = comm.allreduce(int(np.sum(~known[:n_owned]))), -1
    while left:
        if left == before:
            raise ArithmeticError(
                f"{left} cells of the wall have no direction: check that lumen, outer and the "
                "openings are tagged correctly"
            )
        mean, strong = _unit(_around(wall, e), normal, 1e-3)
        e = np.where(known[:, None], e, mean)
        known |= strong
        before, left = left, comm.allreduce(int(np.sum(~known[:n_owned])))
    return e


def _unit(v: Array, normal: Array, least: float) -> tuple[Array, Mask]:
    """Normalise orthogonal parts longer than ``least``, set others to zero; mark the former."""
    v = v - np.sum(v * normal, axis=1, keepdims=True) * normal
    length = np.linalg.norm(v, axis=1)
    long = length > least
    return np.where(long, 1 / np.where(long, length, 1), 0.0)[:, None] * v, long


def _around(wall: Wall, e: Array) -> Array:
    """Average vectors over the cells at each vertex, then over the vertices of each cell."""
    V = dolfinx.fem.functionspace(wall.mesh, ("Lagrange", 1, (4,)))
    sums = dolfinx.fem.Function(V)
    n_owned = wall.mesh.topology.index_map(3).size_local
    vertices, at_vertex = V.dofmap.list, sums.x.array.reshape(-1, 4)
    counted = np.column_stack([e, np.linalg.norm(e, axis=1)])
    np.add.at(at_vertex, vertices[:n_owned], counted[:n_owned, None])
    sums.x.scatter_reverse(dolfinx.la.InsertMode.add)
    sums.x.scatter_forward()
    means = at_vertex[:, :3] / np.maximum(at_vertex[:, 3:], 1)
    return np.asarray(means[vertices].mean(axis=1))


def cell_mean(wall: Wall, values: Array) -> float:
    """Return the mean over the owned cells of all processes."""
    own = values[: wall.mesh.topology.index_map(3).size_local]
    total, count = wall.mesh.comm.allreduce(np.array([own.sum(), len(own)]))
    return float(total / count)


def _function(W: dolfinx.fem.FunctionSpace, values: Array, name: str) -> dolfinx.fem.Function:
    f = dolfinx.fem.Function(W, name=name)
    f.x.array[:] = values.ravel()
    return f
