# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""FETI against a direct solver on the undecomposed problem."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from cases import each, every_formulation, every_type
from collective import agree, norm, raises, small
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

TOLERANCE = 1e-7  # for a residual of 1e-10 and condition numbers up to 1e3


def difference(u, expected):
    return norm(u - expected) / norm(expected)


@every_type
@pytest.mark.parametrize(
    ("degree", "pc_type"),
    [(1, "dirichlet"), (1, "lumped"), (1, "identity"), (2, "dirichlet"), (2, "lumped")],
)
def test_all_options(kind, degree, pc_type, feti):
    """Elasticity on tetrahedra with every scaling and weight of the projection."""
    problem = elasticity(cube(3, 2), degree=degree, stretched=True)
    linear = torn(problem, 6, "set_up_")
    expected = problem.solve_directly()
    linear.solve()
    x = linear.A.createVecRight()
    for scaling, q in itertools.product(
        ("stiffness", "multiplicity"), ("preconditioner", "diagonal", "identity")
    ):
        options = {"type": kind, "pc_type": pc_type, "scaling": scaling, "coarse_q": q}
        names = {f"feti_{name}": value for name, value in options.items()}
        ksp = feti(linear.A, ksp_rtol=1e-10, **names)
        ksp.solve(linear.b, x)
        agree(ksp.getConvergedReason() > 0, (options, ksp.getPythonContext().message))
        agree(difference(x.array_r, expected) < TOLERANCE, options)
    x.destroy()


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
}


@every_type
@each("create", PROBLEMS)
def test_problems(create, kind, solve):
    problem = create()
    linear = solve(problem, 7, {"feti_type": kind, "ksp_rtol": 1e-10})
    small(difference(owned(linear.u), problem.solve_directly()), TOLERANCE)
    small(linear.solver.getPythonContext().residual, 1e-10)


def serendipity(mesh):
    """Moments on the edges in place of values at points."""
    return basix.ufl.element("Serendipity", mesh.basix_cell(), 3)


#: Equation, mesh, element, and whether the problem is stretched.
ELEMENTS = {
    "Poisson, P1 and bubble, triangles": (poisson, (2, 7), with_bubbles, False),
    "Poisson, P1 and bubble, tetrahedra": (poisson, (3, 3), with_bubbles, False),
    "elasticity, P1 and bubble, triangles": (elasticity, (2, 6), with_bubbles, False),
    "elasticity, P1 and bubble, tetrahedra": (elasticity, (3, 3), with_bubbles, False),
    "elasticity, P2 and face and cell bubbles": (
        elasticity, (3, 2), lambda mesh: with_bubbles(mesh, 2), True,
    ),
    "Poisson, serendipity": (poisson, (2, 5, Cell.quadrilateral), serendipity, True),
    "elasticity, serendipity in space": (elasticity, (3, 2, Cell.hexahedron), serendipity, False),
}  # fmt: skip


@every_formulation
@each(("create", "mesh", "element", "stretched"), ELEMENTS)
def test_elements_other_than_lagrange(create, mesh, element, stretched, formulation, solve):
    """Both forms; where there are bubbles of cells, these belong to the interior."""
    mesh = cube(*mesh)
    problem = create(mesh, element=element(mesh), stretched=stretched)
    linear = solve(problem, 7, {"feti_formulation": formulation, "ksp_rtol": 1e-10})
    small(difference(owned(linear.u), problem.solve_directly()), TOLERANCE)
    form = linear.solver.getPythonContext().form
    layout, dim = problem.V.dofmap.dof_layout, problem.V.mesh.topology.dim
    inside = problem.V.dofmap.list[: problem.cells, layout.entity_dofs(dim, 0)].ravel()
    dof = tear(problem.V, linear.decomposition).dof
    bs = problem.V.dofmap.index_map_bs
    on_interface = np.concatenate(form.operator.interface) // bs
    agree(not np.isin(dof[on_interface], inside).any())


@every_formulation
@pytest.mark.parametrize("dim", [2, 3])
def test_what_moves_with_moments_as_dofs(dim, formulation, solve):
    """The message counts the motions, of which some dofs have no value at a point."""
    mesh = cube(dim, 2, Cell.quadrilateral if dim == 2 else Cell.hexahedron)
    free = elasticity(mesh, element=serendipity(mesh), clamped=None)
    rolls = replace(free, bcs=[dirichlet(free.V, left, component=0)])
    what = "1 translation" if dim == 2 else "2 translations and 1 rotation"
    with raises(ConvergenceError, what):
        solve(rolls, 4, {"feti_formulation": formulation})


@every_type
def test_springs_instead_of_dirichlet_conditions(kind, solve):
    """Robin conditions alone: kernels leave the subdomains that touch the boundary."""
    problem = elasticity(cube(3, 3), clamped=None)
    u, v = ufl.TrialFunction(problem.V), ufl.TestFunction(problem.V)
    held = replace(problem, a=problem.a + 10.0 * ufl.inner(u, v) * ufl.ds)
    linear = solve(held, 10, {"feti_type": kind, "ksp_rtol": 1e-10})
    small(difference(owned(linear.u), held.solve_directly()), TOLERANCE)
    report = linear.solver.getPythonContext().report()
    agree(report.exact < report.subdomains)


@every_type
def test_unsymmetric_form(kind, solve):
    """Advection and diffusion, by GMRES."""
    problem = poisson(cube(2, 8))
    u, v = ufl.TrialFunction(problem.V), ufl.TestFunction(problem.V)
    wind = ufl.as_vector([5.0, -3.0])
    carried = replace(problem, a=problem.a + ufl.dot(wind, ufl.grad(u)) * v * ufl.dx)
    linear = solve(carried, 6, {"feti_type": kind, "ksp_rtol": 1e-10})
    small(difference(owned(linear.u), carried.solve_directly()), TOLERANCE)
    agree(linear.solver.getPythonContext().method == "gmres")


def test_second_solve_sees_new_coefficients_and_values():
    """Load, matrix and boundary values change between two solves; ghosts follow their owners."""
    problem = poisson(cube(2, 5))
    mesh = problem.V.mesh
    k, load, g = (dolfinx.fem.Constant(mesh, value) for value in (1.0, 1.0, 0.0))
    dofs = dolfinx.fem.locate_dofs_geometrical(problem.V, left)
    bc = dolfinx.fem.dirichletbc(g, dofs, problem.V)
    changing = replace(problem, a=k * problem.a, L=load * problem.L, bcs=[bc])
    linear = torn(changing, 5, "test_", ksp_rtol=1e-11)
    for k.value, load.value, g.value in ((1.0, 1.0, 0.0), (1.0, -2.0, 0.5), (30.0, 3.0, -1.0)):
        u = linear.solve()
        small(difference(owned(u), changing.solve_directly()), TOLERANCE)
        agree(np.allclose(u.x.array[dofs], g.value, atol=1e-9))
        ghosts = u.x.array.copy()
        u.x.scatter_forward()
        agree(np.array_equal(ghosts, u.x.array))
