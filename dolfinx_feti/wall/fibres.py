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

from petsc4py import PETSc

import numpy as np

import dolfinx
import dolfinx.fem.petsc
import ufl

from dolfinx_feti.mechanics.values import require_type
from dolfinx_feti.runtime.arrays import Array, Mask
from dolfinx_feti.runtime.compat import interpolation_points
from dolfinx_feti.runtime.events import event
from dolfinx_feti.runtime.petsc_options import inserted
from dolfinx_feti.wall.wall import Wall, area, by_layer, facets, openings

__all__ = ["ANGLES", "Frame", "fibre_families", "fibre_frame", "frame_of", "potentials"]

#: Prefix of PETSc's options.
PREFIX = "fibres_"

#: Options of the first solver. It solves to rounding accuracy, so that a potential that is nearly
#: constant, as in a sac, has a gradient. The threshold saves a third of the time of GAMG.
OPTIONS: dict[str, object] = {
    "ksp_type": "cg",
    "ksp_rtol": 1e-14,
    "ksp_max_it": 1000,
    "pc_type": "gamg",
    "pc_gamg_threshold": 0.03,
}

#: Options of the second solver, if the first one fails, as on meshes with slivers.
DIRECT_OPTIONS: dict[str, object] = {
    "ksp_type": "preonly",
    "pc_type": "cholesky",
    "pc_factor_mat_solver_type": "mumps",
}

#: Angle α of the fibres in each layer [degrees] (Holzapfel, Gasser, Ogden 2000).
ANGLES = {"media": 29.0, "adventitia": 62.0}

#: Length of a gradient over its mean in the wall, below which the direction comes from the cells
#: around, as at stagnation points. A choice that was not measured.
MIN_GRADIENT = 2e-3

#: Length of a mean of unit vectors below which they cancel, and the mean has no direction. A choice
#: that was not measured; the mean of nearly parallel vectors has a length of about one.
MIN_MEAN_LENGTH = 1e-3

#: Relative difference below which two openings have the same area: a rounding margin.
AREA_RTOL = 1e-9


def solve_laplace(wall: Wall, values: Mapping[str, float]) -> dolfinx.fem.Function:
    """Solve Δu = 0 with values on surfaces and zero flux through all others (P2). Collective.

    The solver is CG with GAMG, to 1e-14, and MUMPS if it fails. PETSc's options with the prefix
    ``fibres_`` override both.

    Args:
        wall: The wall.
        values: The value on each surface, by name.

    Raises:
        ArithmeticError: Both solvers fail.
    """
    V = dolfinx.fem.functionspace(wall.mesh, ("Lagrange", 2))
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    scalar = dolfinx.default_scalar_type
    a = dolfinx.fem.form(ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx)
    zero = dolfinx.fem.Constant(wall.mesh, scalar(0))  # dolfinx needs a right-hand side for lifting
    L = dolfinx.fem.form(zero * v * ufl.dx)
    dofs = {name: dolfinx.fem.locate_dofs_topological(V, 2, facets(wall, name)) for name in values}
    bcs = [dolfinx.fem.dirichletbc(scalar(t), dofs[name], V) for name, t in values.items()]
    A = dolfinx.fem.petsc.assemble_matrix(a, bcs=bcs)
    A.assemble()
    b = dolfinx.fem.petsc.assemble_vector(L)
    dolfinx.fem.petsc.apply_lifting(b, [a], [bcs])
    b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    dolfinx.fem.petsc.set_bc(b, bcs)
    x = A.createVecRight()
    solution = dolfinx.fem.Function(V)
    try:
        reason = _solve(A, b, x, OPTIONS)
        if reason <= 0:
            reason = _solve(A, b, x, DIRECT_OPTIONS)
        if reason <= 0:
            raise ArithmeticError(
                f"A Laplace problem for the fibres was not solved (reason {reason}). If a "
                "part of the wall touches neither of two surfaces with values, it is singular: "
                f"check the tags. Otherwise choose another solver by -{PREFIX}ksp_type"
            )
        solution.x.array[: x.getLocalSize()] = x.array_r
    finally:
        for petsc_object in (A, b, x):
            petsc_object.destroy()
    solution.x.scatter_forward()
    return solution


def _solve(A: PETSc.Mat, b: PETSc.Vec, x: PETSc.Vec, options: Mapping[str, object]) -> int:
    """Solve A x = b; return PETSc's converged reason.

    Args:
        A: Matrix.
        b: Right-hand side.
        x: The solution.
        options: Options of the solver; those of the user override them.
    """
    ksp = PETSc.KSP().create(A.comm)
    of_user = PETSc.Options(PREFIX)
    defaults = {key: value for key, value in options.items() if not of_user.hasName(key)}
    try:
        ksp.setOptionsPrefix(PREFIX)
        ksp.setOperators(A)
        with inserted(PREFIX, defaults):
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
    through, along = potentials(wall, inner=inner, outer=outer, ends=ends, inlet=inlet)
    return frame_of(wall, through, along)


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
        facets(wall, name)  # raises an error if it does not exist
    if len(set(surfaces)) < len(surfaces):
        raise ValueError(f"inner={inner!r}, outer={outer!r} and ends={names} name a surface twice")
    if len(names) < 2:
        raise ValueError(
            f"The wall has the openings {', '.join(names) or 'none'}: the longitudinal direction "
            "needs at least two; name them by ends="
        )
    if inlet is None:
        areas = np.array([area(wall, name) for name in names])
        inlet = names[int(np.argmax(areas >= (1.0 - AREA_RTOL) * areas.max()))]
    if inlet not in names:
        raise ValueError(f"inlet={inlet!r} is not an opening; choose one of {', '.join(names)}")
    through = solve_laplace(wall, {inner: 0.0, outer: 1.0})
    return through, solve_laplace(wall, {name: float(name != inlet) for name in names})


def frame_of(wall: Wall, through: dolfinx.fem.Function, along: dolfinx.fem.Function) -> Frame:
    """Return the frame of the two potentials on the current mesh. Collective.

    Args:
        wall: The wall.
        through: The potential t.
        along: The potential l.

    Raises:
        ArithmeticError: Cells have no direction.
    """
    grad_t = gradient(through)
    grad_l = gradient(along)
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


def _unit_directions(wall: Wall, along: Array, normal: Array) -> Array:
    """Return unit vectors along gradients, orthogonal to normals, (cells, 3). Collective.

    If a gradient, or its orthogonal part, is too small, the direction is the mean over the cells at
    the cell's vertices that have one. This is repeated until every cell has a direction; the result
    does not depend on the number of processes.

    Args:
        wall: The wall.
        along: Gradients, (cells, 3).
        normal: Unit normals, or zero for no condition, (cells, 3).

    Raises:
        ArithmeticError: Cells have no direction.
    """
    comm = wall.mesh.comm
    n_owned = wall.mesh.topology.index_map(3).size_local
    shortest = MIN_GRADIENT * cell_mean(wall, np.linalg.norm(along, axis=1))
    e, has_direction = _unit(along, normal, shortest)
    missing = comm.allreduce(int(np.sum(~has_direction[:n_owned])))
    missing_before = -1
    while missing:
        if missing == missing_before:
            raise ArithmeticError(
                f"{missing} cells of the wall have no direction: check that lumen, outer and the "
                "openings are tagged correctly"
            )
        mean, has_mean = _unit(_around(wall, e), normal, MIN_MEAN_LENGTH)
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


def _around(wall: Wall, e: Array) -> Array:
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
