# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Force and moment that the surroundings exert on a body through a surface Γ.

.. math:: f_i = F(u; φ_i)\, [\text{Γ supports } i] - F_Γ(u; φ_i), \qquad
          R = \sum_i f_i, \qquad M = \sum_i (x_i - x_0) × f_i

[·] is 1 if the statement holds, else 0. F is the residual, internal minus external forces, and F_Γ
its integrals over Γ: pressures, tractions, springs. R sums the reactions of the supports on Γ and
the loads on Γ, with the problem's quadrature. Over the whole boundary, R balances the body forces
in equilibrium: the constant field is in the space, and F vanishes on free dofs.

Γ supports the Dirichlet dofs that lie on it. A dof on an edge lies on several surfaces: only those
support it that have a facet there with all dofs prescribed, if there is such a facet at all. So the
reaction at the edge of a clamped end does not count for the loaded side that ends there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

import dolfinx
import ufl

from dolfinx_feti.fem.assembly import assemble_owned
from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.fem.facets import facets_of_pairs, one_side
from dolfinx_feti.runtime.arrays import Array, Indices, Mask
from dolfinx_feti.runtime.collective import on_all, total_of

#: UFL's type of integrals over exterior facets.
SURFACE_INTEGRAL = "exterior_facet"


@dataclass(frozen=True, slots=True)
class Reaction:
    """Force and moment that the surroundings exert on a body through a surface.

    Attributes:
        force: Force, (d,) of a displacement of d components, in the unit of the residual, such as
            mN for kPa and mm; the flux into the body, (1,), of a scalar unknown.
        moment: Moment about the reference point, (3,) in three dimensions, (1,) in two, such as
            mN mm; None unless the unknown has as many components as space has dimensions.
    """

    force: Array
    moment: Array | None


def reaction(
    residual: Array,
    form: ufl.Form,
    u: dolfinx.fem.Function,
    facets: npt.ArrayLike,
    *,
    dirichlet: Mask,
    is_deformed: bool,
    point: npt.ArrayLike | None,
    compiler: Compiler,
) -> Reaction:
    """Return force and moment of a surface, summed over its dofs. Collective.

    Args:
        residual: F(u; φ_i) with reactions on Dirichlet dofs, (owned,).
        form: F, tested with v in the space of u.
        u: Solution.
        facets: Facets of the surface on this process, owned ones and ghosts.
        dirichlet: Mask of the owned dofs with a prescribed value, (owned,).
        is_deformed: Whether moments refer to deformed positions X + u, or to X.
        point: x₀ of the moment, (d,), in deformed or reference positions; the origin if None.
        compiler: Compiles F_Γ.

    Raises:
        ValueError: ``facets`` are not numbers of facets of this mesh, no process has one, or the
            point has another number of components.
    """
    V = u.function_space
    mesh = V.mesh
    numbers = on_all(lambda: checked_facets(mesh, facets), mesh.comm)
    on_surface = _mark_on_all(mesh, numbers)
    surface = np.flatnonzero(on_surface).astype(np.int32)
    if not mesh.comm.allreduce(len(surface)):
        raise ValueError(
            "facets is empty on all processes: give the facets of a surface, such as "
            "dolfinx.mesh.locate_entities_boundary returns, or tags.find(number)."
        )
    sides = one_side(mesh, surface, side="any")  # both sides of a facet share its dofs
    nodal = np.where(_supported(V, dirichlet, mesh, sides), residual, 0.0)
    loads = _restricted(form, mesh, on_surface)
    if loads is not None:
        nodal -= assemble_owned(compiler.form(loads))  # f = F on supports − F_Γ
    bs = V.dofmap.index_map_bs
    f = nodal.reshape(-1, bs)
    one = _interpolated(V, lambda x: np.ones((bs, x.shape[1])))
    force = total_of((one * f).sum(axis=0), mesh.comm)  # R = Σ f_i
    if bs != mesh.geometry.dim or bs < 2:
        return Reaction(force, None)
    origin = on_all(lambda: _checked_point(point, bs), mesh.comm)
    x = _interpolated(V, lambda x: x[:bs])
    if is_deformed:
        x = x + u.x.array[: len(nodal)].reshape(-1, bs)
    moment = total_of(_cross(x, f).sum(axis=0), mesh.comm) - _cross(origin[None], force[None])[0]
    return Reaction(force, moment)


def checked_facets(mesh: dolfinx.mesh.Mesh, facets: npt.ArrayLike) -> Indices:
    """Return the numbers of facets, each once, ascending. Not collective.

    Raises:
        ValueError: They are not integers, or the mesh has no such facets on this process.
    """
    numbers = np.asarray(facets)
    if isinstance(facets, dolfinx.mesh.MeshTags):
        raise ValueError("facets are MeshTags: give those of one surface, tags.find(number).")
    if numbers.ndim != 1 or (numbers.size and not np.issubdtype(numbers.dtype, np.integer)):
        raise ValueError(f"facets is {facets!r}: give an array of numbers of facets.")
    fdim = mesh.topology.dim - 1
    mesh.topology.create_entities(fdim)
    index_map = mesh.topology.index_map(fdim)
    count = index_map.size_local + index_map.num_ghosts
    if numbers.size and not (numbers.min() >= 0 and numbers.max() < count):
        wrong = numbers.max() if numbers.max() >= count else numbers.min()
        raise ValueError(
            f"facets contains {wrong}, but this process has {count} facets, numbered from 0: give "
            "local numbers."
        )
    return np.unique(numbers).astype(np.int32)


def _checked_point(point: npt.ArrayLike | None, dim: int) -> Array:
    """Return the point of a moment, (d,); the origin if none is given.

    Raises:
        ValueError: The point has another number of components, or infinite ones.
    """
    x = np.zeros(dim) if point is None else np.asarray(point, dtype=np.float64)
    if x.shape != (dim,) or not np.isfinite(x).all():
        raise ValueError(f"point is {point!r}: give {dim} coordinates, finite numbers.")
    return x


def _mark_on_all(mesh: dolfinx.mesh.Mesh, facets: Indices) -> Mask:
    """Mark the facets that any process has passed, owned ones and ghosts, (facets,). Collective."""
    mark = dolfinx.la.vector(mesh.topology.index_map(mesh.topology.dim - 1), 1)
    mark.array[facets] = 1.0
    mark.scatter_reverse(dolfinx.la.InsertMode.add)
    mark.scatter_forward()
    return np.asarray(mark.array > 0.5)


def _supported(
    V: dolfinx.fem.FunctionSpace, dirichlet: Mask, mesh: dolfinx.mesh.Mesh, sides: Indices
) -> Mask:
    """Mark the owned Dirichlet dofs that a surface supports, (owned,). Collective.

    Args:
        V: Space of the unknown.
        dirichlet: Mask of the owned dofs with a prescribed value, (owned,).
        mesh: Its mesh.
        sides: Pairs of a cell and the number of a facet in it, of the surface.
    """
    exterior = one_side(mesh, dolfinx.mesh.exterior_facet_indices(mesh.topology), side="any")
    on_surface, is_prescribed_by_surface = _dofs_of(V, dirichlet, sides)
    _, is_prescribed_by_boundary = _dofs_of(V, dirichlet, exterior)
    is_supported = is_prescribed_by_surface | ~is_prescribed_by_boundary
    return np.asarray(dirichlet & on_surface & is_supported)


def _dofs_of(V: dolfinx.fem.FunctionSpace, dirichlet: Mask, sides: Indices) -> tuple[Mask, Mask]:
    """Mark the owned dofs of facets, and of facets with all dofs prescribed. Collective.

    Args:
        V: Space of the unknown.
        dirichlet: Mask of the owned dofs with a prescribed value, (owned,).
        sides: Pairs of a cell and the number of a facet in it.

    Returns:
        Two masks, (owned,): the dof belongs to a facet; it belongs to a facet on which all dofs of
        its component are prescribed.
    """
    bs = V.dofmap.index_map_bs
    fdim = V.mesh.topology.dim - 1
    with_ghosts = dolfinx.la.vector(V.dofmap.index_map, bs)
    with_ghosts.array[: len(dirichlet)] = dirichlet
    with_ghosts.scatter_forward()
    prescribed = with_ghosts.array.reshape(-1, bs) > 0.5
    marks = [dolfinx.la.vector(V.dofmap.index_map, bs) for _ in range(2)]
    on_facet, on_prescribed = (mark.array.reshape(-1, bs) for mark in marks)
    cells, numbers = sides.reshape(-1, 2).T
    for number in np.unique(numbers):
        closure = V.dofmap.dof_layout.entity_closure_dofs(fdim, int(number))
        dofs = V.dofmap.list[cells[numbers == number]][:, closure]  # (facets, dofs of a facet)
        on_facet[dofs] = 1.0
        is_prescribed = prescribed[dofs].all(axis=1)  # (facets, components)
        for component in range(bs):
            on_prescribed[dofs[is_prescribed[:, component]], component] = 1.0
    for mark in marks:
        mark.scatter_reverse(dolfinx.la.InsertMode.add)
    of_facets, of_prescribed = (mark.array[: len(dirichlet)] > 0.5 for mark in marks)
    return of_facets, of_prescribed


def _interpolated(V: dolfinx.fem.FunctionSpace, values: Callable[[Array], Array]) -> Array:
    """Return the owned coefficients of a field, (blocks, components).

    Args:
        V: Space of the field.
        values: Returns values (components, points) at positions (3, points).
    """
    bs = V.dofmap.index_map_bs
    field = dolfinx.fem.Function(V)
    field.interpolate(lambda x: values(x) if bs > 1 else values(x)[0])
    owned = field.x.array[: V.dofmap.index_map.size_local * bs]
    return np.array(owned, dtype=np.float64).reshape(-1, bs)


def _cross(x: Array, f: Array) -> Array:
    """Return x × f of rows, (n, 3); in the plane its only component, (n, 2) → (n, 1)."""
    if x.shape[1] == 3:
        return np.asarray(np.cross(x, f), dtype=np.float64)
    return x[:, :1] * f[:, 1:] - x[:, 1:] * f[:, :1]


def _restricted(form: ufl.Form, mesh: dolfinx.mesh.Mesh, on_surface: Mask) -> ufl.Form | None:
    """Return F_Γ, the surface integrals of a form over marked facets; None if it has none.

    Each integral gets its own subdomain: the marked facets that it was integrated over before.

    Args:
        form: F.
        mesh: Its mesh.
        on_surface: Mask of the facets of this process, owned ones and ghosts, (facets,).
    """
    integrals = form.integrals_by_type(SURFACE_INTEGRAL)
    marked: list[tuple[int, Indices]] = []  # dolfinx's data: number and sides of each subdomain
    for number, integral in enumerate(integrals):
        pairs = _sides(integral, mesh)
        is_marked = on_surface[facets_of_pairs(mesh, pairs)]
        marked.append((number, pairs.reshape(-1, 2)[is_marked].ravel()))
    restricted = [
        integral.reconstruct(subdomain_id=number, subdomain_data=marked)
        for number, integral in enumerate(integrals)
    ]
    return ufl.Form(restricted) if restricted else None


def _sides(integral: ufl.Integral, mesh: dolfinx.mesh.Mesh) -> Indices:
    """Return pairs of a cell and the number of a facet in it, of all facets of an integral."""
    identifier = integral.subdomain_id()
    data = integral.subdomain_data()
    numbers = identifier if isinstance(identifier, tuple) else (identifier,)
    mesh.topology.create_connectivity(mesh.topology.dim - 1, mesh.topology.dim)
    exterior = dolfinx.mesh.exterior_facet_indices(mesh.topology)
    if any(number in ("everywhere", "otherwise") for number in numbers) or data is None:
        return one_side(mesh, exterior, side="any")
    if isinstance(data, dolfinx.mesh.MeshTags):
        tagged = np.concatenate([data.find(int(number)) for number in numbers])
        return one_side(mesh, np.intersect1d(tagged, exterior), side="any")
    selected = [np.asarray(pairs, dtype=np.int32) for number, pairs in data if number in numbers]
    return np.concatenate([*selected, np.zeros(0, dtype=np.int32)])
