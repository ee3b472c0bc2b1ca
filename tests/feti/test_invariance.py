# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The same solution on any number of processes and with any, also random, subdomains."""

from dataclasses import replace

from mpi4py import MPI

import numpy as np
import pytest
from cases import each, every_type
from collective import COMM, agree, equal, norm, small, whole
from mixed import by_place
from problems import Cell, cube, elasticity, left, owned, poisson, torn

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


def ragged(problem, rng):
    """Random cells to random parts, most of them in pieces that touch in edges and vertices."""
    return rng.integers(0, rng.integers(2, 9), problem.cells)


def singles(problem, rng):
    """Every cell its own."""
    return np.arange(problem.cells)


def large(problem, rng):
    """One large subdomain and some single cells."""
    cells = np.arange(problem.cells)
    return np.where(cells % 5 == 0, 1 + cells // 5, 0)


def rings(problem, rng):
    """Around the middle: subdomains that enclose others."""
    cells = np.arange(problem.cells, dtype=np.int32)
    centre = dolfinx.mesh.compute_midpoints(problem.V.mesh, 2, cells)
    return np.round(7 * np.abs(centre[:, :2] - 0.5).max(axis=1)).astype(np.int32)


@every_mesh
@every_type
@every_equation
@pytest.mark.parametrize(("parts", "seed"), [(ragged, 83), (ragged, 1291), (singles, 0)])
def test_any_parts(mesh, kind, create, parts, seed, solve):
    problem = create(cube(*mesh))
    part = parts(problem, np.random.default_rng(seed + COMM.rank))
    report = check(problem, part, kind, solve)
    agree(report.subdomains >= 2)
    if parts is singles:
        agree(report.subdomains == COMM.allreduce(problem.cells))
        if create is elasticity and mesh is MESHES["triangles"] and kind == "classical":
            agree(report.kernels[1] > 0, "a vertex on the clamped side leaves a rotation")


@every_type
@pytest.mark.parametrize(
    ("parts", "mesh", "degree", "pc_type", "q"),
    [
        (ragged, (2, 5), 1, "lumped", "diagonal"),
        (ragged, (2, 5), 1, "identity", "diagonal"),
        (large, (3, 2), 1, "dirichlet", "preconditioner"),
        (large, (3, 2), 2, "dirichlet", "preconditioner"),
        (rings, (2, 7, Cell.quadrilateral), 1, "dirichlet", "preconditioner"),
    ],
)
def test_other_parts_and_options(kind, parts, mesh, degree, pc_type, q, solve):
    problem = elasticity(cube(*mesh), degree=degree, stretched=True)
    part = parts(problem, np.random.default_rng(40099 + COMM.rank))
    check(problem, part, kind, solve, feti_pc_type=pc_type, feti_coarse_q=q)


@every_mesh
@every_type
@pytest.mark.parametrize("seed", [83, 1291, 40099])
def test_random_dirichlet_conditions(mesh, kind, seed, solve):
    """Single components of single nodes with random values, on top of one that holds the body."""
    problem = elasticity(cube(*mesh))
    bcs = list(problem.bcs)
    for j in range(problem.V.mesh.geometry.dim):
        part = problem.V.sub(j)
        g = dolfinx.fem.Function(part.collapse()[0])
        g.interpolate(lambda x, j=j: np.cos(5.0 * x[0] + j) * x[1])

        def lottery(x, j=j):  # by coordinates, so that all processes agree on shared nodes
            return (np.sin(1e4 * ([1.7, 2.9, 4.1] @ x) + seed * (j + 1)) > 0.8) & ~left(x)

        dofs = dolfinx.fem.locate_dofs_geometrical((part, g.function_space), lottery)
        bcs.append(dolfinx.fem.dirichletbc(g, dofs, part))
    rng = np.random.default_rng(seed + 7 * COMM.rank)
    check(replace(problem, bcs=bcs), rng.integers(0, 5, problem.cells), kind, solve)
