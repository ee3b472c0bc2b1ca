# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Right-hand sides with prescribed values follow FETI's or dolfinx's convention, as chosen."""

from __future__ import annotations

from types import SimpleNamespace

from petsc4py import PETSc

import numpy as np
import pytest
from collective import COMM, agree, equal, logged_messages, raises
from problems import Cell, Problem, cube, dirichlet, left, owned, right

import dolfinx
import ufl

from dolfinx_feti import FETI, LinearProblem
from dolfinx_feti.runtime.petsc_options import inserted


@pytest.fixture(params=["heat", "elastic"])
def body(request):
    """A square with a fixed side and one with non-zero values, and a second load."""
    mesh = cube(2, 8)
    shape = () if request.param == "heat" else (2,)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, shape))
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    w = v if not shape else v[1]
    a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + ufl.inner(u, v)) * ufl.dx

    def values(x):
        return 0.4 + 0.3 * (x[:2] if shape else x[1])

    bcs = [dirichlet(V, left), dirichlet(V, right, values)]
    x = ufl.SpatialCoordinate(mesh)
    loads = [1.0 * w * ufl.dx, (2.0 - 5.0 * x[0]) * w * ufl.dx]
    problem = LinearProblem(a, loads[0], bcs=bcs, subdomains=4)
    exact = Problem(V, a, loads[1], bcs).solve_directly()
    return SimpleNamespace(a=a, bcs=bcs, loads=loads, problem=problem, exact=exact, V=V)


def lifted(body):
    """Assemble the second load as a dolfinx script does, with lifting."""
    b = body.problem.b.duplicate()
    vector = dolfinx.fem.assemble_vector(dolfinx.fem.form(body.loads[1]))
    dolfinx.fem.apply_lifting(vector.array, [dolfinx.fem.form(body.a)], [body.bcs])
    vector.scatter_reverse(dolfinx.la.InsertMode.add)
    b.array[:] = vector.array[: b.getLocalSize()]
    for bc in body.bcs:
        bc.set(b.array)
    return b


def solved(ksp, b):
    """Solve for a right-hand side, destroy it, and return x."""
    x = b.duplicate()
    ksp.solve(b, x)
    values = x.array_r.copy()
    for each in (x, b):
        each.destroy()
    return values


def test_load_of_another_form(body, caplog):
    """``assemble_rhs`` assembles another load, prescribed values included."""
    body.problem.linear_system()[1].destroy()
    equal(solved(body.problem.solver, body.problem.assemble_rhs(body.loads[1])), body.exact, 1e-6)
    b = body.problem.assemble_rhs(body.loads[0])
    same = body.problem.linear_system()[1]
    equal(b.array_r, same.array_r, 1e-14)
    for each in (b, same):
        each.destroy()
    agree(not logged_messages(caplog), logged_messages(caplog))
    with raises(ValueError, "L has 2 test and trial functions, but takes 1"):
        body.problem.assemble_rhs(body.a)


@pytest.mark.parametrize("way", ["solver of the problem", "argument", "option"])
def test_lifted_vector(body, caplog, way):
    """``lifted=True``, or the option, accepts vectors that dolfinx has lifted."""
    A, b = body.problem.linear_system()
    b.destroy()
    if way == "solver of the problem":
        ksp = body.problem.create_linear_solver(lifted=True)
    else:
        ksp = PETSc.KSP().create(COMM)
        ksp.setOptionsPrefix("own_")
        ksp.setOperators(A)
        ksp.setType("python")
        ksp.setPythonContext(FETI(lifted=way == "argument"))
        options = {} if way == "argument" else {"feti_right_side": "lifted"}
        with inserted("own_", options):
            ksp.setFromOptions()
    for _ in range(2):
        equal(solved(ksp, lifted(body)), body.exact, 1e-6)
    agree(not logged_messages(caplog), logged_messages(caplog))
    solved(ksp, body.problem.assemble_rhs(body.loads[1]))
    agree("does not seem to be lifted" in "".join(logged_messages(caplog)), logged_messages(caplog))
    ksp.destroy()


def test_lifted_vector_where_feti_lifts(body, caplog):
    """A lifted vector where FETI lifts itself causes one warning with the remedy."""
    body.problem.linear_system()[1].destroy()
    for _ in range(2):
        solution = solved(body.problem.solver, lifted(body))
    agree(COMM.allreduce(np.abs(solution - body.exact).max(initial=0.0), op=max) > 0.1)
    texts = logged_messages(caplog)
    agree(len(texts) == 1 and "FETI lifts it again" in texts[0], texts)
    agree("assemble_rhs(L)" in texts[0] and "FETI(lifted=True)" in texts[0], texts)


def test_option_has_no_place_in_a_problem(body):
    """A problem refuses feti_right_side, as it assembles its own right-hand side."""
    with raises(ValueError, "feti_right_side is 'lifted', but a problem assembles its own"):
        LinearProblem(
            body.a, body.loads[0], subdomains=4, petsc_options={"feti_right_side": "lifted"}
        )


def test_solution_of_the_problem_is_as_before(body, caplog):
    """Solving the problem itself gives the reference solution without a warning."""
    expected = Problem(body.V, body.a, body.loads[0], body.bcs).solve_directly()
    equal(owned(body.problem.solve()), expected, 1e-6)
    agree(not logged_messages(caplog), logged_messages(caplog))


def test_load_that_looks_like_a_lifted_one(caplog):
    """A vector that equals −A_fD x_D by chance causes no warning."""
    mesh = cube(2, 8, Cell.quadrilateral)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1))
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    a = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx
    bcs = [dirichlet(V, left, lambda x: 1.0 + 0.0 * x[0])]
    problem = LinearProblem(a, 1.0 * v * ufl.dx, bcs=bcs, subdomains=4)
    _, b = problem.linear_system()
    b.set(1.0)
    solved(problem.solver, b)
    agree(not logged_messages(caplog), logged_messages(caplog))


@pytest.mark.parametrize(
    ("loads", "warnings"), [((0.0, 0.0), 1), ((1.0, 0.0), 0)], ids=["none", "later-none"]
)
def test_first_solve_without_a_load_warns(loads, warnings, caplog):
    """A later load may be zero on purpose."""
    mesh = cube(2, 4)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1))
    v = ufl.TestFunction(V)
    load = dolfinx.fem.Constant(mesh, 0.0)
    a = ufl.inner(ufl.grad(ufl.TrialFunction(V)), ufl.grad(v)) * ufl.dx
    problem = LinearProblem(a, load * v * ufl.dx, bcs=[dirichlet(V, left)], subdomains=4)
    for value in loads:
        load.value = value
        problem.solve()
    messages = [text for text in logged_messages(caplog) if "nothing acts on it" in text]
    agree(len(messages) == warnings, messages)
    agree(not any("boundary=" in text for text in messages), messages)
