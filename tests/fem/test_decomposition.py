# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Cutting the mesh, and the second dof map that tears the space."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse
import scipy.sparse.csgraph
from collective import COMM, agree, equal, small, whole
from problems import Cell, cube
from walls import tube

import dolfinx
import ufl

from dolfinx_feti.fem import decomposition
from dolfinx_feti.fem.decomposition import decompose, suggested_number, tear

SEED = 31415

MESHES = {
    "triangles": (2, 6, Cell.triangle),
    "quadrilaterals": (2, 5, Cell.quadrilateral),
    "tetrahedra": (3, 3, Cell.tetrahedron),
    "hexahedra": (3, 3, Cell.hexahedron),
    "prisms": (3, 3, Cell.prism),
}
every_mesh = pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)


def cells(mesh):
    return mesh.topology.index_map(mesh.topology.dim).size_local


def neighbours(mesh, n):
    """Graph of owned cells with a common facet: as many common vertices as dimensions."""
    vertices = mesh.topology.connectivity(mesh.topology.dim, 0)
    ends = vertices.offsets[: n + 1]
    incidence = scipy.sparse.csr_array((np.ones(ends[-1]), vertices.array[: ends[-1]], ends))
    graph = scipy.sparse.csr_array(incidence @ incidence.T)
    graph.data *= graph.data >= mesh.topology.dim
    graph.eliminate_zeros()
    return graph


def pieces(graph, members):
    """Number of facet-connected components of some cells."""
    inside = graph[members][:, members]
    return scipy.sparse.csgraph.connected_components(inside, directed=False)[0]


@every_mesh
@pytest.mark.parametrize("subdomains", [1, 2, 7, 20])
def test_parts_are_balanced_connected_and_of_the_number_asked_for(mesh, subdomains):
    mesh = cube(*mesh)
    n = cells(mesh)
    decomposition = decompose(mesh, subdomains)
    part = decomposition.subdomain
    agree(part.dtype == np.int32 and part.shape == (n,))
    equal(np.unique(part), np.arange(decomposition.count))
    graph = neighbours(mesh, n)
    agree(all(pieces(graph, np.flatnonzero(part == i)) == 1 for i in range(decomposition.count)))
    total = COMM.allreduce(decomposition.count)
    connected = COMM.allreduce(pieces(graph, np.arange(n)) if n else 0)
    expected = max(subdomains, COMM.size)
    # a part of the partitioner may be in pieces
    agree(expected <= total <= 1.3 * expected + COMM.size + connected, (total, expected))
    sizes = whole(np.bincount(part, minlength=decomposition.count))
    small(sizes.max(), 2.5 * sizes.sum() / len(sizes) + 1)


def test_every_cell_a_subdomain():
    mesh = cube(2, 3)
    total = COMM.allreduce(cells(mesh))
    decomposition = decompose(mesh, total)
    agree(COMM.allreduce(decomposition.count) == total)
    agree(decomposition.count == cells(mesh))


@pytest.mark.parametrize("processes", [2, 16, 512])
@pytest.mark.parametrize("each", [1, 2, 7])
def test_processes_of_about_as_many_cells_have_as_many_subdomains(processes, each):
    """Otherwise the others wait; ends that are rounded from one process to the next drift."""
    cells = 1000 + np.random.default_rng(SEED).integers(-60, 60, processes)
    agree(np.all(decomposition._shares(each * processes, cells) == each))


def test_shares_are_in_proportion_to_cells():
    agree(decomposition._shares(8, np.array([300, 100, 0])).tolist() == [6, 2, 0])
    agree(decomposition._shares(7, np.array([300, 100, 3])).tolist() == [5, 2, 1])


def test_subdomains_are_numbered_from_process_to_process():
    decomposition = decompose(cube(2, 6), 9)
    counts = COMM.allgather(decomposition.count)
    agree(decomposition.first == sum(counts[: COMM.rank]))


@every_mesh
@pytest.mark.parametrize("dtype", [np.int8, np.int32, np.int64, np.uint16])
def test_parts_may_be_prescribed(mesh, dtype):
    """Any numbers from zero; parts that are not connected fall into their components."""
    mesh = cube(*mesh)
    n = cells(mesh)
    part = (np.random.default_rng(SEED + COMM.rank).integers(0, 3, n) * 20 + 7).astype(dtype)
    decomposition = decompose(mesh, part)
    graph = neighbours(mesh, n)
    expected = [pieces(graph, np.flatnonzero(part == value)) for value in np.unique(part)]
    agree(decomposition.count == sum(expected), (decomposition.count, expected))
    owner = {(int(a), int(b)) for a, b in zip(decomposition.subdomain, part, strict=True)}
    agree(len(owner) == decomposition.count)  # no subdomain holds cells of two parts


def test_parts_that_touch_in_a_vertex_are_two():
    """A checkerboard of quadrilaterals: every cell is a subdomain of its own."""
    mesh = cube(2, 4, Cell.quadrilateral)
    centre = dolfinx.mesh.compute_midpoints(mesh, 2, np.arange(cells(mesh), dtype=np.int32))
    colour = (np.floor(4 * centre[:, 0]) + np.floor(4 * centre[:, 1])).astype(np.int32) % 2
    agree(decompose(mesh, colour).count == cells(mesh))


# ---- the torn space -------------------------------------------------------------------------


@every_mesh
@pytest.mark.parametrize(("degree", "components"), [(1, None), (2, None), (1, "dim"), (3, "dim")])
def test_torn_dofs_are_pairs_of_subdomain_and_dof(mesh, degree, components):
    if mesh[2] == Cell.prism:
        degree = 1  # dolfinx has no dofs inside of facets of two types
    mesh = cube(*mesh)
    shape = () if components is None else ((mesh.geometry.dim,),)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", degree, *shape))
    decomposition = decompose(mesh, 5)
    space = tear(V, decomposition)
    n, table = cells(mesh), space.V_torn.dofmap.list
    equal(space.dof[table[:n]], V.dofmap.list[:n])
    subdomain = np.full(len(space.dof), -1)
    subdomain[table[:n]] = decomposition.subdomain[:, None]
    agree(np.all(subdomain >= 0) and np.all(np.diff(subdomain) >= 0))  # numbered by subdomains
    equal(subdomain[table[:n]], np.broadcast_to(decomposition.subdomain[:, None], table[:n].shape))
    pairs = np.unique(np.column_stack([subdomain, space.dof]), axis=0)
    agree(len(pairs) == len(space.dof))
    equal(space.to_global, V.dofmap.index_map.local_to_global(space.dof))
    agree(space.V_torn.dofmap.index_map_bs == V.dofmap.index_map_bs)
    copies = np.bincount(whole(space.to_global), minlength=V.dofmap.index_map.size_global)
    agree(copies.min() >= 1)


def test_one_subdomain_a_process_keeps_the_dofs():
    mesh = cube(2, 6)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2))
    space = tear(V, decompose(mesh, 1))
    used = np.unique(V.dofmap.list[: cells(mesh)])
    connected = len(np.unique(space.dof)) == len(space.dof)  # the cells of the process
    agree(np.array_equal(space.dof, used) or not connected)
    equal(np.unique(space.dof), used)


def test_discontinuous_space_is_torn_already():
    mesh = cube(3, 2)
    V = dolfinx.fem.functionspace(mesh, ("DG", 0))
    space = tear(V, decompose(mesh, 6))
    agree(len(space.dof) == cells(mesh))
    equal(np.sort(space.dof), np.unique(V.dofmap.list[: cells(mesh)]))


def test_torn_space_shares_mesh_and_element():
    mesh = cube(2, 4)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (2,)))
    V_torn = tear(V, decompose(mesh, 4)).V_torn
    agree(V_torn.mesh is mesh and V_torn.ufl_element() == V.ufl_element())
    agree(ufl.TestFunction(V_torn).ufl_shape == (2,))


def path_graph(n):
    a = np.arange(n - 1)
    ones = np.ones(2 * n - 2, dtype=np.int8)
    entries = np.concatenate([a, a + 1]), np.concatenate([a + 1, a])
    return scipy.sparse.csr_array((ones, entries), shape=(n, n))


@pytest.mark.parametrize(
    ("part", "expected"),
    [
        ([0, 0, 1, 0, 1, 1], [0, 0, 0, 1, 1, 1]),  # the lone 1 and the lone 0 change sides
        ([0, 0, 0, 1, 0, 0, 1, 1], [0, 0, 0, 0, 1, 1, 1, 1]),
        ([0, 1, 2], [0, 1, 2]),
        ([0, 1, 0, 1], None),  # as large as each other: any result with two connected parts
    ],
)
def test_splinters_join_their_neighbours(part, expected):
    graph = path_graph(len(part))
    joined = decomposition._join_splinters(graph, np.array(part, dtype=np.int32))
    agree(expected is None or list(joined) == expected, joined)
    agree(len(np.unique(decomposition._facet_components(graph, joined))) == len(np.unique(part)))


def test_splinters_without_a_neighbour_stay():
    """Two paths that nothing connects, in one part."""
    graph = scipy.sparse.csr_array(scipy.sparse.block_diag([path_graph(3), path_graph(2)]))
    part = np.zeros(5, dtype=np.int32)
    equal(decomposition._join_splinters(graph, part), part)


@pytest.mark.parametrize("subdomains", [5, 8, 17, 40])
def test_number_of_subdomains_is_as_asked(subdomains):
    """On a ring, which the partitioner likes to cut into parts of several pieces."""
    mesh = tube(around=60)
    alone = mesh.comm.size == 1
    made = whole(np.array([decompose(mesh, subdomains).count]))
    agree(made.sum() == subdomains or not alone, made)
    agree(made.sum() >= subdomains)


# -- a number of subdomains where the user gives none


@pytest.mark.parametrize("components", [1, 3])
def test_suggested_number(monkeypatch, components):
    """About so many dofs each, as many on each process, and one at least."""
    mesh = cube(3, 4)
    shape = () if components == 1 else (components,)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, shape))
    dofs = components * 5**3
    agree(suggested_number(V) == COMM.size, "some hundred dofs")
    monkeypatch.setattr(decomposition, "DOFS", 20)
    number = suggested_number(V)
    agree(number % COMM.size == 0)
    agree(abs(number - dofs / 20) <= COMM.size / 2, number)


def test_suggested_number_is_not_that_of_more_than_all_cells(monkeypatch):
    V = dolfinx.fem.functionspace(cube(2, 2), ("Lagrange", 2))
    monkeypatch.setattr(decomposition, "DOFS", 0.1)
    agree(suggested_number(V) == 8)
    agree(COMM.allreduce(decompose(V.mesh, suggested_number(V)).count) == 8)
