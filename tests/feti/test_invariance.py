# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The same solution on any number of processes and with any, also random, subdomains."""

from mpi4py import MPI

import numpy as np
import pytest
from cases import each, every_type
from collective import COMM, agree, equal, norm, small, whole
from mixed import by_place
from problems import Cell, Problem, cube, elasticity, left, owned, poisson, torn

import dolfinx

PROBLEMS = {
    "elasticity": (elasticity, (3, 4, Cell.tetrahedron), {"stretched": True}),
    "quadratic elasticity": (elasticity, (2, 6, Cell.triangle), {"degree": 2}),
    "hexahedra": (elasticity, (3, 4, Cell.hexahedron), {}),
    "Poisson": (poisson, (2, 8, Cell.quadrilateral), {"degree": 2, "stretched": True}),
}


@each(("create", "mesh", "options"), PROBLEMS)
@every_type
def test_solution_does_not_depend_on_the_decomposition(create, mesh, options, kind, solve):
    """1, 4 and 64 subdomains, against a direct solve of the whole problem on each process."""
    alone = create(cube(*mesh, comm=MPI.COMM_SELF), **options)
    u = dolfinx.fem.Function(alone.V)
    u.x.array[:] = alone.solve_directly()
    expected = by_place(u)
    together = create(cube(*mesh), **options)
    for subdomains in (1, 4, 64):
        linear = solve(together, subdomains, {"feti_type": kind, "ksp_rtol": 1e-11})
        equal(by_place(linear.u), expected, 1e-8)
        report = linear.solver.getPythonContext().report()
        agree(report.subdomains >= max(subdomains, COMM.size))


def test_process_alone_solves_its_own_problem():
    """On MPI.COMM_SELF nothing is collective on the world: each process has other subdomains."""
    problem = elasticity(cube(2, 5, comm=MPI.COMM_SELF), stretched=True)
    linear = torn(problem, 3 + COMM.rank, f"process{COMM.rank}_", ksp_rtol=1e-11)
    linear.solve()
    equal(owned(linear.u), problem.solve_directly(), 1e-8)
    agree(linear.solver.getPythonContext().report().subdomains == 3 + COMM.rank)


def test_same_solution_at_the_default_tolerance(solve):
    """The assembled residual is the judge: all choices end within the same error."""
    problem = elasticity(cube(2, 8), stretched=True)
    expected = whole(problem.solve_directly())
    for options in (
        {},
        {"feti_type": "classical", "feti_pc_type": "lumped"},
        {"feti_pc_type": "identity", "feti_coarse_q": "identity"},
        {"feti_dual_ksp_type": "gmres"},
    ):
        linear = solve(problem, 8, options)
        agree(linear.solver.getPythonContext().residual <= 1e-8)
        equal(whole(owned(linear.u)), expected, 1e-6)


# ---- random subdomains and conditions -------------------------------------------------------

SEEDS = (83, 1291, 40099)

MESHES = {
    "triangles": (2, 4, Cell.triangle),
    "quadrilaterals": (2, 5, Cell.quadrilateral),
    "tetrahedra": (3, 2, Cell.tetrahedron),
    "hexahedra": (3, 3, Cell.hexahedron),
}
every_mesh = each("mesh", MESHES)
every_equation = pytest.mark.parametrize("create", [poisson, elasticity])


def check(problem, part, kind, solve, **options):
    linear = solve(problem, part, {"feti_type": kind, "ksp_rtol": 1e-11, **options})
    expected = problem.solve_directly()
    small(norm(owned(linear.u) - expected) / norm(expected), 1e-7)
    return linear.solver.getPythonContext().report()


@every_mesh
@every_type
@every_equation
@pytest.mark.parametrize("seed", SEEDS[:2])
def test_random_cells_to_random_parts(mesh, kind, create, seed, solve):
    """Ragged subdomains, most of them in pieces that touch in edges and vertices."""
    problem = create(cube(*mesh))
    rng = np.random.default_rng(seed + COMM.rank)
    part = rng.integers(0, rng.integers(2, 9), problem.cells)
    report = check(problem, part, kind, solve)
    agree(report.subdomains >= 2)


@every_mesh
@every_type
@every_equation
def test_every_cell_its_own(mesh, kind, create, solve):
    problem = create(cube(*mesh))
    report = check(problem, np.arange(problem.cells), kind, solve)
    agree(report.subdomains == COMM.allreduce(problem.cells))
    if create is elasticity and mesh is MESHES["triangles"] and kind == "classical":
        agree(report.kernels[1] > 0, "a vertex on the clamped side leaves a rotation")


@every_type
@pytest.mark.parametrize("degree", [1, 2])
def test_one_large_subdomain_and_some_single_cells(kind, degree, solve):
    problem = elasticity(cube(3, 2), degree=degree)
    part = np.zeros(problem.cells, dtype=np.int64)
    part[::5] = 1 + np.arange(len(part[::5]))
    check(problem, part, kind, solve)


@every_mesh
@every_type
@pytest.mark.parametrize("seed", SEEDS)
def test_random_dirichlet_conditions(mesh, kind, seed, solve):
    """Single components of single nodes with random values, on top of one that holds the body."""
    problem = elasticity(cube(*mesh))
    V, dim = problem.V, problem.V.mesh.geometry.dim
    x = V.tabulate_dof_coordinates()
    bcs = list(problem.bcs)
    for j in range(dim):
        # by coordinates, so that all processes agree on shared nodes
        lottery = np.sin(1e4 * (x @ np.array([1.7, 2.9, 4.1])) + seed * (j + 1))
        nodes = np.flatnonzero((lottery > 0.8) & ~left(x.T)).astype(np.int32)
        part = V.sub(j)
        collapsed, sub_map = part.collapse()
        inverse = np.full(len(x), -1, dtype=np.int32)
        sub_map = np.ravel(sub_map)
        inverse[sub_map // dim] = np.arange(len(sub_map), dtype=np.int32)
        g = dolfinx.fem.Function(collapsed)
        g.interpolate(lambda x, j=j: np.cos(5.0 * x[0] + j) * x[1])
        dofs = [nodes * dim + j, inverse[nodes]]
        bcs.append(dolfinx.fem.dirichletbc(g, dofs, part))
    many = Problem(V, problem.a, problem.L, bcs)
    rng = np.random.default_rng(seed + 7 * COMM.rank)
    check(many, rng.integers(0, 5, problem.cells), kind, solve)


@every_type
@pytest.mark.parametrize("pc_type", ["lumped", "identity"])
def test_random_parts_with_other_options(kind, pc_type, solve):
    problem = elasticity(cube(2, 5), stretched=True)
    rng = np.random.default_rng(SEEDS[2] + COMM.rank)
    options = {"feti_pc_type": pc_type, "feti_coarse_q": "diagonal"}
    check(problem, rng.integers(0, 7, problem.cells), kind, solve, **options)


@every_type
def test_parts_with_holes_and_islands(kind, solve):
    """Rings around a cell: subdomains that enclose others."""
    problem = elasticity(cube(2, 7, Cell.quadrilateral))
    mesh = problem.V.mesh
    centre = dolfinx.mesh.compute_midpoints(mesh, 2, np.arange(problem.cells, dtype=np.int32))
    ring = np.round(7 * np.abs(centre[:, :2] - 0.5).max(axis=1)).astype(np.int32)
    check(problem, ring, kind, solve)
