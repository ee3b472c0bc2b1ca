# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Decompositions of the mesh are reproducible, and their dof map tears the space."""

from __future__ import annotations

import json
import os

import numpy as np
import pytest
import scipy.sparse
import scipy.sparse.csgraph
from bodies import block, yeoh
from cases import each
from collective import COMM, agree, equal, small, whole
from problems import Cell, cube, poisson
from programs import finish, start
from walls import tube

import dolfinx

from dolfinx_feti import LinearProblem, NonlinearProblem
from dolfinx_feti.fem import decomposition
from dolfinx_feti.fem.decomposition import decompose, suggested_number, tear
from dolfinx_feti.runtime.scotch import VARIABLES, repeatable_partitions

SEED = 31415

MESHES = {
    "triangles": (2, 6, Cell.triangle),
    "quadrilaterals": (2, 5, Cell.quadrilateral),
    "tetrahedra": (3, 3, Cell.tetrahedron),
    "hexahedra": (3, 3, Cell.hexahedron),
    "prisms": (3, 3, Cell.prism),
}
every_mesh = each("mesh", MESHES)


def cells(mesh):
    """Return the number of owned cells."""
    return mesh.topology.index_map(mesh.topology.dim).size_local


def neighbours(mesh, n):
    """Return the graph of owned cells with a common facet, of as many vertices as dimensions."""
    vertices = mesh.topology.connectivity(mesh.topology.dim, 0)
    ends = vertices.offsets[: n + 1]
    incidence = scipy.sparse.csr_array((np.ones(ends[-1]), vertices.array[: ends[-1]], ends))
    graph = scipy.sparse.csr_array(incidence @ incidence.T)
    graph.data[graph.data < mesh.topology.dim] = 0.0
    graph.eliminate_zeros()
    return graph


def pieces(graph, members):
    """Return the number of facet-connected components of some cells."""
    inside = graph[members][:, members]
    return scipy.sparse.csgraph.connected_components(inside, directed=False)[0]


@every_mesh
@pytest.mark.parametrize("subdomains", [1, 2, 7, 20, "every cell"])
def test_parts_are_balanced_connected_and_of_the_number_asked_for(mesh, subdomains):
    """Subdomains are connected, of similar size, and as many as requested."""
    mesh = cube(*mesh)
    n = cells(mesh)
    subdomains = COMM.allreduce(n) if subdomains == "every cell" else subdomains
    decomposition = decompose(mesh, subdomains)
    part = decomposition.subdomain
    agree(part.dtype == np.int32 and part.shape == (n,))
    equal(np.unique(part), np.arange(decomposition.count))
    graph = neighbours(mesh, n)
    agree(all(pieces(graph, np.flatnonzero(part == i)) == 1 for i in range(decomposition.count)))
    counts = COMM.allgather(decomposition.count)
    agree(decomposition.first == sum(counts[: COMM.rank]))
    total = sum(counts)
    connected = COMM.allreduce(pieces(graph, np.arange(n)) if n else 0)
    expected = max(subdomains, COMM.size)
    # a part of the partitioner may be in pieces
    agree(expected <= total <= 1.3 * expected + COMM.size + connected)
    sizes = whole(np.bincount(part, minlength=decomposition.count))
    small(sizes.max(), 2.5 * sizes.sum() / len(sizes) + 1)


@pytest.mark.parametrize("processes", [2, 16, 512])
@pytest.mark.parametrize("each", [1, 2, 7])
def test_shares_are_in_proportion_to_cells(processes, each):
    """Processes with similar numbers of cells have equally many subdomains."""
    cells = 1000 + np.random.default_rng(SEED).integers(-60, 60, processes)
    agree(np.all(decomposition._shares(each * processes, cells) == each))
    agree(decomposition._shares(8, np.array([300, 100, 0])).tolist() == [6, 2, 0])
    agree(decomposition._shares(7, np.array([300, 100, 3])).tolist() == [5, 2, 1])


@every_mesh
@pytest.mark.parametrize("dtype", [np.int8, np.int32, np.int64, np.uint16])
def test_parts_may_be_prescribed(mesh, dtype):
    """Each facet-connected part with a prescribed number is a subdomain."""
    mesh = cube(*mesh)
    n = cells(mesh)
    part = (np.random.default_rng(SEED + COMM.rank).integers(0, 3, n) * 20 + 7).astype(dtype)
    decomposition = decompose(mesh, part)
    graph = neighbours(mesh, n)
    expected = [pieces(graph, np.flatnonzero(part == value)) for value in np.unique(part)]
    agree(decomposition.count == sum(expected), (decomposition.count, expected))
    owner = {(int(a), int(b)) for a, b in zip(decomposition.subdomain, part, strict=True)}
    agree(len(owner) == decomposition.count)  # no subdomain holds cells of two parts


# ---- the torn space -------------------------------------------------------------------------


@every_mesh
@pytest.mark.parametrize(
    ("family", "degree", "components"),
    [("P", 1, None), ("P", 2, None), ("P", 1, "dim"), ("P", 3, "dim"), ("DG", 0, None)],
)
def test_torn_dofs_are_pairs_of_subdomain_and_dof(mesh, family, degree, components):
    """The torn dofs are the pairs of a subdomain and a dof of its cells, each once."""
    if mesh[2] == Cell.prism and family == "P":
        degree = 1  # dolfinx has no dofs inside of facets of two types
    mesh = cube(*mesh)
    shape = () if components is None else ((mesh.geometry.dim,),)
    V = dolfinx.fem.functionspace(mesh, (family, degree, *shape))
    decomposition = decompose(mesh, 5)
    space = tear(V, decomposition)
    n = cells(mesh)
    table = space.V_torn.dofmap.list
    equal(space.local_block[table[:n]], V.dofmap.list[:n])
    subdomain = np.full(len(space.local_block), -1)
    subdomain[table[:n]] = decomposition.subdomain[:, None]
    agree(np.all(subdomain >= 0) and np.all(np.diff(subdomain) >= 0))  # numbered by subdomains
    equal(subdomain[table[:n]], np.broadcast_to(decomposition.subdomain[:, None], table[:n].shape))
    pairs = np.unique(np.column_stack([subdomain, space.local_block]), axis=0)
    agree(len(pairs) == len(space.local_block))
    equal(space.global_block, V.dofmap.index_map.local_to_global(space.local_block))
    agree(space.V_torn.dofmap.index_map_bs == V.dofmap.index_map_bs)
    agree(space.V_torn.mesh is mesh and space.V_torn.ufl_element() == V.ufl_element())
    copies = np.bincount(whole(space.global_block), minlength=V.dofmap.index_map.size_global)
    agree(copies.min() >= 1)
    if family == "DG":
        agree(copies.max() == 1)


def path_graph(*lengths):
    """Return the graph of disjoint paths with these numbers of cells."""
    ones = [np.ones(n - 1, dtype=np.int8) for n in lengths]
    paths = [scipy.sparse.diags_array([a, a], offsets=[-1, 1]) for a in ones]
    return scipy.sparse.csr_array(scipy.sparse.block_diag(paths))


@pytest.mark.parametrize(
    ("part", "expected"),
    [
        ([0, 0, 1, 0, 1, 1], [0, 0, 0, 1, 1, 1]),  # the lone 1 and the lone 0 change sides
        ([0, 0, 0, 1, 0, 0, 1, 1], [0, 0, 0, 0, 1, 1, 1, 1]),
        ([0, 1, 2], [0, 1, 2]),
        ([0, 1, 0, 1], None),  # as large as each other: any result with two connected parts
        ([0, 0, 0], [0, 0, 0]),
    ],
)
def test_splinters_join_their_neighbours(part, expected):
    """Splinters of a part join a neighbour, except those without one."""
    graph = path_graph(len(part))
    joined = decomposition._join_splinters(graph, np.array(part, dtype=np.int32))
    if expected is not None:
        equal(joined, expected)
    agree(len(np.unique(decomposition._facet_components(graph, joined))) == len(np.unique(part)))
    alone = np.zeros(5, dtype=np.int32)
    equal(decomposition._join_splinters(path_graph(3, 2), alone), alone)


@pytest.mark.parametrize("subdomains", [5, 8, 17, 40])
def test_number_of_subdomains_is_as_asked(subdomains):
    """A ring has at least the requested subdomains, and exactly those on one process."""
    mesh = tube(around=60)
    alone = mesh.comm.size == 1
    made = whole(np.array([decompose(mesh, subdomains).count]))
    if alone:
        agree(made.sum() == subdomains, made)
    agree(made.sum() >= subdomains, made)


# -- a number of subdomains where the user gives none


@pytest.mark.parametrize("components", [1, 3])
def test_suggested_subdomains_are_of_similar_size(monkeypatch, components):
    """The suggested subdomains are of similar size, equally many on each process."""
    mesh = cube(3, 4)
    shape = () if components == 1 else (components,)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, shape))
    agree(suggested_number(V) == COMM.size, "some hundred dofs")
    monkeypatch.setattr(decomposition, "DOFS_PER_SUBDOMAIN", 20)
    number = suggested_number(V)
    agree(number % COMM.size == 0)
    agree(abs(number - components * 5**3 / 20) <= COMM.size / 2, number)
    monkeypatch.setattr(decomposition, "DOFS_PER_SUBDOMAIN", 0.1)
    few = dolfinx.fem.functionspace(cube(2, 2), ("Lagrange", 2))
    agree(suggested_number(few) == COMM.allreduce(decompose(few.mesh, 8).count) == 8)


# -- every run


@pytest.mark.serial
@pytest.mark.parametrize("processes", [1, 2])
def test_two_runs_and_two_problems_of_one_run(tmp_path, processes):
    """Two runs, and two problems of one run, have the same decomposition."""
    files = [tmp_path / f"{i}.json" for i in range(2)]
    for file in files:
        finish(start("cut", file, processes=processes))
    first, second = (json.loads(file.read_text()) for file in files)
    assert first == second
    for same, again, other in first:
        assert same == again == first[0][0]
        assert len({(process, part) for _, process, part in same}) == 12
        assert {process for _, process, _ in same} == set(range(processes))
        assert other != same


def test_seed_of_a_problem():
    """Another ``seed=`` changes the subdomains and not the solution, of both problem classes."""
    body = block(yeoh, (0.3, 0.1))
    problem = poisson(cube(3, 6))
    nonlinear = NonlinearProblem(body.energy, body.u, body.bcs, subdomains=5, seed=2)
    expected = decompose(body.u.function_space.mesh, 5, seed=2).subdomain
    equal(nonlinear.decomposition.subdomain, expected)
    parts = []
    solutions = []
    for seed in (0, 1):
        linear = LinearProblem(problem.a, problem.L, problem.bcs, subdomains=8, seed=seed)
        solutions.append(linear.solve().x.array)
        parts.append(linear.decomposition.subdomain)
        equal(parts[seed], decompose(problem.V.mesh, 8, seed=seed).subdomain)
    agree(COMM.allreduce(int(np.count_nonzero(parts[0] != parts[1]))) > 0)
    equal(solutions[1], solutions[0], 1e-6)


@pytest.mark.serial
def test_scotch_variables_of_the_user_are_kept(monkeypatch):
    """SCOTCH's variables that the user has set are used, and others are unset afterwards."""
    one, other = VARIABLES
    monkeypatch.setenv(one, "4")
    monkeypatch.delenv(other, raising=False)
    with repeatable_partitions():
        assert (os.environ[one], os.environ[other]) == ("4", "1")
    assert os.environ[one] == "4" and other not in os.environ
