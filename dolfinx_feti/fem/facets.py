# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Surfaces inside a mesh, integrated from one side.

.. math:: \int_Γ k\, u\, v\, ds, \qquad Γ ⊂ Ω,

couples only the dofs on Γ if u and v are continuous and no gradients occur. UFL's dS couples all
dofs of the cells on both sides, whatever the integrand.

An interior facet has two *sides*, one in each of its cells; a facet of the boundary has one. Its
*first side* is the one in the first of the cells, ordered by process and by their numbers there.
This order only names the two sides.

The choice of a side to integrate from matters for normals, and for coefficients that jump across
the surface, such as the material of each cell. It must not depend on the numbers of cells, which
change with the number of processes. Either the user gives the cells on one side, or each connected
surface is oriented as a whole. A facet has ridges: its edges, or its end points in 2D. A normal
gives a ridge a direction, counter-clockwise around the facet. If two facets share a ridge, their
normals point to the same side of the surface if they give the ridge opposite directions. The data
of all sides are gathered on each process, which is meant for surfaces, not for all facets of a
mesh.

scifem's ``compute_interface_data`` solves another problem: it orders the two cells of interior
facets by cell tags, for dS, and needs both cells on one process.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from mpi4py import MPI

import numpy as np
import scipy.sparse
import scipy.sparse.csgraph

import basix
import dolfinx

from dolfinx_feti.runtime.arrays import Array, Indices, Integers, Mask, Numbers
from dolfinx_feti.runtime.collective import allgather_rows
from dolfinx_feti.runtime.compat import geometry_dofmap

#: A component of a mean normal below this share of its length counts as zero. It is far above
#: rounding, 1e-16, and above the digits of coordinates in a text file, 1e-8.
NORMAL_RTOL = 1e-6

#: Remedy if a surface cannot be oriented.
SIDE_REMEDY = (
    'Name the side by cells, such as side=cell_tags.find(tag), or give side="any" if nothing but '
    "values of continuous functions is integrated."
)

#: A frequent cause of surfaces that cannot be oriented.
EXTRA_FACETS_HINT = (
    "dolfinx.mesh.locate_entities finds all facets whose vertices lie on a surface, also those "
    "that cut off its corners."
)


@dataclass(frozen=True, slots=True)
class FacetSides:
    """Sides of facets in owned cells: each facet once for each of its cells.

    Attributes:
        cell: Cell of each side, (n,).
        local: Local number of the facet in it, (n,).
        facet: Number of the facet over all processes, (n,).
    """

    cell: Indices
    local: Indices
    facet: Numbers

    def pairs(self, is_selected: Mask) -> Indices:
        """Return cell and local number of some sides, flattened as ``ufl.Measure`` expects, (2 k,).

        Args:
            is_selected: Mask of these sides, (n,).
        """
        return np.column_stack([self.cell, self.local])[is_selected].astype(np.int32).ravel()


@dataclass(frozen=True, slots=True)
class SideGeometry:
    """Positions and normals of sides of facets, by which a surface is oriented.

    Attributes:
        facet: Number of the facet over all processes, (n,).
        area: Area vector: outward normal of the cell, as long as the facet is large, (n, gdim).
        midpoint: Mean of the vertices of the facet, (n, gdim).
        ridge: Numbers of the ridges of the facet over all processes, (n, r).
        direction: Direction, +1 or −1, that the normal gives to each ridge, (n, r).
    """

    facet: Numbers
    area: Array
    midpoint: Array
    ridge: Numbers
    direction: Array

    def allgather(self, comm: MPI.Intracomm) -> SideGeometry:
        """Return the sides of all processes, in the order of the processes. Collective."""
        parts = (self.facet, self.area, self.midpoint, self.ridge, self.direction)
        return SideGeometry(*(allgather_rows(part, comm) for part in parts))


def one_side(
    mesh: dolfinx.mesh.Mesh, facets: Integers, side: Integers | Literal["any"] | None = None
) -> Indices:
    """Return one pair of cell and facet for each facet, to integrate over a surface. Collective.

    Example::

        mesh = dolfinx.mesh.create_unit_cube(MPI.COMM_WORLD, 4, 4, 4)
        membrane = dolfinx.mesh.locate_entities(mesh, 2, lambda x: np.isclose(x[0], 0.5))
        ds = ufl.Measure("ds", mesh, subdomain_data=[(1, one_side(mesh, membrane))])
        area = dolfinx.fem.assemble_scalar(dolfinx.fem.form(1.0 * ds(1)))  # of this process

    List all surfaces of a form in one ``subdomain_data``, each with a number, also those on the
    boundary: in UFL, ds without a number is an integral over all surfaces of the list. Normals
    point out of the returned cells.

    Args:
        mesh: The mesh.
        facets: Facets that this process owns or has a copy of, inside or on the boundary.
        side: Cells on the side to integrate from, with exactly one cell at each interior facet: all
            cells of a material, ``cell_tags.find(2)``, for example. Ghosts are allowed.
            If None, each connected surface is integrated from one side. Curved surfaces, such as a
            sphere or a tube, are integrated from the inside. A surface counts as plane if its mean
            normal is longer than its bulge divided by its size. It is integrated from the side
            whose outward mean normal has a positive component along x. If that component is zero,
            y decides, then z.
            ``"any"`` if the side does not matter, as for values of continuous functions.

    Returns:
        Pairs of an owned cell and the local number of the facet in it, flattened as
        ``ufl.Measure`` expects, (2 n,); each facet once over all processes.

    Raises:
        ValueError: ``side`` contains both cells at a facet, or none of them; or no side is given
            and a surface cannot be oriented: it branches, has one side only (a Möbius strip), or
            the mesh is a surface itself.
    """
    sides = _sides(mesh, facets)
    if side is None:
        is_selected = _oriented(mesh, sides)
    elif isinstance(side, str):
        if side != "any":
            raise ValueError(f'side is {side!r}: give cells, or "any" if the side does not matter.')
        is_selected = _is_first_side(sides, mesh.comm)
    else:
        is_selected = _is_on_side_of_user(sides, side, mesh.comm)
    return sides.pairs(is_selected)


def facets_of_pairs(mesh: dolfinx.mesh.Mesh, pairs: Indices) -> Indices:
    """Return the facet of each pair of a cell and the local number of a facet in it, (n,).

    Args:
        mesh: The mesh.
        pairs: The pairs, (n, 2), or flattened, as :func:`one_side` returns them, (2 n,).
    """
    tdim = mesh.topology.dim
    mesh.topology.create_connectivity(tdim, tdim - 1)
    links = mesh.topology.connectivity(tdim, tdim - 1)
    cell, local = pairs.reshape(-1, 2).T
    return np.asarray(links.array[links.offsets[cell] + local])


def _sides(mesh: dolfinx.mesh.Mesh, facets: Integers) -> FacetSides:
    """Return the sides of facets in owned cells. Collective.

    Args:
        mesh: The mesh.
        facets: Facets of this process. Facets that another process lists are included: their
            numbers are gathered on all processes.
    """
    topology = mesh.topology
    tdim = topology.dim
    topology.create_connectivity(tdim - 1, tdim)
    topology.create_connectivity(tdim, tdim - 1)
    facet_map = topology.index_map(tdim - 1)
    local_numbers = facet_map.local_to_global(np.unique(facets).astype(np.int32))
    all_numbers = np.unique(allgather_rows(local_numbers, mesh.comm))
    facets_of_cell = _global_numbers_of(mesh, tdim - 1)
    cell, local = np.nonzero(np.isin(facets_of_cell, all_numbers))
    return FacetSides(cell.astype(np.int32), local.astype(np.int32), facets_of_cell[cell, local])


def _is_on_side_of_user(sides: FacetSides, side: Integers, comm: MPI.Intracomm) -> Mask:
    """Return a mask of the sides in the user's cells, (n,). Collective.

    A facet of the boundary has one side, which is selected whether its cell is listed or not.

    Args:
        sides: The sides of this process.
        side: Cells of the user.
        comm: Communicator of the mesh.

    Raises:
        ValueError: The list has both cells of a facet, or none.
    """
    is_listed = np.isin(sides.cell, side)
    all_facets = allgather_rows(sides.facet, comm)
    all_listed = allgather_rows(is_listed, comm)
    numbers, index, n_cells = np.unique(all_facets, return_inverse=True, return_counts=True)
    n_listed = np.bincount(index, weights=all_listed, minlength=len(numbers))
    with_both = int(np.count_nonzero((n_cells == 2) & (n_listed == 2)))
    with_none = int(np.count_nonzero((n_cells == 2) & (n_listed == 0)))
    if with_both or with_none:
        raise ValueError(
            f"side has both cells at {with_both} facets and none at {with_none} others: give the "
            "cells on one side of the surface, such as cell_tags.find(tag) of the material there, "
            f"and leave facets out that are not on that side. {EXTRA_FACETS_HINT}"
        )
    is_interior = n_cells[np.searchsorted(numbers, sides.facet)] == 2
    return np.asarray(is_listed | ~is_interior)


def _is_first_side(sides: FacetSides, comm: MPI.Intracomm) -> Mask:
    """Return a mask of the sides that are the first of their facet over all processes, (n,).

    Collective.
    """
    _, first = np.unique(allgather_rows(sides.facet, comm), return_index=True)
    rows = _rows_of_this_process(len(sides.facet), comm)
    return np.isin(np.arange(rows.start, rows.stop), first)


def _rows_of_this_process(n: int, comm: MPI.Intracomm) -> slice:
    """Return where n rows of this process are in the result of ``allgather_rows``. Collective."""
    first = comm.scan(n) - n
    return slice(first, first + n)


def _oriented(mesh: dolfinx.mesh.Mesh, sides: FacetSides) -> Mask:
    """Return a mask of the sides on one side of each connected surface, (n,). Collective.

    Args:
        mesh: The mesh.
        sides: The sides of this process.

    Raises:
        ValueError: A surface cannot be oriented.
    """
    comm = mesh.comm
    n = len(sides.facet)
    _, n_cells = np.unique(allgather_rows(sides.facet, comm), return_counts=True)
    if np.all(n_cells == 1):  # all on the boundary
        return np.ones(n, dtype=bool)
    if mesh.geometry.dim != mesh.topology.dim:
        raise ValueError(
            "facets lie inside a mesh that is a surface itself, whose normals do not distinguish "
            f"the two sides. {SIDE_REMEDY}"
        )
    all_sides = _geometry(mesh, sides).allgather(comm)
    numbers, first, facet_of_side, n_cells = np.unique(
        all_sides.facet, return_index=True, return_inverse=True, return_counts=True
    )
    interior = np.flatnonzero(n_cells == 2)
    uses_second_side = np.zeros(len(numbers), dtype=bool)
    uses_second_side[interior] = _uses_second_side(all_sides, first[interior])
    is_second = np.ones(len(all_sides.facet), dtype=bool)
    is_second[first] = False
    is_on_boundary = n_cells[facet_of_side] == 1
    is_selected = is_on_boundary | (is_second == uses_second_side[facet_of_side])
    return np.asarray(is_selected[_rows_of_this_process(n, comm)])


def _uses_second_side(sides: SideGeometry, first: Numbers) -> Mask:
    """Return a mask of the facets that are integrated from their second side, (n,).

    Args:
        sides: Sides of all processes.
        first: First side of each interior facet, (n,).

    Raises:
        ValueError: A surface branches, or has one side only.
    """
    n = len(first)
    label = _side_labels(sides.ridge[first], sides.direction[first])
    if np.any(label[:n] == label[n:]):
        raise ValueError(
            f"facets are a surface with one side alone, such as a Möbius strip. {SIDE_REMEDY}"
        )
    area = sides.area[first]
    midpoint = sides.midpoint[first]
    is_selected = _is_integrated(
        label, np.concatenate([area, -area]), np.concatenate([midpoint, midpoint])
    )
    return np.asarray(~is_selected[label[:n]])


def _is_integrated(label: Numbers, area: Array, midpoint: Array) -> Mask:
    """Return a mask of the sides of connected surfaces that are integrated from, (labels,).

    Each side of a surface has two numbers, both without unit:

    - its mean normal, of length 1 for a plane and 0 for a closed surface,
    - its bulge, the mean of normal · (position − centre), over the square root of the area. It is
      0 for a plane. Normals that point away from the centre make it positive: the cells on this
      side are inside.

    If the bulge is larger than the mean normal, the surface counts as curved, and the side with the
    positive bulge is integrated from. Otherwise it counts as plane, and the sign of the first
    component of the mean normal that is not zero decides.

    Args:
        label: Label of both sides of each facet, (2 n,).
        area: Their area vectors, (2 n, gdim).
        midpoint: Midpoint of their facet, (2 n, gdim).
    """
    gdim = area.shape[1]
    count = int(label.max()) + 1
    size = np.linalg.norm(area, axis=1)
    total_size = np.bincount(label, size, count)
    center = _sums(label, size[:, None] * midpoint, count) / total_size[:, None]
    heights = np.sum(area * (midpoint - center[label]), axis=1)
    bulge = np.bincount(label, heights, count) / total_size
    if gdim > 1:  # a length becomes a number, over the edge of a square of this area
        bulge /= total_size ** (1.0 / (gdim - 1))
    mean_normal = _sums(label, area, count) / total_size[:, None]
    normal_length = np.linalg.norm(mean_normal, axis=1)
    is_curved = np.abs(bulge) > normal_length

    # component of the mean normal that decides for a plane surface
    is_component = np.abs(mean_normal) > NORMAL_RTOL * normal_length[:, None]
    axis = np.argmax(is_component, axis=1)  # the first one that is not zero
    along_axis = mean_normal[np.arange(count), axis]
    return np.asarray(np.where(is_curved, bulge, along_axis) > 0.0)


def _side_labels(ridge: Numbers, direction: Array) -> Numbers:
    """Return labels of the sides of connected surfaces, (2 n,).

    Entry i is the label of the first side of facet i, entry n + i that of its second side.

    Args:
        ridge: Ridges of each facet, (n, r).
        direction: Direction that the normal of its first side gives to each, (n, r).

    Raises:
        ValueError: More than two facets meet at a ridge.
    """
    n, r = ridge.shape
    facet = np.repeat(np.arange(n), r)
    order = np.argsort(ridge.ravel(), kind="stable")
    _, start, count = np.unique(ridge.ravel()[order], return_index=True, return_counts=True)
    branches = int(np.count_nonzero(count > 2))
    if branches:
        raise ValueError(
            f"facets branch: more than two of them meet at {branches} places, so that they have no "
            f"common side. {EXTRA_FACETS_HINT} {SIDE_REMEDY}"
        )
    start = start[count == 2]  # facets i and j share a ridge
    i = facet[order[start]]
    j = facet[order[start + 1]]
    sorted_directions = direction.ravel()[order]
    are_first_sides_equal = sorted_directions[start] != sorted_directions[start + 1]
    # edges of a graph: the first side of i with the first or second side of j, and vice versa
    rows = np.concatenate([i, i + n])
    columns = np.concatenate(
        [np.where(are_first_sides_equal, j, j + n), np.where(are_first_sides_equal, j + n, j)]
    )
    graph = scipy.sparse.coo_array((np.ones(len(rows)), (rows, columns)), shape=(2 * n, 2 * n))
    _, label = scipy.sparse.csgraph.connected_components(graph, directed=False)
    return np.asarray(label, dtype=np.int64)


def _geometry(mesh: dolfinx.mesh.Mesh, sides: FacetSides) -> SideGeometry:
    """Return the geometry of sides in a mesh with the dimension of space. Collective.

    Edges count as straight: only the vertices are used.

    Args:
        mesh: The mesh.
        sides: The sides of this process.
    """
    tdim = mesh.topology.dim
    cell_type = getattr(basix.CellType, mesh.topology.cell_name())
    n_vertices = len(basix.topology(cell_type)[0])
    nodes = geometry_dofmap(mesh)[sides.cell, :n_vertices]
    x = np.asarray(mesh.geometry.x[nodes][:, :, :tdim], dtype=np.float64)
    area, midpoint = _areas_and_midpoints(cell_type, sides.local, x)
    if tdim == 1:  # a facet is a vertex, and has no ridges
        no_ridges = np.zeros((len(sides.cell), 0))
        return SideGeometry(sides.facet, area, midpoint, no_ridges.astype(np.int64), no_ridges)
    ridges = _global_numbers_of(mesh, tdim - 2)[sides.cell]
    ridge, direction = _ridges(cell_type, sides.local, x, ridges, area, midpoint)
    return SideGeometry(sides.facet, area, midpoint, ridge, direction)


def _areas_and_midpoints(
    cell_type: basix.CellType, local: Indices, x: Array
) -> tuple[Array, Array]:
    """Return the outward area vector and the midpoint of the facet of each side, (n, gdim) each.

    Args:
        cell_type: Type of the cells.
        local: Local number of the facet of each side in its cell, (n,).
        x: Vertices of the cell of each side, (n, vertices, gdim).
    """
    n, _, gdim = x.shape
    area = np.zeros((n, gdim))
    midpoint = np.zeros((n, gdim))
    for number, vertices in enumerate(basix.topology(cell_type)[gdim - 1]):
        rows = np.flatnonzero(local == number)
        corners = x[rows][:, vertices]
        midpoint[rows] = corners.mean(axis=1)
        outward = midpoint[rows] - x[rows].mean(axis=1)
        normal = _area_vector(corners)
        points_outward = np.sum(normal * outward, axis=1) > 0.0
        area[rows] = np.where(points_outward[:, None], normal, -normal)
    return area, midpoint


def _ridges(
    cell_type: basix.CellType,
    local: Indices,
    x: Array,
    ridges: Numbers,
    area: Array,
    midpoint: Array,
) -> tuple[Numbers, Array]:
    """Return the ridges of the facet of each side, and their directions, (n, r) each.

    Args:
        cell_type: Type of the cells.
        local: Local number of the facet of each side in its cell, (n,).
        x: Vertices of the cell of each side, (n, vertices, gdim).
        ridges: Numbers, over all processes, of the ridges of this cell, (n, ridges of the cell).
        area: Area vector of each side, (n, gdim).
        midpoint: Midpoint of each facet, (n, gdim).
    """
    n, _, tdim = x.shape
    vertices_of_ridge = basix.topology(cell_type)[tdim - 2]
    ridges_of_facet = basix.cell.sub_entity_connectivity(cell_type)[tdim - 1]
    n_ridges = max(len(facet[tdim - 2]) for facet in ridges_of_facet)
    ridge = np.zeros((n, n_ridges), dtype=np.int64)
    direction = np.zeros((n, n_ridges))
    for number, entities in enumerate(ridges_of_facet):
        rows = np.flatnonzero(local == number)
        for k, ridge_in_cell in enumerate(entities[tdim - 2]):
            ridge[rows, k] = ridges[rows, ridge_in_cell]
            ends = x[rows][:, vertices_of_ridge[ridge_in_cell]]
            direction[rows, k] = _ridge_direction(area[rows], ends, midpoint[rows])
    return ridge, direction


def _area_vector(corners: Array) -> Array:
    """Return a normal of each facet times its area, (n, gdim), from its corners.

    Args:
        corners: (n, corners, gdim). In 1D a facet is a point, of area one.
    """
    n, count, gdim = corners.shape
    if gdim == 1:
        return np.ones((n, 1))
    if gdim == 2:
        along = corners[:, 1] - corners[:, 0]
        return np.column_stack([-along[:, 1], along[:, 0]])
    if count == 3:
        a = corners[:, 1] - corners[:, 0]
        b = corners[:, 2] - corners[:, 0]
    else:  # the diagonals of a quadrilateral
        a = corners[:, 3] - corners[:, 0]
        b = corners[:, 2] - corners[:, 1]
    return np.asarray(np.cross(a, b) / 2.0)


def _ridge_direction(normal: Array, ends: Array, midpoint: Array) -> Array:
    """Return the direction that normals give to one ridge of each facet, +1 or −1, (n,).

    In 3D it is +1 if the edge runs counter-clockwise around the normal, from the end with the
    smaller coordinate to the other. In 2D the normal is turned by 90° into the facet, and it is +1
    if that points from the midpoint to the end point.

    Args:
        normal: Normals, (n, gdim).
        ends: Vertices of the ridge, (n, 1, 2) in 2D and (n, 2, 3) in 3D.
        midpoint: Midpoints of the facets, (n, gdim).
    """
    outward = ends.mean(axis=1) - midpoint
    if normal.shape[1] == 2:
        return np.sign(normal[:, 0] * outward[:, 1] - normal[:, 1] * outward[:, 0])
    along = ends[:, 1] - ends[:, 0]
    axis = np.argmax(along != 0.0, axis=1)  # exact: both facets have the same two vertices
    along = along * np.sign(along[np.arange(len(along)), axis])[:, None]
    return np.asarray(np.sign(np.sum(np.cross(normal, outward) * along, axis=1)))


def _entities_of_cells(mesh: dolfinx.mesh.Mesh, dim: int) -> Indices:
    """Return the entities of a dimension of each owned cell, (cells, entities)."""
    topology = mesh.topology
    topology.create_connectivity(topology.dim, dim)
    links = topology.connectivity(topology.dim, dim)
    owned = topology.index_map(topology.dim).size_local
    width = int(links.offsets[1]) if owned else 0
    return links.array[: owned * width].reshape(owned, width)


def _global_numbers(index_map: dolfinx.common.IndexMap) -> Numbers:
    """Return the number over all processes of each local entity, ghosts included."""
    count = index_map.size_local + index_map.num_ghosts
    return np.asarray(index_map.local_to_global(np.arange(count, dtype=np.int32)))


def _global_numbers_of(mesh: dolfinx.mesh.Mesh, dim: int) -> Numbers:
    """Return the numbers, over all processes, of the entities of each owned cell. Collective.

    dolfinx creates entities at the first call only.
    """
    mesh.topology.create_entities(dim)
    return _global_numbers(mesh.topology.index_map(dim))[_entities_of_cells(mesh, dim)]


def _sums(label: Numbers, values: Array, count: int) -> Array:
    """Return the sum of the rows of each label, (count, gdim)."""
    return np.column_stack([np.bincount(label, column, count) for column in values.T])
