# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Arguments and attributes of the problem classes of dolfinx 0.9 to 0.11 work, or are refused."""

from __future__ import annotations

import inspect
import re
import traceback
from types import SimpleNamespace

from mpi4py import MPI

import numpy as np
import pytest
from bodies import block, yeoh
from collective import COMM, agree, equal, norm, raises, small, uniform
from problems import Cell, cube, owned, poisson

import basix.ufl
import dolfinx
import dolfinx.fem.petsc
import ufl

from dolfinx_feti import LinearProblem, NonlinearProblem

LAST = COMM.rank == COMM.size - 1


@pytest.fixture
def heat():
    """Poisson's equation, and its reference solution."""
    body = poisson(cube(2, 4))
    u = LinearProblem(body.a, body.L, body.bcs, subdomains=4).solve()
    return SimpleNamespace(a=body.a, L=body.L, bcs=body.bcs, V=body.V, u=u)


@pytest.fixture
def rubber():
    """A block at rest, with its residual and tangent."""
    body = block(yeoh, (0.3, 0.1))
    F = ufl.derivative(body.energy, body.u, ufl.TestFunction(body.u.function_space))
    return SimpleNamespace(F=F, J=ufl.derivative(F, body.u), u=body.u, bcs=body.bcs)


# -- arguments


def test_positional_arguments(heat, rubber):
    """All arguments may be positional, in the order of dolfinx 0.9."""
    u = dolfinx.fem.Function(heat.V)
    problem = LinearProblem(heat.a, heat.L, heat.bcs, u, {"ksp_rtol": 1e-10}, {}, {}, subdomains=4)
    agree(problem.solve() is u is problem.u and problem.solver.getTolerances()[0] == 1e-10)
    equal(owned(u), owned(heat.u), 1e-6)
    nonlinear = NonlinearProblem(rubber.F, rubber.u, rubber.bcs, rubber.J, None, None, subdomains=4)
    agree(nonlinear.solve() is rubber.u and len(nonlinear.history) > 2)


def test_subdomains_may_be_left_out(heat, rubber):
    """Without ``subdomains=`` each process has at least one, with an equal solution."""
    problem = LinearProblem(heat.a, heat.L, heat.bcs)
    for each in (problem, NonlinearProblem(rubber.F, rubber.u, rubber.bcs)):
        each.solve()
        agree(COMM.allreduce(each.decomposition.count) >= COMM.size)
    equal(owned(problem.u), owned(heat.u), 1e-6)


def test_no_conditions(heat, rubber):
    """``bcs=`` may be None, an empty list or an empty tuple, with equal solutions."""
    mass = heat.a + ufl.TrialFunction(heat.V) * ufl.TestFunction(heat.V) * ufl.dx
    for bcs in (None, [], ()):
        problem = LinearProblem(mass, heat.L, bcs=bcs, subdomains=4)
        problem.solve()
        agree(problem.bcs == ())
        agree(NonlinearProblem(rubber.F, rubber.u, bcs=bcs, subdomains=4).bcs == ())
    for problem in (LinearProblem(mass, heat.L), NonlinearProblem(rubber.F, rubber.u)):
        agree(COMM.allreduce(problem.decomposition.count) >= 2)  # or there is no null space


def test_options_of_the_compilers(heat, rubber, tmp_path):
    """Compiler options reach FFCx and the package's own kernels, and are not modified."""
    form_options = {"epsilon": 1e-13}
    jit_options = {"cache_dir": str(tmp_path / "forms")}
    options = {"form_compiler_options": form_options, "jit_options": jit_options}
    problem = LinearProblem(heat.a, heat.L, bcs=heat.bcs, subdomains=4, **options)
    equal(owned(problem.solve()), owned(heat.u), 1e-6)
    made = COMM.bcast(len(list((tmp_path / "forms").iterdir())))
    agree(made > 0)
    NonlinearProblem(rubber.F, rubber.u, rubber.bcs, subdomains=4, **options)
    agree(COMM.bcast(len(list((tmp_path / "forms").iterdir()))) > made)
    agree(COMM.bcast([p.name for p in (tmp_path / "forms").glob("kernel_*")]))
    agree(form_options == {"epsilon": 1e-13} and list(jit_options) == ["cache_dir"])


def test_default_prefixes(heat, rubber):
    """Default prefixes are unique, and equal on all processes."""
    if LAST:
        own = poisson(cube(2, 2, comm=MPI.COMM_SELF))
        LinearProblem(own.a, own.L, own.bcs, subdomains=2).solve()
    made = [LinearProblem(heat.a, heat.L, heat.bcs, subdomains=4) for _ in range(2)]
    made += [NonlinearProblem(rubber.F, rubber.u, rubber.bcs, subdomains=4) for _ in range(2)]
    prefixes = [problem.solver.getOptionsPrefix() for problem in made]
    agree(COMM.bcast(prefixes) == prefixes and len(set(prefixes)) == 4, prefixes)
    agree(all(p.startswith("linear_problem_") for p in prefixes[:2]), prefixes)
    agree(all(p.startswith("nonlinear_problem_") for p in prefixes[2:]), prefixes)
    agree(not any(p != q and p.startswith(q) for p in prefixes for q in prefixes))


@pytest.mark.skipif(COMM.size == 1, reason="there is one process only")
@pytest.mark.parametrize("other", ["other_", None])
def test_prefix_that_is_not_the_same_on_all(heat, other):
    """A prefix that differs between processes is refused on all of them."""
    with raises(ValueError, "petsc_options_prefix is 'same_' on process 0 and .* on process .: gi"):
        prefix = other if LAST else "same_"
        LinearProblem(heat.a, heat.L, heat.bcs, subdomains=4, petsc_options_prefix=prefix)


# -- signatures

#: Keyword arguments of both classes.
SHARED = {
    "subdomains": None,
    "seed": 0,
    "petsc_options": None,
    "petsc_options_prefix": None,
    "form_compiler_options": None,
    "jit_options": None,
    "near_null_space": None,
    "null_space": None,
    "condense": None,
    "scalars": (),
    "kappa": None,
    "volume_tolerance": None,
    "P": None,
    "kind": None,
    "entity_maps": None,
}


@pytest.mark.serial
@pytest.mark.parametrize("problem", [LinearProblem, NonlinearProblem])
def test_signature_shows_all_arguments(problem):
    """``help()`` shows each argument with type, default and description."""
    parameters = inspect.signature(problem).parameters
    defaults = {name: parameters[name].default for name in SHARED if name in parameters}
    assert defaults == SHARED
    kinds = {parameter.kind for parameter in parameters.values()}
    assert not kinds & {inspect.Parameter.VAR_KEYWORD, inspect.Parameter.VAR_POSITIONAL}
    without_type = [
        name for name, p in parameters.items() if p.annotation is inspect.Parameter.empty
    ]
    assert without_type == []
    documented = re.findall(r"^    (\w+): ", inspect.getdoc(problem.__init__), re.MULTILINE)
    assert documented[: len(parameters)] == list(parameters)


# -- what is answered


def test_preconditioner_and_kind(heat, rubber, caplog):
    """``P``, ``kind`` and ``entity_maps`` of dolfinx are accepted, and logged as without effect."""
    unused = {"P": heat.a, "kind": "mpi", "entity_maps": []}
    problem = LinearProblem(heat.a, heat.L, bcs=heat.bcs, subdomains=4, **unused)
    equal(owned(problem.solve()), owned(heat.u), 1e-6)
    NonlinearProblem(rubber.F, rubber.u, bcs=rubber.bcs, P=rubber.J, subdomains=4)
    texts = [record.message.partition(".")[0] for record in caplog.records]
    expected = ["Without effect: P and kind", "Without effect: P"]
    agree(texts == (expected if COMM.rank == 0 else []), texts)


def test_newton_solver(rubber):
    """Attributes that dolfinx 0.9's NewtonSolver needs raise an error: call problem.solve()."""
    problem = NonlinearProblem(rubber.F, rubber.u, rubber.bcs, subdomains=4)
    with raises(AttributeError, "'L'; it drives Newton's method itself: call problem.solve()"):
        dolfinx.fem.petsc.create_vector(problem.L)
    try:
        problem.a  # noqa: B018
    except AttributeError as error:
        agree("Did you mean" not in "".join(traceback.format_exception(error)), error)
    with raises(AttributeError, "'NonlinearProblem' object has no attribute 'other'$"):
        problem.other  # noqa: B018


def test_subclass_that_hands_its_keywords_on(rubber):
    """A subclass with ``**kwargs`` may pass keywords to the base class."""

    class Adapted(NonlinearProblem):
        def __init__(self, *args: object, **kwargs: object) -> None:
            super().__init__(*args, subdomains=4, **kwargs)

    problem = Adapted(rubber.F, rubber.u, bcs=rubber.bcs, J=rubber.J)
    problem.solve()
    agree(problem.solver.getConvergedReason() > 0)


# -- attributes


def check_common(problem, bcs, prefix):
    """Check the attributes that both problem classes have after a solve."""
    agree(problem.P_mat is None and problem.preconditioner is None)
    agree(problem.bcs == tuple(bcs))
    names = {made.getOptionsPrefix() for made in (problem.A, problem.b, problem.x)}
    agree(names == {f"{prefix}A_", f"{prefix}b_", f"{prefix}x_"})
    equal(problem.x.array_r, owned(problem.u))


def test_attributes_of_a_linear_problem(heat):
    """LinearProblem has the attributes of dolfinx's class."""
    problem = LinearProblem(heat.a, heat.L, heat.bcs, subdomains=4, petsc_options_prefix="heat_")
    uh = problem.solve()
    check_common(problem, heat.bcs, "heat_")
    A = dolfinx.fem.petsc.assemble_matrix(problem.a, bcs=list(problem.bcs))  # as a script would
    A.assemble()
    agree(problem.a is problem.a and A.getSize() == problem.A.getSize())
    L = dolfinx.fem.assemble_vector(problem.L)
    L.scatter_reverse(dolfinx.la.InsertMode.add)
    dolfinx.fem.apply_lifting(L.array, [problem.a], [list(problem.bcs)])
    r = A.createVecLeft()
    A.mult(problem.x, r)
    free = owned(uh).copy()
    for bc in problem.bcs:
        bc.set(free, None, np.nan)
    error = (r.array_r - L.array[: len(owned(uh))])[np.isfinite(free)]
    small(norm(error), 1e-7 * norm(L.array[: len(owned(uh))]))
    A.destroy()
    r.destroy()


def test_attributes_of_a_nonlinear_problem(rubber):
    """NonlinearProblem has the attributes of dolfinx's class."""
    common = {"subdomains": 4, "petsc_options_prefix": "rubber_"}
    problem = NonlinearProblem(rubber.F, rubber.u, rubber.bcs, **common)
    problem.solve()
    check_common(problem, rubber.bcs, "rubber_")
    small(problem.b.norm() - problem.solver.getFunctionNorm(), 1e-15)
    r = dolfinx.fem.assemble_vector(problem.F)
    r.scatter_reverse(dolfinx.la.InsertMode.add)
    for bc in problem.bcs:
        bc.set(r.array, rubber.u.x.array, -1.0)
    uniform(problem.b.array_r - r.array[: len(owned(rubber.u))], 0.0, 1e-14)  # forces are near 1
    J = dolfinx.fem.petsc.assemble_matrix(problem.J, bcs=list(problem.bcs))
    J.assemble()
    agree(problem.J is problem.J and J.getSize() == problem.A.getSize())
    J.destroy()


def test_values_of_conditions_may_change(heat):
    """New values of conditions are used in the next solve; their dofs are fixed."""
    value = dolfinx.fem.Constant(heat.V.mesh, 0.0)
    held = dolfinx.fem.dirichletbc(value, heat.bcs[0].dof_indices()[0], heat.V)
    problem = LinearProblem(heat.a, heat.L, [held], subdomains=4)
    equal(owned(problem.solve()), owned(heat.u), 1e-6)
    value.value = 2.0
    equal(owned(problem.solve()), owned(heat.u) + 2.0, 1e-6)


# -- mixed elements and blocks end in one message


def elastic(mesh):
    """Return Taylor–Hood spaces: displacement, pressure, and both as a mixed space."""
    cell = mesh.basix_cell()
    dim = mesh.geometry.dim
    parts = basix.ufl.element("P", cell, 2, shape=(dim,)), basix.ufl.element("P", cell, 1)
    spaces = [dolfinx.fem.functionspace(mesh, part) for part in parts]
    mixed = dolfinx.fem.functionspace(mesh, basix.ufl.mixed_element(parts))
    return spaces, mixed, ufl.MixedFunctionSpace(*spaces)


def rows(u, p, v, q):
    """Return both rows of linear elasticity with a pressure, and a sideways load."""
    inside = 2 * ufl.inner(ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))) + p * ufl.div(v)
    below = (ufl.div(u) - p / 100.0) * q
    return inside * ufl.dx, below * ufl.dx, v[len(v) - 1] * ufl.dx


def linear_mixed(mesh):
    _, W, _ = elastic(mesh)
    above, below, pull = rows(*ufl.TrialFunctions(W), *ufl.TestFunctions(W))
    LinearProblem(above + below, pull)


def nonlinear_mixed(mesh):
    _, W, _ = elastic(mesh)
    w = dolfinx.fem.Function(W)
    above, below, pull = rows(*ufl.split(w), *ufl.TestFunctions(W))
    NonlinearProblem(above + below - pull, w)


def linear_parts(mesh, *, blocks=False):
    _, _, W = elastic(mesh)
    v, q = ufl.TestFunctions(W)
    above, below, pull = rows(*ufl.TrialFunctions(W), v, q)
    a = above + below
    L = pull + 0 * q * ufl.dx(mesh) if blocks else pull
    LinearProblem(ufl.extract_blocks(a) if blocks else a, L)


def linear_blocks(mesh):
    linear_parts(mesh, blocks=True)


def nonlinear_blocks(mesh):
    spaces, _, _ = elastic(mesh)
    u, p = map(dolfinx.fem.Function, spaces)
    F_u, F_p, pull = rows(u, p, *map(ufl.TestFunction, spaces))
    NonlinearProblem([F_u - pull, F_p], [u, p])


def three_scalars(mesh):
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1))
    species = [dolfinx.fem.Function(V) for _ in range(3)]
    v = ufl.TestFunction(V)
    NonlinearProblem([f * v * ufl.dx for f in species], species)


def flux(mesh):
    cell = mesh.basix_cell()
    family = "RT" if mesh.geometry.dim == 3 else "RTCF"
    pair = [basix.ufl.element(family, cell, 1), basix.ufl.element("DG", cell, 0)]
    W = dolfinx.fem.functionspace(mesh, basix.ufl.mixed_element(pair))
    w = ufl.TrialFunction(W)
    t = ufl.TestFunction(W)
    LinearProblem(ufl.inner(w, t) * ufl.dx, t[0] * ufl.dx)


SOLID = r"A pressure has to be discontinuous.*NonlinearProblem\(\[F_u, F_p\], \[u, p\], bcs=bcs\)"
OTHER = "Solve it by dolfinx, with MUMPS or a field split"
SEVERAL = "If all fields may have the same degree, make them components of one unknown"
SOLIDS = (linear_mixed, nonlinear_mixed, linear_parts, linear_blocks, nonlinear_blocks)
WAYS = {way: SOLID for way in SOLIDS} | {
    three_scalars: SEVERAL,
    flux: f"{OTHER}; or, if the vector is a flux −k ∇p, solve −div",
}


@pytest.mark.parametrize(("way", "text"), WAYS.items())
@pytest.mark.parametrize("cell", [Cell.tetrahedron, Cell.quadrilateral])
def test_one_message(way, text, cell):
    """Each mixed problem that cannot be torn raises the one error that names its remedy."""
    mesh = cube(3, 1) if cell == Cell.tetrahedron else cube(2, 2, cell)
    kind = TypeError if way in (linear_mixed, nonlinear_mixed, flux) else ValueError
    with raises(kind, f"(of|has) [23].*but only a problem on one continuous space is torn. {text}"):
        way(mesh)
