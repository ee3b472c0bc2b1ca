# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Mixed elements and block forms end in one message, and its lines work."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

from petsc4py import PETSc

import pytest
from collective import agree, equal, raises
from mixed import by_place
from problems import Cell, cube, dirichlet, left

import basix.ufl
import dolfinx
import dolfinx.fem.petsc
import ufl

from dolfinx_feti import LinearProblem, NonlinearProblem
from dolfinx_feti.comparison import create_solver

MU, KAPPA = 1.0, 100.0


def elements(mesh, degree=2):
    """Taylor and Hood's."""
    cell, dim = mesh.basix_cell(), mesh.geometry.dim
    return [
        basix.ufl.element("P", cell, degree, shape=(dim,)),
        basix.ufl.element("P", cell, degree - 1),
    ]


def rows(u, p, v, q):
    """Linear elasticity with a pressure, pulled sideways: both rows."""
    inside = 2 * MU * ufl.inner(ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v)))
    return (inside + p * ufl.div(v)) * ufl.dx, (ufl.div(u) - p / KAPPA) * q * ufl.dx


def load(v):
    return v[len(v) - 1] * ufl.dx


def linear_mixed(mesh):
    W = dolfinx.fem.functionspace(mesh, basix.ufl.mixed_element(elements(mesh)))
    v, q = ufl.TestFunctions(W)
    LinearProblem(sum(rows(*ufl.TrialFunctions(W), v, q)), load(v))


def nonlinear_mixed(mesh):
    W = dolfinx.fem.functionspace(mesh, basix.ufl.mixed_element(elements(mesh)))
    w = dolfinx.fem.Function(W)
    v, q = ufl.TestFunctions(W)
    NonlinearProblem(sum(rows(*ufl.split(w), v, q)) - load(v), w)


def spaces(mesh):
    return [dolfinx.fem.functionspace(mesh, element) for element in elements(mesh)]


def linear_parts(mesh):
    W = ufl.MixedFunctionSpace(*spaces(mesh))
    v, q = ufl.TestFunctions(W)
    LinearProblem(sum(rows(*ufl.TrialFunctions(W), v, q)), load(v))


def linear_blocks(mesh):
    W = ufl.MixedFunctionSpace(*spaces(mesh))
    v, q = ufl.TestFunctions(W)
    a, L = sum(rows(*ufl.TrialFunctions(W), v, q)), load(v) + 0 * q * ufl.dx(mesh)
    LinearProblem(ufl.extract_blocks(a), L)


def nonlinear_blocks(mesh):
    u, p = map(dolfinx.fem.Function, spaces(mesh))
    v, q = (ufl.TestFunction(f.function_space) for f in (u, p))
    F_u, F_p = rows(u, p, v, q)
    NonlinearProblem([F_u - load(v), F_p], [u, p])


WAYS = [linear_mixed, nonlinear_mixed, linear_parts, linear_blocks, nonlinear_blocks]


def message(call: Callable[[], object], kind: type[Exception] = Exception) -> str:
    """Return the message of the error that a call ends in, on all processes."""
    try:
        call()
    except kind as error:
        return str(error)
    return "no error"


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("cell", [Cell.tetrahedron, Cell.quadrilateral])
def test_one_message(way, cell):
    mesh = cube(3, 1) if cell == Cell.tetrahedron else cube(2, 2, cell)
    text = message(lambda: way(mesh), (TypeError, ValueError))
    dim = mesh.geometry.dim
    agree("but only a problem on one continuous space is torn. Condense" in text, text)
    agree(f'V = functionspace(mesh, ("Lagrange", 2, ({dim},)))' in text, text)
    agree("NonlinearProblem([F_u, F_p], u, bcs=bcs, condense=p)" in text, text)


def test_names_of_the_functions():
    """In either order; a linear displacement would lock with a constant pressure."""
    mesh = cube(2, 2)
    P1 = [basix.ufl.element("P", mesh.basix_cell(), 1, shape=shape) for shape in (None, (2,))]
    p, u = (dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, element)) for element in P1)
    p.name, u.name = "pressure", "disp"
    text = message(lambda: NonlinearProblem([p * ufl.dx], [p, u]))
    agree("disp, pressure = Function(V), Function(Q)" in text, text)
    agree('("Lagrange", 2, (2,))' in text and "condense=pressure)" in text, text)


def test_a_discontinuous_pressure_stays():
    mesh = cube(2, 2, Cell.quadrilateral)
    cell = mesh.basix_cell()
    for family, degree in (("DPC", 1), ("DG", 0), ("DG", 1)):
        pair = [elements(mesh)[0], basix.ufl.element(family, cell, degree, discontinuous=True)]
        W = dolfinx.fem.functionspace(mesh, basix.ufl.mixed_element(pair))
        w, t = ufl.TrialFunction(W), ufl.TestFunction(W)
        text = message(lambda w=w, t=t: LinearProblem(ufl.inner(w, t) * ufl.dx, t[0] * ufl.dx))
        agree(f'Q = functionspace(mesh, ("{family}", {degree}))' in text, text)


def test_other_fields_have_no_such_lines():
    mesh = cube(2, 2)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1))
    three = [dolfinx.fem.Function(V) for _ in range(3)]
    with raises(
        ValueError, "^u is a block of 3.* Solve it by dolfinx, with MUMPS or a field split"
    ):
        NonlinearProblem([ufl.dx(mesh)] * 3, three)
    cell = mesh.basix_cell()
    fluxes = [basix.ufl.element("RT", cell, 1), basix.ufl.element("DG", cell, 0)]
    W = dolfinx.fem.functionspace(mesh, basix.ufl.mixed_element([*fluxes, fluxes[1]]))
    w, t = ufl.TrialFunction(W), ufl.TestFunction(W)
    with raises(TypeError, "mixed element of 3.* Solve it by dolfinx"):
        LinearProblem(ufl.inner(w, t) * ufl.dx, t[0] * ufl.dx)


def test_the_lines_work():
    """What the message says, run as it stands, beside a direct solve of the mixed problem."""
    mesh = cube(2, 4)
    text = message(lambda: linear_mixed(mesh), TypeError)
    *declarations, last = re.findall(r"^    (\w.*)$", text, re.M)
    names: dict[str, Any] = {
        "mesh": mesh,
        "functionspace": dolfinx.fem.functionspace,
        "Function": dolfinx.fem.Function,
        "TestFunction": ufl.TestFunction,
        "NonlinearProblem": NonlinearProblem,
    }
    for line in declarations:
        exec(line, names)
    F_u, F_p = rows(*(names[name] for name in "upvq"))
    names |= {"F_u": F_u - load(names["v"]), "F_p": F_p, "bcs": [dirichlet(names["V"], left)]}
    exec(last, names)
    names["problem"].solve()
    reference = direct(mesh, names["V"], names["Q"])
    equal(by_place(names["u"]), by_place(reference), 1e-5)


def direct(mesh, V, Q):
    """Solve for u and p together by dolfinx with MUMPS; return u."""
    W = dolfinx.fem.functionspace(mesh, basix.ufl.mixed_element([V.ufl_element(), Q.ufl_element()]))
    facets = dolfinx.mesh.locate_entities_boundary(mesh, 1, left)
    dofs = dolfinx.fem.locate_dofs_topological((W.sub(0), V), 1, facets)
    bc = dolfinx.fem.dirichletbc(dolfinx.fem.Function(V), dofs, W.sub(0))
    v, q = ufl.TestFunctions(W)
    a, L = sum(rows(*ufl.TrialFunctions(W), v, q)), load(v)
    A = dolfinx.fem.petsc.assemble_matrix(dolfinx.fem.form(a), bcs=[bc])
    A.assemble()
    b = dolfinx.fem.petsc.assemble_vector(dolfinx.fem.form(L))
    b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    dolfinx.fem.petsc.set_bc(b, [bc])  # of the value 0: nothing to lift
    ksp = create_solver(A)
    w, x = dolfinx.fem.Function(W), b.duplicate()
    ksp.solve(b, x)
    w.x.array[: x.getLocalSize()] = x.array_r
    w.x.scatter_forward()
    for owned in (ksp, A, b, x):
        owned.destroy()
    return w.sub(0).collapse()
