# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Problems on ``mixed_element([e])`` have the solutions of those on the space of e."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from collective import agree, equal, raises
from problems import cube, left, right

import basix.ufl
import dolfinx
import ufl

from dolfinx_feti import LinearProblem, NonlinearProblem
from dolfinx_feti.scalars import mean_value

TIGHT = {"snes_rtol": 1e-11, "ksp_rtol": 1e-12}


@pytest.fixture(params=["scalar", "vector"])
def body(request):
    """A square with prescribed values on two sides, one of them on a component."""
    mesh = cube(2, 6)
    shape = (2,) if request.param == "vector" else ()
    element = basix.ufl.element("Lagrange", "triangle", 2, shape=shape)
    V = dolfinx.fem.functionspace(mesh, element)
    W = dolfinx.fem.functionspace(mesh, basix.ufl.mixed_element([element]))
    facets = [dolfinx.mesh.locate_entities_boundary(mesh, 1, side) for side in (left, right)]
    value = dolfinx.fem.Constant(mesh, 0.2)

    def conditions(space, wrapped):
        sub = space.sub(0) if wrapped else space
        collapsed = space.sub(0).collapse()[0] if wrapped else space
        g = dolfinx.fem.Function(collapsed)
        g.interpolate(lambda x: 0.3 * x[1] if not shape else 0.1 * x[:2])
        pair = (sub, collapsed) if wrapped else sub
        dofs = dolfinx.fem.locate_dofs_topological(pair, 1, facets[0])
        bcs = [
            dolfinx.fem.dirichletbc(g, dofs, sub) if wrapped else dolfinx.fem.dirichletbc(g, dofs)
        ]
        part = sub.sub(1) if shape else sub
        dofs = dolfinx.fem.locate_dofs_topological(part, 1, facets[1])
        return [*bcs, dolfinx.fem.dirichletbc(value, dofs, part)]

    return SimpleNamespace(
        mesh=mesh, V=V, W=W, value=value, bcs=[conditions(V, False), conditions(W, True)]
    )


def flux(f, t):
    return (1 + ufl.inner(f, f)) * ufl.inner(ufl.grad(f), ufl.grad(t)) * ufl.dx


def load(t):
    return (2.0 * t if not t.ufl_shape else 2.0 * t[1] + t[0]) * ufl.dx


def values(f, V):
    """Return the values of the only part of f, in the order of the dofs of V."""
    part = dolfinx.fem.Function(V)
    part.interpolate(f.sub(0).collapse())
    part.x.scatter_forward()
    return part.x.array


@pytest.mark.parametrize("way", ["alone", "list", "tangent"])
def test_nonlinear(body, way):
    """The solution is written to the Function passed as u, which is also the initial guess."""
    u = dolfinx.fem.Function(body.V)
    w = dolfinx.fem.Function(body.W)
    seen = []
    t = ufl.TestFunction(body.V)
    problem = NonlinearProblem(flux(u, t) - load(t), u, bcs=body.bcs[0], petsc_options=TIGHT)
    (c,) = ufl.split(w)
    (t,) = ufl.TestFunctions(body.W)
    F = flux(c, t) - load(t)
    common = {"bcs": body.bcs[1], "subdomains": 4, "petsc_options": TIGHT}
    if way == "tangent":
        common["J"] = ufl.derivative(F, w, ufl.TrialFunction(body.W))
    common["before_assembly"] = seen.append
    arguments = ([F], [w]) if way == "list" else (F, w)
    ours = NonlinearProblem(*arguments, **common)
    for number in (0.2, 0.5):
        body.value.value = number
        problem.solve()
        found = ours.solve()
        agree((found[0] if way == "list" else found) is w)
        equal(values(w, body.V), u.x.array, 1e-8)
    agree(all(given is (ours.u if way == "list" else w) for given in seen))
    ours.solve()
    if ours.history:
        agree(ours.history[0].residual < 1e-8)
    ours.bcs = body.bcs[1][:1]
    problem.bcs = body.bcs[0][:1]
    problem.solve()
    ours.solve()
    equal(values(w, body.V), u.x.array, 1e-8)


@pytest.mark.parametrize("given", [False, True], ids=["created", "given"])
def test_linear(body, given):
    """A linear problem on a mixed space of one part has the solution on that part's space."""

    def forms(V):
        f = ufl.TrialFunction(V)
        t = ufl.TestFunction(V)
        if V is body.W:
            (f,), (t,) = ufl.split(f), ufl.split(t)
        return (ufl.inner(ufl.grad(f), ufl.grad(t)) + ufl.inner(f, t)) * ufl.dx, load(t)

    u = LinearProblem(*forms(body.V), bcs=body.bcs[0], petsc_options=TIGHT).solve()
    w = dolfinx.fem.Function(body.W) if given else None
    problem = LinearProblem(*forms(body.W), u=w, bcs=body.bcs[1], subdomains=4, petsc_options=TIGHT)
    found = problem.solve()
    agree(found is problem.u)
    if w is not None:
        agree(found is w)
    equal(values(found, body.V), u.x.array, 1e-8)


def test_what_is_refused(body):
    """A mixed space of one part refuses scalar unknowns, and conditions on the part's space."""
    w = dolfinx.fem.Function(body.W)
    (c,) = ufl.split(w)
    (t,) = ufl.TestFunctions(body.W)
    with raises(ValueError, "mixed element of one, which takes no scalars or contacts"):
        NonlinearProblem(flux(c, t) - load(t), w, scalars=[mean_value(w)])
    with raises(ValueError, r"bcs\[0\] lives on another function space"):
        NonlinearProblem(flux(c, t) - load(t), w, bcs=body.bcs[0])
    agree(np.all(w.x.array == 0.0))
