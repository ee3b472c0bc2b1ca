# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Bad input to both problems: an error that names argument, value and remedy, on all processes."""

from __future__ import annotations

from dataclasses import replace

from petsc4py import PETSc

import numpy as np
import pytest
from collective import COMM, agree, raises
from problems import Problem, cube, dirichlet, elasticity, left, poisson
from walls import Wall, tube, wall

import basix.ufl
import dolfinx
import ufl

from dolfinx_feti import ConvergenceError, LinearProblem, NonlinearProblem, kinematics, materials
from dolfinx_feti.runtime.compat import has_vertex_integrals
from dolfinx_feti.runtime.petsc_options import inserted

DEFAULTS = {"subdomains": 4, "petsc_options_prefix": "bad_"}
LAST = COMM.rank == COMM.size - 1


def linear(problem, **changes):
    """Make a linear problem that is all right but for the changes."""
    right = {"a": problem.a, "L": problem.L, "bcs": problem.bcs}
    return LinearProblem(**(right | DEFAULTS | changes))


def nonlinear(problem, **changes):
    """Make the same one by its residual."""
    u = dolfinx.fem.Function(problem.V)
    right = {"F": ufl.action(problem.a, u) - problem.L, "u": u, "bcs": problem.bcs}
    return NonlinearProblem(**(right | DEFAULTS | changes))


# ---- what both take -------------------------------------------------------------------------


def other_condition(problem, component=None):
    """Return a condition on a space that looks like V."""
    other = dolfinx.fem.functionspace(problem.V.mesh, problem.V.ufl_element())
    return dirichlet(other, left, component=component)


def one_too_many_on_the_first(problem):
    """Return subdomains with one number too many on the first process."""
    cells = problem.cells + 1 if COMM.rank == 0 else problem.cells
    return np.zeros(cells, dtype=np.int64)


#: An argument, its wrong value for a plane displacement on 32 cells, and the message.
COMMON = [
    ("subdomains", lambda p: 0, "subdomains is 0, but the mesh has 32"),
    ("subdomains", lambda p: -1, "subdomains is -1, but the mesh has 32 cells"),
    ("subdomains", lambda p: 33, "subdomains is 33, but the mesh has 32"),
    ("subdomains", lambda p: np.zeros(p.cells + 1, dtype=np.int32), "shape.*process.*owns"),
    ("subdomains", one_too_many_on_the_first, "has shape"),
    ("subdomains", lambda p: np.zeros((p.cells, 2), dtype=np.int32), "has shape"),
    ("subdomains", lambda p: np.arange(p.cells) - LAST, "a cell in part -1: number the parts from"),
    *(
        ("subdomains", lambda p, dtype=dtype: np.zeros(p.cells, dtype=dtype), "of type.*integers")
        for dtype in (np.float64, np.bool_, np.str_)
    ),
    *(("subdomains", lambda p, n=n: n, "subdomains") for n in (2.0, "metis", [0.5])),
    *(
        ("seed", lambda p, n=n: n, "seed is .*give zero or a positive integer")
        for n in (-1, 0.5, None, "clock")
    ),
    ("petsc_options_prefix", lambda p: "", "petsc_options_prefix is .*non-empty string"),
    ("petsc_options_prefix", lambda p: 7, "petsc_options_prefix is .*non-empty string"),
    ("bcs", lambda p: [*p.bcs, other_condition(p)], r"bcs\[1\] lives on another function space"),
    ("bcs", lambda p: [other_condition(p, 1)], r"bcs\[0\] lives on another function space"),
    ("bcs", lambda p: p.bcs[0], r"bcs is a Dirichlet condition alone: put it in a list, bcs="),
    ("bcs", lambda p: [None if LAST else p.bcs[0]], r"bcs\[0\] is None: give what dolfinx"),
    ("entity_maps", lambda p: ["map"], "entity_maps relates several meshes.*mesh of the unknown"),
]


@pytest.mark.parametrize("create", [linear, nonlinear])
@pytest.mark.parametrize(("name", "wrong", "message"), COMMON)
def test_common(create, name, wrong, message):
    """None leaves an object behind: __del__ copes with an __init__ that has raised."""
    problem = elasticity(cube(2, 4))
    kind = TypeError if message in ("subdomains", "of type.*integers") else ValueError
    with raises(kind, message):
        create(problem, **{name: wrong(problem)})


def test_arguments_that_do_not_exist():
    """What the two classes tell their base class is none of the user's."""
    body = poisson(cube(2, 4))
    for create, more in ((linear, ("quadrature_degree", "volume_ratio")), (nonlinear, ())):
        for name in ("bad", "name", "forms", *more):
            with raises(TypeError, rf"Problem\(\) got an unexpected keyword argument '{name}'"):
                create(body, **{name: None})


OPTIONS = [
    ("feti_pctype", "lumped", "-bad_feti_pctype.*did you mean -bad_feti_pc_type"),
    ("feti_scaling", "deluxe", "-bad_feti_scaling is 'deluxe'.*stiffness, multiplicity"),
    ("ksp_rtol", "abc", "-bad_ksp_rtol is 'abc'; it takes a number ≥ 0 and < 1"),
    ("ksp_max_it", "many", "-bad_ksp_max_it is 'many'; it takes a whole number"),
    ("ksp_norm_type", "foo", "PETSc refuses one of the options -bad_…: .*foo"),
]
SNES = [
    ("snes_max_it", 2.5, "-bad_snes_max_it is '2.5'; it takes a whole number"),
    ("snes_monitor_cancel", "maybe", "PETSc refuses one of the options .*maybe"),
]


@pytest.mark.parametrize(
    ("create", "name", "wrong", "message"),
    [(c, *o) for c in (linear, nonlinear) for o in OPTIONS] + [(nonlinear, *o) for o in SNES],
)
def test_options(create, name, wrong, message):
    """In the call, on one process too, and on the command line; the database is as before."""
    problem = poisson(cube(2, 4))
    before = PETSc.Options().getAll()
    for there in (True, LAST):
        with raises(ValueError, message):
            create(problem, petsc_options={name: wrong} if there else {})
    agree(PETSc.Options().getAll() == before)
    with inserted("bad_", {name: wrong}), raises(ValueError, message):
        create(problem)


ELEMENTS = [("RT", 1), ("N1curl", 1), ("DG", 1, (2,)), ("DG", 0), ("CR", 1)]


@pytest.mark.parametrize("create", [linear, nonlinear])
def test_elements_that_cannot_be_torn(create):
    mesh = cube(2, 3)
    discontinuous = basix.ufl.element("P", mesh.basix_cell(), 1, discontinuous=True)
    for element in (*ELEMENTS, discontinuous):
        V = dolfinx.fem.functionspace(mesh, element)
        u = ufl.TrialFunction(V)
        v = ufl.TestFunction(V)
        a, L = (ufl.inner(f, v) * ufl.dx for f in (u, dolfinx.fem.Function(V)))
        with raises(TypeError, "needs a continuous element, scalar or blocked: use .'Lagrange'"):
            create(Problem(V, a, L, []))


@pytest.mark.parametrize("create", [linear, nonlinear])
def test_interior_facet_integrals(create):
    body = poisson(cube(2, 4))
    penalty = ufl.avg(ufl.TrialFunction(body.V)) * ufl.avg(ufl.TestFunction(body.V)) * ufl.dS
    with raises(ValueError, r"use a form with dx and ds only.*dolfinx_feti\.fem\.facets\.one_side"):
        create(replace(body, a=body.a + penalty))


@pytest.mark.parametrize("scalar", [np.complex128, np.float32])
@pytest.mark.parametrize("create", [linear, nonlinear])
def test_other_scalar_types(create, scalar, monkeypatch):
    monkeypatch.setattr(PETSc, "ScalarType", scalar)
    with raises(TypeError, f"{np.dtype(scalar)}.*real double precision"):
        create(poisson(cube(2, 4)))


@pytest.mark.parametrize("kind", ["all_floating", "classical"])
@pytest.mark.parametrize("create", [linear, nonlinear])
def test_no_condition_at_all(create, kind):
    """The kernel is counted, and u stays."""
    problem = create(elasticity(cube(2, 4), clamped=None), petsc_options={"feti_type": kind})
    with raises(ConvergenceError, "singular, with a kernel of dimension 3.*Add Dirichlet cond"):
        problem.solve()
    agree(not problem.u.x.array.any())


# ---- a linear problem -----------------------------------------------------------------------


BLOCK = "is a block of 2, but only a problem on one .* is torn. If all .* components of one unknown"
COMPILED = "is a compiled form, which cannot be torn any more: give the form of UFL"
COMPLEX = "contains .*complex128.* real and imaginary parts"


def complex_data(V):
    """Return a Function and a Constant of complex numbers."""
    one = dolfinx.fem.Constant(V.mesh, np.complex128(1.0 + 2.0j))
    return dolfinx.fem.Function(V, dtype=np.complex128), one


def test_linear_forms():
    problem = poisson(cube(2, 4))
    V = problem.V
    a = problem.a
    L = problem.L
    W, Q = (dolfinx.fem.functionspace(V.mesh, e) for e in (("Lagrange", 2), ("DG", 0)))
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    w = ufl.TestFunction(W)
    uh = dolfinx.fem.Function(V)
    twice = [[a, None], [None, a]]
    condense = {"condense": dolfinx.fem.Function(Q)}
    for changes, message in (
        ({"u": dolfinx.fem.Function(W)}, "a has .* on another function space than u"),
        ({"a": u * w * ufl.dx}, "a has a test or trial function on another"),
        ({"L": 1.0 * w * ufl.dx}, "L has"),
        ({"a": L, "L": a}, "a has"),
        ({"a": twice, "L": [L, L]}, f"^a {BLOCK}"),
        ({"a": twice, "L": [L]}, "There are 2 unknowns: give a as 2 × 2 blocks"),
        ({"a": twice, "L": [L, 3]}, "a or L holds 3: give forms of UFL, or None for zero"),
        ({"u": [uh, uh]}, "There are 2 unknowns: give a as 2 × 2 blocks"),
        ({"a": dolfinx.fem.form(a)}, f"^a {COMPILED}"),
        ({"L": dolfinx.fem.form(L)}, f"^L {COMPILED}"),
        ({"L": 0}, "^L is 0: give a form of UFL"),
        ({"a": [[a]], "L": [L], **condense}, r"give a as 2 × 2 blocks, such as \[\[a_uu, a_up\]"),
        ({"a": twice, "L": [L, None], **condense}, r"a\[1\]\[1\] has test and .* other spaces"),
        *(({"a": k * u * v * ufl.dx}, f"a {COMPLEX}") for k in complex_data(V)),
    ):
        with raises(TypeError if COMPLEX in message else ValueError, message):
            linear(problem, **changes)


@pytest.mark.skipif(has_vertex_integrals(), reason="dolfinx assembles them")
def test_springs_at_points_need_a_newer_dolfinx():
    body = poisson(cube(2, 2))
    u = ufl.TrialFunction(body.V)
    v = ufl.TestFunction(body.V)
    with raises(ValueError, "dP, which dolfinx assembles from 0.10 on"):
        linear(body, a=body.a + u * v * ufl.Measure("dP", body.V.mesh))


def test_mesh_in_single_precision():
    mesh = dolfinx.mesh.create_unit_square(COMM, 3, 3, dtype=np.float32)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1))
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    with raises(TypeError, "float32.*float64"):
        linear(Problem(V, u * v * ufl.dx, 1.0 * v * ufl.dx, []))


def test_unsymmetric_matrix_with_cg():
    body = poisson(cube(2, 6))
    a = body.a + 5.0 * ufl.TrialFunction(body.V).dx(0) * ufl.TestFunction(body.V) * ufl.dx
    made = linear(body, a=a, petsc_options={"feti_dual_ksp_type": "cg"})
    with raises(ConvergenceError, "not symmetric.*-bad_feti_formulation primal"):
        made.solve()


# ---- residuals, energies and condensed fields -----------------------------------------------


@pytest.fixture(scope="module")
def body() -> Wall:
    """A small wall of P1–P0 elements; no test moves it."""
    return wall(tube(around=6, along=1), degree=1)


def create(body, **changes):
    """Make a problem that is all right but for the changes."""
    arguments = {"F": [body.F_u, body.F_p], "u": body.u, "bcs": body.bcs, "condense": body.p}
    return NonlinearProblem(**(arguments | DEFAULTS | {"subdomains": 2} | changes))


def space(body, *element):
    return dolfinx.fem.functionspace(body.u.function_space.mesh, element)


def solid(body):
    """Return an energy without a pressure, and det F."""
    F = kinematics.deformation_gradient(body.u)
    J = kinematics.jacobian(F)
    return materials.neo_hookean(kinematics.right_cauchy_green(F), c=3.0, J=J), J


def test_nothing_is_wrong(body):
    """The other tests fail for the reason that they change; the same energy twice is fine."""
    create(body)
    psi, J = solid(body)
    energy = (psi + (J - 1) ** 2) * ufl.dx
    create(body, F=energy, energy=energy, condense=None)


def test_forms(body):
    u = body.u
    p = body.p
    F_u = body.F_u
    F_p = body.F_p
    twin = dolfinx.fem.Function(u.function_space)
    V = u.function_space
    W = space(body, "Lagrange", 2, (3,))
    S = space(body, "Lagrange", 1)
    one = dolfinx.fem.Constant(V.mesh, 1.0)
    du = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    q = ufl.TestFunction(p.function_space)
    foreign = [ufl.TestFunction(other) for other in (W, space(body, "Lagrange", 1, (3,)))]
    J_u = ufl.inner(ufl.grad(du), ufl.grad(v)) * ufl.dx
    psi, J = solid(body)
    whole, twice = ((psi + kappa * (J - 1) ** 2) * ufl.dx for kappa in (1.0, 2.0))
    inside = ufl.inner(ufl.jump(ufl.grad(u)), ufl.jump(ufl.grad(u))) * ufl.dS
    alone = {"condense": None}
    other = " has a test or trial function on another function space than u"
    tolerance = "volume_tolerance is"
    for changes, message in (
        ({"F": ufl.inner(du, v) * ufl.dx, **alone}, "F has 2 arguments: give a residual or an"),
        ({"F": F_u}, "F has 1 arguments: .*the pair of its residuals"),
        (alone, "F is a sequence of 2 forms: .*condense=p"),
        ({"F": [F_u, F_p, F_p]}, "F is a sequence of 3 forms: give a residual .* and one for"),
        ({"F": [body.energy, F_p]}, "F is a sequence of 2 forms: give a residual "),
        ({"F": [F_p, F_u]}, "residuals on other spaces: test them with v in V and q in Q"),
        *(({"F": ufl.inner(u, w) * ufl.dx, **alone}, f"F{other}") for w in foreign),
        ({"J": F_u}, "J has 1 test and trial functions, but takes 2"),
        ({"J": ufl.inner(ufl.TrialFunction(W), foreign[0]) * ufl.dx}, f"J{other}"),
        ({"F": one * ufl.dx, **alone}, "unknown 'u' does not occur in F"),
        ({"F": one * v[2] * ufl.dx, **alone}, "unknown 'u' does not occur in F"),
        ({"F": psi * ufl.dx + inside, **alone}, "interior-facet integrals, .*dx and ds only"),
        ({"F": [F_u, F_p + ufl.jump(p) * ufl.jump(q) * ufl.dS]}, "interior-facet integrals"),
        ({"F": whole, "energy": twice, **alone}, "energy is not F, .*: leave energy out"),
        ({"quadrature_degree": -1}, "degree = -1"),
        ({"F": [F_u, F_u], "u": [u, u], **alone}, "u holds a Function twice"),
        ({"F": [F_u, F_u], "u": [u, twin], **alone}, f"^u {BLOCK}"),
        *(({"u": wrong}, "^u is .*: give a dolf") for wrong in (ufl.split(u)[:2], [u, 3], "up")),
        ({"J": [[J_u, None]]}, "^J is no 2 × 2 block: .* leave J out"),
        ({"J": [[None, None], [None, None]]}, r"^J has no block of u, J\[0\]\[0\]"),
        ({"F": dolfinx.fem.form(F_u), **alone}, f"^F {COMPILED}"),
        ({"J": dolfinx.fem.form(J_u)}, f"^J {COMPILED}"),
        *(({"F": k * u[0] * v[0] * ufl.dx, **alone}, f"F {COMPLEX}") for k in complex_data(S)),
        *(({"volume_tolerance": n}, f"{tolerance} .*: give a number") for n in (0.0, -1.0, np.nan)),
        ({"F": psi * ufl.dx, "volume_tolerance": 1, **alone}, f"{tolerance} given, but no press"),
    ):
        with raises(TypeError if COMPLEX in message else ValueError, message):
            create(body, **changes)


@pytest.mark.parametrize("element", [("Lagrange", 1), ("CR", 1), ("RT", 1)])
def test_space_of_the_pressure(body, element):
    p = dolfinx.fem.Function(space(body, *element), name="π")
    with raises(TypeError, r"condense\[0\] is 'π' with the element .*use a discontinuous element"):
        create(body, condense=p)


def test_condensed_fields(body):
    p = body.p
    u = body.u
    mesh = dolfinx.mesh.create_unit_cube(COMM, 2, 2, 2)
    elsewhere = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)), name="q")
    θ, absent = (dolfinx.fem.Function(p.function_space, name=name) for name in ("θ", "other"))
    psi, _ = solid(body)
    missing = "condense is 'other', which does not occur in the"
    for changes, kind, message in (
        ({"condense": [p, p]}, ValueError, r"condense\[1\] is 'p', which is the unknown or given"),
        ({"condense": u}, ValueError, r"condense\[0\] is 'u', which is the unknown"),
        ({"condense": [7]}, TypeError, r"condense\[0\] is 7: give a dolfinx.fem.Function"),
        (
            {"condense": elsewhere},
            ValueError,
            r"condense\[0\] is 'q' on another mesh than the unknown",
        ),
        ({"condense": [θ, p]}, ValueError, "F is a sequence of 2 forms: .* one for each condensed"),
        ({"F": body.energy, "condense": absent}, ValueError, missing),
        ({"condense": absent}, ValueError, missing),
        ({"F": (psi + p**2) * ufl.dx}, ValueError, "K_up is zero"),
    ):
        with raises(kind, message):
            create(body, **changes)


# -- what is on another mesh, or numbers another thing


def poisson_on(mesh, f=1.0, *, nonlinear=False, bcs=None, **arguments):
    dx = ufl.dx(mesh)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1))
    v = ufl.TestFunction(V)
    w = ufl.TrialFunction(V)
    bcs = [dirichlet(V, left)] if bcs is None else bcs(V)
    if not nonlinear:
        a = ufl.inner(ufl.grad(w), ufl.grad(v)) * dx
        return LinearProblem(a, f * v * dx, bcs=bcs, **arguments)
    u = dolfinx.fem.Function(V)
    return NonlinearProblem(ufl.inner(ufl.grad(u), ufl.grad(v)) * dx - f * v * dx, u, bcs=bcs)


@pytest.mark.parametrize("nonlinear", [False, True])
@pytest.mark.parametrize("element", [("Lagrange", 1), ("DG", 0)])
def test_coefficient_of_another_mesh(element, nonlinear):
    other = cube(2, 3)
    f = dolfinx.fem.Function(dolfinx.fem.functionspace(other, element), name="source")
    name = "F" if nonlinear else "L"
    with raises(ValueError, f"{name} contains the Function 'source' on another mesh.*interpolate"):
        poisson_on(cube(2, 4), f, nonlinear=nonlinear)


@pytest.mark.parametrize("nonlinear", [False, True])
def test_coordinate_of_another_mesh(nonlinear):
    x = ufl.SpatialCoordinate(cube(2, 3))
    with raises(ValueError, "coordinate of another mesh|on another mesh"):
        poisson_on(cube(2, 4), x[0], nonlinear=nonlinear)


@pytest.mark.parametrize("wrong", [2.5, 4.0, "4", np.float64(3.0)])
def test_subdomains_that_are_no_whole_number(wrong):
    with raises(TypeError, rf"subdomains is .*{wrong}.*: give a whole number"):
        poisson_on(cube(2, 4), subdomains=wrong)


@pytest.mark.parametrize("nonlinear", [False, True])
def test_conditions_on_dofs_that_are_not_there(nonlinear):
    """As of a vector space, where only blocks are numbered."""

    def of_another(V):
        size = V.dofmap.index_map.size_local + V.dofmap.index_map.num_ghosts
        return [dolfinx.fem.dirichletbc(0.0, np.array([2 * size], dtype=np.int32), V)]

    with raises(ValueError, r"bcs\[0\] prescribes dof .* one number for all components"):
        poisson_on(cube(2, 4), nonlinear=nonlinear, bcs=of_another)
