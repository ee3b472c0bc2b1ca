# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Solutions by FETI agree with a direct solver, for any equation, element and decomposition."""

import itertools
from dataclasses import replace

from mpi4py import MPI

import numpy as np
import pytest
from cases import each, every_formulation, every_type
from collective import COMM, agree, equal, norm, raises, small, uniform, whole
from mixed import by_place
from problems import (
    Cell,
    cube,
    dirichlet,
    elasticity,
    everywhere,
    left,
    owned,
    poisson,
    torn,
    with_bubbles,
)

import basix.ufl
import dolfinx
import ufl

from dolfinx_feti import ConvergenceError
from dolfinx_feti.fem.decomposition import tear
from dolfinx_feti.feti.interface.scaling import SCALINGS

TOLERANCE = 1e-7  # for a residual of 1e-10 and condition numbers up to 1e3


def relative_difference(u, expected):
    """Return ‖u − expected‖ / ‖expected‖ of vectors of which each process has its owned dofs."""
    return norm(u - expected) / norm(expected)


@every_type
@pytest.mark.parametrize(
    ("degree", "pc_type"),
    [(1, "dirichlet"), (1, "lumped"), (1, "identity"), (2, "dirichlet"), (2, "lumped")],
)
def test_every_scaling_and_projection_gives_the_direct_solution(kind, degree, pc_type, create_ksp):
    """Elasticity on tetrahedra is solved with each preconditioner, scaling and weight Q."""
    problem = elasticity(cube(3, 2), degree=degree, stretched=True)
    linear = torn(problem, 6, "set_up_")
    expected = problem.solve_directly()
    linear.solve()
    x = linear.A.createVecRight()
    for scaling, q in itertools.product(SCALINGS, ("preconditioner", "diagonal", "identity")):
        options = {"type": kind, "pc_type": pc_type, "scaling": scaling, "coarse_q": q}
        names = {f"feti_{name}": value for name, value in options.items()}
        ksp = create_ksp(linear.A, ksp_rtol=1e-10, **names)
        ksp.solve(linear.b, x)
        agree(ksp.getConvergedReason() > 0, (options, ksp.getPythonContext().message))
        agree(relative_difference(x.array_r, expected) < TOLERANCE, options)
    x.destroy()


def with_form(problem, form):
    """Return the problem with a form of u and v added to its bilinear form."""
    u = ufl.TrialFunction(problem.V)
    v = ufl.TestFunction(problem.V)
    return replace(problem, a=problem.a + form(u, v))


def advection(u, v):
    """Return the bilinear form of advection, whose matrix is not symmetric."""
    return ufl.dot(ufl.as_vector([5.0, -3.0]), ufl.grad(u)) * v * ufl.dx


PROBLEMS = {
    "Poisson, triangles": lambda: poisson(cube(2, 8), stretched=True),
    "Poisson, cubic triangles": lambda: poisson(cube(2, 4), degree=3, stretched=True),
    "Poisson, quadrilaterals": lambda: poisson(cube(2, 7, Cell.quadrilateral), degree=2),
    "Poisson, tetrahedra": lambda: poisson(cube(3, 4), stretched=True),
    "Poisson, hexahedra": lambda: poisson(cube(3, 3, Cell.hexahedron), degree=2, stretched=True),
    "elasticity, triangles": lambda: elasticity(cube(2, 8), stretched=True),
    "elasticity, quadratic triangles": lambda: elasticity(cube(2, 5), degree=2),
    "elasticity, quadrilaterals": lambda: elasticity(cube(2, 6, Cell.quadrilateral)),
    "elasticity, tetrahedra": lambda: elasticity(cube(3, 4), stretched=True),
    "elasticity, quadratic tetrahedra": lambda: elasticity(cube(3, 2), degree=2, stretched=True),
    "elasticity, hexahedra": lambda: elasticity(cube(3, 4, Cell.hexahedron), stretched=True),
    "clamped all round": lambda: elasticity(cube(3, 3), clamped=everywhere, degree=2),
    "nearly incompressible": lambda: elasticity(cube(2, 6), degree=2, nu=0.49),
    "springs in place of conditions": lambda: with_form(
        elasticity(cube(3, 3), clamped=None), lambda u, v: 10.0 * ufl.inner(u, v) * ufl.ds
    ),
    "advection": lambda: with_form(poisson(cube(2, 8)), advection),
}


@every_type
@each("create", PROBLEMS)
def test_every_equation_and_cell_type_gives_the_direct_solution(create, kind, solve_linear):
    """The residual meets its tolerance, and only the unsymmetric problem needs GMRES."""
    problem = create()
    linear = solve_linear(problem, 7, {"feti_type": kind, "ksp_rtol": 1e-10})
    small(relative_difference(owned(linear.u), problem.solve_directly()), TOLERANCE)
    context = linear.solver.getPythonContext()
    small(context.residual, 1e-10)
    agree((context.method == "gmres") == (create is PROBLEMS["advection"]), context.method)


def serendipity(mesh):
    """Return an element whose dofs on edges are moments, not values at points."""
    return basix.ufl.element("Serendipity", mesh.basix_cell(), 3)


#: Equation, mesh, element, and whether the problem is stretched.
ELEMENTS = {
    "Poisson, P1 and bubble, triangles": (poisson, (2, 7), with_bubbles, False),
    "Poisson, P1 and bubble, tetrahedra": (poisson, (3, 3), with_bubbles, False),
    "elasticity, P1 and bubble, triangles": (elasticity, (2, 6), with_bubbles, False),
    "elasticity, P1 and bubble, tetrahedra": (elasticity, (3, 3), with_bubbles, False),
    "elasticity, P2 and face and cell bubbles": (
        elasticity,
        (3, 2),
        lambda mesh: with_bubbles(mesh, 2),
        True,
    ),
    "Poisson, serendipity": (poisson, (2, 5, Cell.quadrilateral), serendipity, True),
    "elasticity, serendipity in space": (elasticity, (3, 2, Cell.hexahedron), serendipity, False),
}


@every_formulation
@each(("create", "mesh", "element", "stretched"), ELEMENTS)
def test_elements_other_than_lagrange_give_the_direct_solution(
    create, mesh, element, stretched, formulation, solve_linear
):
    """Both formulations allow bubbles and moments; bubbles of cells are interior dofs."""
    mesh = cube(*mesh)
    problem = create(mesh, element=element(mesh), stretched=stretched)
    linear = solve_linear(problem, 7, {"feti_formulation": formulation, "ksp_rtol": 1e-10})
    small(relative_difference(owned(linear.u), problem.solve_directly()), TOLERANCE)
    form = linear.solver.getPythonContext().formulation
    layout = problem.V.dofmap.dof_layout
    dim = problem.V.mesh.topology.dim
    inside = problem.V.dofmap.list[: problem.cells, layout.entity_dofs(dim, 0)].ravel()
    dof = tear(problem.V, linear.decomposition).local_block
    bs = problem.V.dofmap.index_map_bs
    on_interface = np.concatenate(form.operator.interfaces) // bs
    agree(not np.isin(dof[on_interface], inside).any())


@every_formulation
@pytest.mark.parametrize("dim", [2, 3])
def test_free_motions_are_counted_if_dofs_are_moments(dim, formulation, solve_linear):
    """The error counts the free motions of a body on rollers, although moments are not values."""
    mesh = cube(dim, 2, Cell.quadrilateral if dim == 2 else Cell.hexahedron)
    free = elasticity(mesh, element=serendipity(mesh), clamped=None)
    rolls = replace(free, bcs=[dirichlet(free.V, left, component=0)])
    what = "1 translation" if dim == 2 else "2 translations and 1 rotation"
    with raises(ConvergenceError, what):
        solve_linear(rolls, 4, {"feti_formulation": formulation})


def test_second_solve_uses_new_coefficients_and_values():
    """Loads, coefficients and boundary values may change between solves; ghosts are updated."""
    problem = poisson(cube(2, 5))
    mesh = problem.V.mesh
    k, load, g = (dolfinx.fem.Constant(mesh, value) for value in (1.0, 1.0, 0.0))
    dofs = dolfinx.fem.locate_dofs_geometrical(problem.V, left)
    bc = dolfinx.fem.dirichletbc(g, dofs, problem.V)
    changing = replace(problem, a=k * problem.a, L=load * problem.L, bcs=[bc])
    linear = torn(changing, 5, "test_", ksp_rtol=1e-11)
    for k.value, load.value, g.value in ((1.0, 1.0, 0.0), (1.0, -2.0, 0.5), (30.0, 3.0, -1.0)):
        u = linear.solve()
        small(relative_difference(owned(u), changing.solve_directly()), TOLERANCE)
        uniform(u.x.array[dofs], float(g.value), 1e-9)
        ghosts = u.x.array.copy()
        u.x.scatter_forward()
        equal(ghosts, u.x.array)


# ---- any number of processes, and any subdomains ---------------------------------------------

DECOMPOSED = {
    "elasticity": (elasticity, (3, 4, Cell.tetrahedron), {"stretched": True}),
    "quadratic elasticity": (elasticity, (2, 6, Cell.triangle), {"degree": 2}),
    "hexahedra": (elasticity, (3, 4, Cell.hexahedron), {}),
    "Poisson": (poisson, (2, 8, Cell.quadrilateral), {"degree": 2, "stretched": True}),
}


@each(("create", "mesh", "options"), DECOMPOSED)
@every_type
def test_solution_does_not_depend_on_the_decomposition(create, mesh, options, kind, solve_linear):
    """1, 4 and 64 subdomains give the solution of a direct solver on one process."""
    alone = create(cube(*mesh, comm=MPI.COMM_SELF), **options)
    u = dolfinx.fem.Function(alone.V)
    u.x.array[:] = alone.solve_directly()
    expected = by_place(u)
    together = create(cube(*mesh), **options)
    for subdomains in (1, 4, 64):
        linear = solve_linear(together, subdomains, {"feti_type": kind, "ksp_rtol": 1e-11})
        equal(by_place(linear.u), expected, 1e-8)
        report = linear.solver.getPythonContext().report()
        agree(report.subdomains >= max(subdomains, COMM.size))


def test_each_process_solves_its_own_problem_on_comm_self():
    """A problem on MPI.COMM_SELF makes no collective call on the world."""
    problem = elasticity(cube(2, 5, comm=MPI.COMM_SELF), stretched=True)
    linear = torn(problem, 3 + COMM.rank, f"process{COMM.rank}_", ksp_rtol=1e-11)
    linear.solve()
    equal(owned(linear.u), problem.solve_directly(), 1e-8)
    agree(linear.solver.getPythonContext().report().subdomains == 3 + COMM.rank)


def test_all_options_have_similar_errors_at_the_default_tolerance(solve_linear):
    """Each solve ends by the assembled residual, whatever the options."""
    problem = elasticity(cube(2, 8), stretched=True)
    expected = whole(problem.solve_directly())
    for options in (
        {},
        {"feti_type": "classical", "feti_pc_type": "lumped"},
        {"feti_pc_type": "identity", "feti_coarse_q": "identity"},
        {"feti_dual_ksp_type": "gmres"},
    ):
        linear = solve_linear(problem, 8, options)
        agree(linear.solver.getPythonContext().residual <= 1e-8)
        equal(whole(owned(linear.u)), expected, 1e-6)


MESHES = {
    "triangles": (2, 4, Cell.triangle),
    "quadrilaterals": (2, 5, Cell.quadrilateral),
    "tetrahedra": (3, 2, Cell.tetrahedron),
    "hexahedra": (3, 3, Cell.hexahedron),
}
every_mesh = each("mesh", MESHES)
every_equation = pytest.mark.parametrize("create", [poisson, elasticity])


def check_solution(problem, part, kind, solve_linear, **options):
    """Assert that a problem is solved as by MUMPS for the given parts; return FETI's report.

    Args:
        problem: The problem; it is torn here.
        part: Number of the part of each cell of this process, (cells,).
        kind: Value of the option feti_type.
        solve_linear: The fixture.
        **options: Further PETSc options, without prefix.
    """
    linear = solve_linear(problem, part, {"feti_type": kind, "ksp_rtol": 1e-11, **options})
    small(relative_difference(owned(linear.u), problem.solve_directly()), TOLERANCE)
    return linear.solver.getPythonContext().report()


def ragged(problem, rng):
    """Return random parts, most of them in pieces that touch in edges and vertices."""
    return rng.integers(0, rng.integers(2, 9), problem.cells)


def singles(problem, rng):
    """Return parts of one cell each."""
    return np.arange(problem.cells)


def large(problem, rng):
    """Return one large part and some parts of a single cell."""
    cells = np.arange(problem.cells)
    return np.where(cells % 5 == 0, 1 + cells // 5, 0)


def rings(problem, rng):
    """Return square rings around the middle, parts that enclose each other."""
    cells = np.arange(problem.cells, dtype=np.int32)
    centre = dolfinx.mesh.compute_midpoints(problem.V.mesh, 2, cells)
    return np.round(7 * np.abs(centre[:, :2] - 0.5).max(axis=1)).astype(np.int32)


@every_mesh
@every_type
@every_equation
@pytest.mark.parametrize(("parts", "seed"), [(ragged, 83), (ragged, 1291), (singles, 0)])
def test_any_parts_give_the_direct_solution(mesh, kind, create, parts, seed, solve_linear):
    """Parts may be ragged, unconnected or single cells; each connected piece is a subdomain."""
    problem = create(cube(*mesh))
    part = parts(problem, np.random.default_rng(seed + COMM.rank))
    report = check_solution(problem, part, kind, solve_linear)
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
def test_irregular_parts_are_solved_with_every_preconditioner(
    kind, parts, mesh, degree, pc_type, q, solve_linear
):
    """Subdomains may differ much in size, and one may enclose another."""
    problem = elasticity(cube(*mesh), degree=degree, stretched=True)
    part = parts(problem, np.random.default_rng(40099 + COMM.rank))
    check_solution(problem, part, kind, solve_linear, feti_pc_type=pc_type, feti_coarse_q=q)


@every_mesh
@every_type
@pytest.mark.parametrize("seed", [83, 1291, 40099])
def test_random_dirichlet_conditions_give_the_direct_solution(mesh, kind, seed, solve_linear):
    """Random components of random nodes are prescribed, in addition to a clamped side."""
    problem = elasticity(cube(*mesh))
    bcs = list(problem.bcs)
    for j in range(problem.V.mesh.geometry.dim):
        part = problem.V.sub(j)
        g = dolfinx.fem.Function(part.collapse()[0])
        g.interpolate(lambda x, j=j: np.cos(5.0 * x[0] + j) * x[1])

        def is_prescribed(x, j=j):  # by coordinates, so that all processes agree on shared nodes
            return (np.sin(1e4 * ([1.7, 2.9, 4.1] @ x) + seed * (j + 1)) > 0.8) & ~left(x)

        dofs = dolfinx.fem.locate_dofs_geometrical((part, g.function_space), is_prescribed)
        bcs.append(dolfinx.fem.dirichletbc(g, dofs, part))
    rng = np.random.default_rng(seed + 7 * COMM.rank)
    check_solution(replace(problem, bcs=bcs), rng.integers(0, 5, problem.cells), kind, solve_linear)
