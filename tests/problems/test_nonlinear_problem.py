# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""NonlinearProblem has one solution for all decompositions, and its options work."""

from __future__ import annotations

import gc
import random
import weakref

from mpi4py import MPI

import cffi
import numpy as np
import pytest
from collective import COMM, agree, equal, raises, small
from mixed import Mixed, by_place
from problems import cube, dirichlet, free_residual, left, owned, right
from walls import PREFIX, Wall, tube, wall

import dolfinx
import dolfinx.jit
import ufl

from dolfinx_feti import FETI, NonlinearProblem, kinematics, loads, materials
from dolfinx_feti.fem import assembly

TIGHT = {"snes_rtol": 1e-11}
PRESSURE = 5.0


@pytest.fixture(scope="module")
def references() -> dict[int, Wall]:
    """Solutions of the mixed problem of degree 1 and 2 by dolfinx alone."""
    solved = {}
    for degree in (1, 2):
        body = wall(tube(MPI.COMM_SELF), degree=degree)
        reference = Mixed(body)
        body.load.value = loads.mmhg(PRESSURE)
        reference.solve()
        solved[degree] = body
    return solved


@pytest.mark.parametrize(("degree", "subdomains"), [(1, 1), (1, 4), (1, "cells"), (2, 1), (2, 16)])
def test_same_wall_for_all_decompositions(degree, subdomains, references):
    """For any number of processes and subdomains, u and p are those of the mixed problem."""
    body = wall(tube(), degree=degree)
    expected = references[degree]
    cells = COMM.allreduce(body.p.function_space.dofmap.index_map.size_local)
    problem = body.problem(cells if subdomains == "cells" else subdomains, TIGHT)
    if subdomains == "cells":
        agree(COMM.allreduce(problem.decomposition.count) == cells)
    body.inflate(problem, [PRESSURE])
    equal(by_place(body.u), by_place(expected.u), 1e-8)
    equal(by_place(body.p), by_place(expected.p), 1e-7)
    agree(np.abs(by_place(expected.u)).max() > 2e-3)


@pytest.mark.parametrize("renew", [True, False])
def test_preconditioner_of_the_last_solve(renew, monkeypatch):
    """``renew`` decides whether the preconditioner is set up again, and does not change u."""
    body = wall(tube(), degree=1)
    other = wall(tube(), degree=1)
    problem = body.problem(4, TIGHT)
    body.inflate(problem, [2.0])
    body.load.value = loads.mmhg(2.5)
    begun_anew = []
    with monkeypatch.context() as patch:
        patch.setattr(FETI, "renew", lambda self: begun_anew.append(self))
        problem.solve(renew=renew)
    agree(bool(begun_anew) == renew, problem.history)
    other.inflate(other.problem(4, TIGHT), [2.0, 2.5])
    equal(by_place(body.u), by_place(other.u), 1e-8)


def test_what_a_problem_offers():
    """After a solve, ``problem`` and its SNES have dolfinx's attributes and the Newton steps."""
    body = wall(tube(), degree=1)  # and a coarse space without the solution
    problem = body.problem(4, {"feti_coarse_adaptive": 0, "feti_deflation": 0})
    agree(problem.history == [] and problem.u is body.u)
    problem.solve()  # at rest there is nothing to do
    agree(problem.history == [] and problem.solver.getConvergedReason() > 0)
    body.load.value = loads.mmhg(5.0)
    agree(problem.solve() is body.u)
    snes = problem.solver
    agree(snes.getType() == "python" and snes.getKSP().getType() == "python")
    agree(snes.getOptionsPrefix() == PREFIX and snes.getKSP().getOptionsPrefix() == PREFIX)
    agree(snes.getConvergedReason() > 0 and snes.getIterationNumber() == len(problem.history))
    agree(problem.A.getType() == "is" and problem.A.getSize()[0] == snes.getSolution().getSize())
    equal(snes.getSolution().array_r, owned(body.u))
    n_cells = body.p.function_space.dofmap.index_map.size_local
    agree(problem.decomposition.subdomain.shape == (n_cells,))
    for step in problem.history:
        agree(0.0 < step.step_length <= 1.0 and step.residual > 0.0)
        agree(step.linear_iterations > 0 and step.linear_method in ("cg", "gmres"))
        agree(step.seconds_assembly > 0.0 and step.seconds_linear > 0.0)


def test_tangent_of_the_last_equilibrium_predicts():
    """A prediction by the last tangent changes the Newton steps, and not the solution."""
    fields = []
    first = []
    for ahead in (False, True):
        body = wall(tube(), degree=1)
        problem = body.problem(4, TIGHT)
        body.inflate(problem, [5.0])
        tangent = problem.linearise() if ahead else None
        body.load.value = loads.mmhg(10.0)
        problem.solve(first_tangent=tangent)
        fields.append(by_place(body.u))
        first.append(problem.history[1].residual)
    equal(fields[1], fields[0], 1e-8)
    agree(abs(first[1] / first[0] - 1.0) > 1e-3, "the first step was another one")


def test_tangent_that_the_matrix_does_not_hold(monkeypatch):
    """``first_tangent`` is refused unless the problem's matrix still holds that tangent."""
    body = wall(tube(around=6, along=2), degree=1)
    problem = body.problem(2)
    other = wall(tube(around=6, along=2), degree=1).problem(2)
    body.load.value = loads.mmhg(1.0)
    old = problem.linearise()
    new = problem.linearise()
    problem.solve(first_tangent=new)
    before = owned(body.u)
    kept = problem.linearise()
    assemble = assembly.assemble

    def failing(K, form) -> None:
        assemble(K, form)
        if COMM.rank == COMM.size - 1:
            raise FloatingPointError

    with monkeypatch.context() as patch, raises(FloatingPointError, ""):
        patch.setattr(assembly, "assemble", failing)
        problem.linearise()
    for wrong in (old, new, kept, other.linearise()):
        with raises(ValueError, "first_tangent names a tangent that this problem's matrix does no"):
            problem.solve(first_tangent=wrong)
    equal(owned(body.u), before)
    problem.solve(first_tangent=problem.linearise())


def stretched(degree, *, given=None, **metadata):
    """Solve with the quadrature degree of the package, the problem or the measure."""
    V = dolfinx.fem.functionspace(cube(2, 3), ("Lagrange", degree, (2,)))
    u = dolfinx.fem.Function(V)
    C = ufl.Identity(2) + ufl.grad(u) + ufl.grad(u).T + ufl.grad(u).T * ufl.grad(u)
    energy = (ufl.exp(ufl.tr(C) - 2) - ufl.ln(ufl.det(C))) * ufl.dx(metadata=metadata or None)
    bcs = [dirichlet(V, left), dirichlet(V, right, lambda x: 0.3 * np.stack([x[1], x[0]]))]
    common = {"petsc_options": {"snes_rtol": 1e-12, "snes_atol": 1e-13}, "subdomains": 3}
    NonlinearProblem(energy, u, bcs, quadrature_degree=given, **common).solve()
    if given is None and not metadata:  # dolfinx's quadrature: the residual of its own form is zero
        F = ufl.derivative(energy, u, ufl.TestFunction(u.function_space))
        small(np.divide(*free_residual(F, bcs)), 1e-10)  # beside the supports' reactions
    return by_place(u)


@pytest.mark.parametrize("degree", [1, 2])
def test_quadrature_degree_bounds_unstated_degrees(degree):
    """``quadrature_degree=`` bounds the degree of integrals that do not state one."""
    bound = 2 * degree - 1
    other = stretched(degree, quadrature_degree=bound)
    equal(stretched(degree, given=bound), other, 1e-9)
    equal(stretched(degree, given=9, quadrature_degree=bound), other, 1e-9)
    default = stretched(degree)
    equal(stretched(degree, given=100), default, 1e-9)
    if degree == 2:  # of degree 1 the strain is constant, and every rule is exact
        agree(1e-2 > np.abs(other - default).max() > 1e-6)


@pytest.mark.parametrize(("degree", "expected"), [(1, 10), (2, 33)])
def test_large_quadrature_degree_of_ufl_causes_a_warning(degree, expected, caplog):
    """For HGO a warning names UFL's degree and recommends a bound; for neo-Hooke there is none."""
    V = dolfinx.fem.functionspace(cube(3, 2), ("Lagrange", degree, (3,)))
    u = dolfinx.fem.Function(V)
    F = kinematics.deformation_gradient(u)
    C = kinematics.right_cauchy_green(F)
    J = kinematics.jacobian(F)
    a = ufl.as_vector([1.0, 0.0, 0.0])
    parameters = {"c": 3.0, "k1": 2.3, "k2": 0.8, "J": J}
    fibres = materials.holzapfel_gasser_ogden(C, a, a, **parameters)
    stopped = "subdomains is 0"  # after the warning, before the compiler
    for psi in (materials.neo_hookean(C, c=3.0, J=J), fibres):
        with raises(ValueError, stopped):
            NonlinearProblem(psi * ufl.dx, u, subdomains=0)
    texts = [record.message for record in caplog.records]
    agree(len(texts) == (1 if COMM.rank == 0 else 0), texts)
    for wanted in (f"degree of {expected} for F", f"quadrature_degree={2 * degree}, twice"):
        agree(all(wanted in text for text in texts), texts)
    caplog.clear()
    with raises(ValueError, stopped):
        NonlinearProblem(fibres * ufl.dx, u, subdomains=0, quadrature_degree=2 * degree)
    agree(not caplog.records)


@pytest.mark.serial
def test_code_of_a_problem_is_short(tmp_path, monkeypatch):
    """The forms of a two-layer HGO wall compile to little code, with an empty cache."""
    default = dolfinx.jit.DOLFINX_DEFAULT_JIT_OPTIONS
    monkeypatch.setitem(default, "cache_dir", (str(tmp_path), "an empty cache"))
    wall(tube(), degree=2).problem(4)
    code = {path.name: path.stat().st_size for path in tmp_path.rglob("*.c")}
    agree(0 < sum(code.values()) < 350_000, code)


def test_nothing_is_left_behind():
    """A problem and its PETSc objects are freed with its last reference."""
    body = wall(tube(), degree=1)
    problem = body.problem(3)
    body.inflate(problem, [1.0])
    A = problem.A
    gone = weakref.ref(problem)
    del problem
    gc.collect()
    agree(gone() is None)
    agree(not A, "the torn tangent is still there")


def density(u: dolfinx.fem.Function, edit: int) -> ufl.core.expr.Expr:
    """Rubber with fibres that do not push; the second edit adds a term and changes the numbers."""
    c = 3.0 + COMM.bcast(random.random())  # no cache has the forms
    F = ufl.Identity(2) + ufl.grad(u)
    C = F.T * F
    J = ufl.det(F)
    a = ufl.as_vector([0.8, 0.6])
    E = ufl.dot(a, C * a) - 1
    psi = c / 2 * (ufl.tr(C) - 2 - 2 * ufl.ln(J)) + 20.0 * ufl.ln(J) ** 2
    psi += ufl.conditional(ufl.gt(E, 0.0), c * (ufl.exp(0.8 * E**2) - 1), 0.0)
    return psi if edit == 1 else psi + ufl.cosh(2.0 * (ufl.tr(C) - 2)) - 1


def recorded(monkeypatch, place, name):
    """Record the first argument of each call of a function, and return the list."""
    calls = []
    original = getattr(place, name)

    def call(*arguments, **keywords):
        calls.append(arguments[0])
        return original(*arguments, **keywords)

    monkeypatch.setattr(place, name, call)
    return calls


@pytest.mark.parametrize("given", ["residual", "energy"])
def test_second_edit_compiles_nothing(given, monkeypatch):
    """A second edit of a material compiles nothing, and has dolfinx's equilibrium."""
    compiled, analysed = (
        recorded(monkeypatch, place, name)
        for place, name in ((cffi.FFI, "compile"), (ufl.algorithms, "compute_form_data"))
    )
    mesh = cube(2, 3)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (2,)))
    u = dolfinx.fem.Function(V)
    bc = dirichlet(V, left)
    load = dolfinx.fem.Constant(mesh, (0.2, 0.3))
    for edit in (1, 2):
        energy = density(u, edit) * ufl.dx(degree=4) - ufl.inner(load, u) * ufl.ds
        F = ufl.derivative(energy, u, ufl.TestFunction(V))
        compiled.clear()
        analysed.clear()
        form = energy if given == "energy" else F
        options = {"snes_rtol": 1e-10}
        NonlinearProblem(form, u, bcs=[bc], subdomains=4, petsc_options=options).solve()
        calls = COMM.allreduce(len(compiled))
        if edit > 1:
            agree(calls == 0, "calls of the C compiler")
        kinds = [{i.integral_type() for i in form.integrals()} for form in analysed]
        cells = sum("cell" in kind for kind in kinds)
        agree(cells == (3 if given == "energy" else 2), kinds)
        small(np.divide(*free_residual(F, [bc])), 1e-8)
        agree(COMM.allreduce(len(compiled)) > calls, "a cache has the residual")
