# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Both problem classes refuse bad input on all processes, naming argument, value and remedy."""

from __future__ import annotations

from dataclasses import replace

from petsc4py import PETSc

import numpy as np
import pytest
from cases import each
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
    """Create a valid linear problem, with some of its arguments replaced."""
    right = {"a": problem.a, "L": problem.L, "bcs": problem.bcs}
    return LinearProblem(**(right | DEFAULTS | changes))


def nonlinear(problem, **changes):
    """Create the same problem from its residual, with some of its arguments replaced."""
    u = dolfinx.fem.Function(problem.V)
    right = {"F": ufl.action(problem.a, u) - problem.L, "u": u, "bcs": problem.bcs}
    return NonlinearProblem(**(right | DEFAULTS | changes))


# ---- what both take -------------------------------------------------------------------------


def other_condition(problem, component=None):
    """Return a condition on another space than V, which has the same element."""
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
def test_bad_arguments_of_both_classes_are_named(create, name, wrong, message):
    """Each bad argument raises an error that names it, and ``__del__`` raises no second one."""
    problem = elasticity(cube(2, 4))
    kind = TypeError if message in ("subdomains", "of type.*integers") else ValueError
    with raises(kind, message):
        create(problem, **{name: wrong(problem)})


def test_arguments_that_do_not_exist():
    """Unknown keywords raise a TypeError, those of dolfinx's base class included."""
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
def test_bad_options_leave_the_database_unchanged(create, name, wrong, message):
    """A bad option of a call or the command line is an error that leaves the database unchanged."""
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
    """Elements without continuous dofs at the nodes are refused with a list of suitable ones."""
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
    """A bilinear form with ``dS`` is refused; the message recommends ``one_side``."""
    body = poisson(cube(2, 4))
    penalty = ufl.avg(ufl.TrialFunction(body.V)) * ufl.avg(ufl.TestFunction(body.V)) * ufl.dS
    with raises(ValueError, r"use a form with dx and ds only.*dolfinx_feti\.fem\.facets\.one_side"):
        create(replace(body, a=body.a + penalty))


@pytest.mark.parametrize("scalar", [np.complex128, np.float32])
@pytest.mark.parametrize("create", [linear, nonlinear])
def test_other_scalar_types(create, scalar, monkeypatch):
    """A PETSc build with another scalar type than float64 is refused."""
    monkeypatch.setattr(PETSc, "ScalarType", scalar)
    with raises(TypeError, f"{np.dtype(scalar)}.*real double precision"):
        create(poisson(cube(2, 4)))


@pytest.mark.parametrize("kind", ["all_floating", "classical"])
@pytest.mark.parametrize("create", [linear, nonlinear])
def test_no_condition_at_all(create, kind):
    """Without conditions the error states the dimension of the kernel, and u keeps its values."""
    problem = create(elasticity(cube(2, 4), clamped=None), petsc_options={"feti_type": kind})
    with raises(ConvergenceError, "singular, with a kernel of dimension 3.*Add Dirichlet cond"):
        problem.solve()
    agree(not problem.u.x.array.any())


# ---- a linear problem -----------------------------------------------------------------------


BLOCK = "is a block of 2, but only a problem on one .* is torn. If all .* components of one unknown"
COMPILED = "is a compiled form, which cannot be torn any more: give the form of UFL"
COMPLEX = "contains .*complex128.* real and imaginary parts"


def complex_function(V):
    return dolfinx.fem.Function(V, dtype=np.complex128)


def complex_constant(V):
    return dolfinx.fem.Constant(V.mesh, np.complex128(1.0 + 2.0j))


class Poisson:
    """Poisson's equation as blocks and forms that are right, and spaces that are not its own."""

    def __init__(self):
        self.problem = poisson(cube(2, 4))
        self.V = self.problem.V
        self.a = self.problem.a
        self.L = self.problem.L
        self.other = dolfinx.fem.functionspace(self.V.mesh, ("Lagrange", 2))
        self.pressures = dolfinx.fem.functionspace(self.V.mesh, ("DG", 0))
        self.u = ufl.TrialFunction(self.V)
        self.v = ufl.TestFunction(self.V)
        self.w = ufl.TestFunction(self.other)
        self.uh = dolfinx.fem.Function(self.V)
        self.p = dolfinx.fem.Function(self.pressures)
        self.diagonal = [[self.a, None], [None, self.a]]


#: Wrong arguments of a linear problem, and the message.
LINEAR = {
    "u-of-another-space": (
        lambda b: {"u": dolfinx.fem.Function(b.other)},
        "a has .* on another function space than u",
    ),
    "a-of-another-space": (
        lambda b: {"a": b.u * b.w * ufl.dx},
        "a has a test or trial function on another",
    ),
    "L-of-another-space": (lambda b: {"L": 1.0 * b.w * ufl.dx}, "L has"),
    "swapped": (lambda b: {"a": b.L, "L": b.a}, "a has"),
    "blocks": (lambda b: {"a": b.diagonal, "L": [b.L, b.L]}, f"^a {BLOCK}"),
    "blocks-with-one-load": (
        lambda b: {"a": b.diagonal, "L": [b.L]},
        "There are 2 unknowns: give a as 2 × 2 blocks",
    ),
    "number-as-a-block": (
        lambda b: {"a": b.diagonal, "L": [b.L, 3]},
        "a or L holds 3: give forms of UFL, or None for zero",
    ),
    "two-unknowns-in-one-block": (
        lambda b: {"u": [b.uh, b.uh]},
        "There are 2 unknowns: give a as 2 × 2 blocks",
    ),
    "compiled-a": (lambda b: {"a": dolfinx.fem.form(b.a)}, f"^a {COMPILED}"),
    "compiled-L": (lambda b: {"L": dolfinx.fem.form(b.L)}, f"^L {COMPILED}"),
    "number-as-L": (lambda b: {"L": 0}, "^L is 0: give a form of UFL"),
    "one-block-of-two": (
        lambda b: {"a": [[b.a]], "L": [b.L], "condense": b.p},
        r"give a as 2 × 2 blocks, such as \[\[a_uu, a_up\]",
    ),
    "block-of-another-space": (
        lambda b: {"a": b.diagonal, "L": [b.L, None], "condense": b.p},
        r"a\[1\]\[1\] has test and .* other spaces",
    ),
    "complex-function": (
        lambda b: {"a": complex_function(b.V) * b.u * b.v * ufl.dx},
        f"a {COMPLEX}",
    ),
    "complex-constant": (
        lambda b: {"a": complex_constant(b.V) * b.u * b.v * ufl.dx},
        f"a {COMPLEX}",
    ),
}


@each(("wrong", "message"), LINEAR)
def test_linear_forms(wrong, message):
    """LinearProblem refuses forms and arguments that do not fit together."""
    body = Poisson()
    with raises(TypeError if COMPLEX in message else ValueError, message):
        linear(body.problem, **wrong(body))


@pytest.mark.skipif(has_vertex_integrals(), reason="dolfinx assembles them")
def test_springs_at_points_need_a_newer_dolfinx():
    """With dolfinx 0.9, vertex integrals raise an error that names the needed version."""
    body = poisson(cube(2, 2))
    u = ufl.TrialFunction(body.V)
    v = ufl.TestFunction(body.V)
    with raises(ValueError, "dP, which dolfinx assembles from 0.10 on"):
        linear(body, a=body.a + u * v * ufl.Measure("dP", body.V.mesh))


def test_mesh_in_single_precision():
    """A mesh with float32 coordinates is refused."""
    mesh = dolfinx.mesh.create_unit_square(COMM, 3, 3, dtype=np.float32)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1))
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    with raises(TypeError, "float32.*float64"):
        linear(Problem(V, u * v * ufl.dx, 1.0 * v * ufl.dx, []))


def test_unsymmetric_matrix_with_cg():
    """Dual conjugate gradients refuse an unsymmetric matrix, and the primal form is advised."""
    body = poisson(cube(2, 6))
    a = body.a + 5.0 * ufl.TrialFunction(body.V).dx(0) * ufl.TestFunction(body.V) * ufl.dx
    problem = linear(body, a=a, petsc_options={"feti_dual_ksp_type": "cg"})
    with raises(ConvergenceError, "not symmetric.*-bad_feti_formulation primal"):
        problem.solve()


# ---- residuals, energies and condensed fields -----------------------------------------------


@pytest.fixture(scope="module")
def body() -> Wall:
    """A small wall of P1–P0 elements, which tests do not deform."""
    return wall(tube(around=6, along=1), degree=1)


def create(body, **changes):
    """Create a valid nonlinear problem, with some of its arguments replaced."""
    arguments = {"F": [body.F_u, body.F_p], "u": body.u, "bcs": body.bcs, "condense": body.p}
    return NonlinearProblem(**(arguments | DEFAULTS | {"subdomains": 2} | changes))


def space(body, *element):
    """Return a function space on the mesh of a body."""
    return dolfinx.fem.functionspace(body.u.function_space.mesh, element)


def solid(body):
    """Return an energy without a pressure, and det F."""
    F = kinematics.deformation_gradient(body.u)
    J = kinematics.jacobian(F)
    return materials.neo_hookean(kinematics.right_cauchy_green(F), c=3.0, J=J), J


def test_unchanged_arguments_are_valid(body):
    """The arguments that the other tests change are valid when they are unchanged."""
    create(body)
    psi, J = solid(body)
    energy = (psi + (J - 1) ** 2) * ufl.dx
    create(body, F=energy, energy=energy, condense=None)


class WallForms:
    """Valid forms of a wall, and forms that NonlinearProblem has to refuse."""

    def __init__(self, body):
        V = body.u.function_space
        self.u = body.u
        self.p = body.p
        self.V = V
        self.energy = body.energy
        self.F_u = body.F_u
        self.F_p = body.F_p
        self.twin = dolfinx.fem.Function(V)
        self.quadratic = space(body, "Lagrange", 2, (3,))
        self.scalars = space(body, "Lagrange", 1)
        self.one = dolfinx.fem.Constant(V.mesh, 1.0)
        self.du = ufl.TrialFunction(V)
        self.v = ufl.TestFunction(V)
        self.q = ufl.TestFunction(body.p.function_space)
        self.foreign_v = ufl.TestFunction(self.quadratic)
        self.v_of_a_twin = ufl.TestFunction(space(body, "Lagrange", 1, (3,)))
        self.tangent = ufl.inner(ufl.grad(self.du), ufl.grad(self.v)) * ufl.dx
        self.psi, self.J = solid(body)

    def compressible(self, kappa):
        """Return an energy without a pressure."""
        return (self.psi + kappa * (self.J - 1) ** 2) * ufl.dx

    def jumps(self):
        """Return a penalty on interior facets."""
        jump = ufl.jump(ufl.grad(self.u))
        return ufl.inner(jump, jump) * ufl.dS


ALONE = {"condense": None}
OTHER_SPACE = " has a test or trial function on another function space than u"
TOLERANCE = "volume_tolerance is"

#: Wrong arguments of a nonlinear problem, and the message.
FORMS = {
    "bilinear-F": (
        lambda w: {"F": ufl.inner(w.du, w.v) * ufl.dx, **ALONE},
        "F has 2 arguments: give a residual or an",
    ),
    "energy-in-a-trial-function": (
        lambda w: {"F": ufl.inner(w.du, w.du) * ufl.dx, **ALONE},
        "F contains a TrialFunction: write it in the unknown",
    ),
    "energy-partly-in-a-trial-function": (
        lambda w: {"F": w.energy + w.du[0] * ufl.dx},
        "F contains a TrialFunction: write it in the unknown",
    ),
    "potential-in-a-trial-function": (
        lambda w: {"energy": w.du[0] * ufl.dx},
        "energy contains a TrialFunction",
    ),
    "one-residual": (lambda w: {"F": w.F_u}, "F has 1 arguments: .*the pair of its residuals"),
    "nothing-condensed": (lambda w: ALONE, "F is a sequence of 2 forms: .*condense=p"),
    "three-residuals": (
        lambda w: {"F": [w.F_u, w.F_p, w.F_p]},
        "F is a sequence of 3 forms: give a residual .* and one for",
    ),
    "energy-as-a-residual": (
        lambda w: {"F": [w.energy, w.F_p]},
        "F is a sequence of 2 forms: give a residual ",
    ),
    "swapped-residuals": (
        lambda w: {"F": [w.F_p, w.F_u]},
        "residuals on other spaces: test them with v in V and q in Q",
    ),
    "F-of-another-space": (
        lambda w: {"F": ufl.inner(w.u, w.foreign_v) * ufl.dx, **ALONE},
        f"F{OTHER_SPACE}",
    ),
    "F-of-an-equal-space": (
        lambda w: {"F": ufl.inner(w.u, w.v_of_a_twin) * ufl.dx, **ALONE},
        f"F{OTHER_SPACE}",
    ),
    "linear-J": (lambda w: {"J": w.F_u}, "J has 1 test and trial functions, but takes 2"),
    "J-of-another-space": (
        lambda w: {"J": ufl.inner(ufl.TrialFunction(w.quadratic), w.foreign_v) * ufl.dx},
        f"J{OTHER_SPACE}",
    ),
    "energy-without-u": (
        lambda w: {"F": w.one * ufl.dx, **ALONE},
        "unknown 'u' does not occur in F",
    ),
    "residual-without-u": (
        lambda w: {"F": w.one * w.v[2] * ufl.dx, **ALONE},
        "unknown 'u' does not occur in F",
    ),
    "jumps-of-u": (
        lambda w: {"F": w.psi * ufl.dx + w.jumps(), **ALONE},
        "interior-facet integrals, .*dx and ds only",
    ),
    "jumps-of-p": (
        lambda w: {"F": [w.F_u, w.F_p + ufl.jump(w.p) * ufl.jump(w.q) * ufl.dS]},
        "interior-facet integrals",
    ),
    "two-energies": (
        lambda w: {"F": w.compressible(1.0), "energy": w.compressible(2.0), **ALONE},
        "energy is not F, .*: leave energy out",
    ),
    "negative-degree": (lambda w: {"quadrature_degree": -1}, "degree = -1"),
    "u-twice": (
        lambda w: {"F": [w.F_u, w.F_u], "u": [w.u, w.u], **ALONE},
        "u holds a Function twice",
    ),
    "two-unknowns": (lambda w: {"F": [w.F_u, w.F_u], "u": [w.u, w.twin], **ALONE}, f"^u {BLOCK}"),
    "parts-of-u": (lambda w: {"u": ufl.split(w.u)[:2]}, "^u is .*: give a dolf"),
    "number-as-an-unknown": (lambda w: {"u": [w.u, 3]}, "^u is .*: give a dolf"),
    "text-as-u": (lambda w: {"u": "up"}, "^u is .*: give a dolf"),
    "one-row-of-J": (lambda w: {"J": [[w.tangent, None]]}, "^J is no 2 × 2 block: .* leave J out"),
    "empty-J": (
        lambda w: {"J": [[None, None], [None, None]]},
        r"^J has no block of u, J\[0\]\[0\]",
    ),
    "compiled-F": (lambda w: {"F": dolfinx.fem.form(w.F_u), **ALONE}, f"^F {COMPILED}"),
    "compiled-J": (lambda w: {"J": dolfinx.fem.form(w.tangent)}, f"^J {COMPILED}"),
    "complex-function": (
        lambda w: {"F": complex_function(w.scalars) * w.u[0] * w.v[0] * ufl.dx, **ALONE},
        f"F {COMPLEX}",
    ),
    "complex-constant": (
        lambda w: {"F": complex_constant(w.scalars) * w.u[0] * w.v[0] * ufl.dx, **ALONE},
        f"F {COMPLEX}",
    ),
    "no-tolerance": (lambda w: {"volume_tolerance": 0.0}, f"{TOLERANCE} .*: give a number"),
    "negative-tolerance": (lambda w: {"volume_tolerance": -1.0}, f"{TOLERANCE} .*: give a number"),
    "nan-tolerance": (lambda w: {"volume_tolerance": np.nan}, f"{TOLERANCE} .*: give a number"),
    "tolerance-without-a-pressure": (
        lambda w: {"F": w.psi * ufl.dx, "volume_tolerance": 1, **ALONE},
        f"{TOLERANCE} given, but no press",
    ),
}


@each(("wrong", "message"), FORMS)
def test_forms_that_do_not_fit_are_refused(body, wrong, message):
    """NonlinearProblem refuses each form that does not fit u, p or its arguments."""
    with raises(TypeError if COMPLEX in message else ValueError, message):
        create(body, **wrong(WallForms(body)))


@pytest.mark.parametrize("element", [("Lagrange", 1), ("CR", 1), ("RT", 1)])
def test_space_of_the_pressure(body, element):
    """A pressure space that cannot be condensed is refused."""
    p = dolfinx.fem.Function(space(body, *element), name="π")
    with raises(TypeError, r"condense\[0\] is 'π' with the element .*use a discontinuous element"):
        create(body, condense=p)


def function_elsewhere(body):
    mesh = dolfinx.mesh.create_unit_cube(COMM, 2, 2, 2)
    return dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)), name="q")


def other_pressure(body):
    return dolfinx.fem.Function(body.p.function_space, name="other")


UNUSED = "condense is 'other', which does not occur in the"

#: Wrong fields to be condensed, and the message; TypeError if the field is none.
CONDENSED = {
    "twice": (
        lambda b: {"condense": [b.p, b.p]},
        r"condense\[1\] is 'p', which is the unknown or given",
    ),
    "unknown": (lambda b: {"condense": b.u}, r"condense\[0\] is 'u', which is the unknown"),
    "number": (lambda b: {"condense": [7]}, r"condense\[0\] is 7: give a dolfinx.fem.Function"),
    "another-mesh": (
        lambda b: {"condense": function_elsewhere(b)},
        r"condense\[0\] is 'q' on another mesh than the unknown",
    ),
    "too-many": (
        lambda b: {"condense": [other_pressure(b), b.p]},
        "F is a sequence of 2 forms: .* one for each condensed",
    ),
    "not-in-the-energy": (lambda b: {"F": b.energy, "condense": other_pressure(b)}, UNUSED),
    "not-in-the-residuals": (lambda b: {"condense": other_pressure(b)}, UNUSED),
    "not-coupled": (lambda b: {"F": (solid(b)[0] + b.p**2) * ufl.dx}, "K_up is zero"),
}


@each(("wrong", "message"), CONDENSED)
def test_condensed_fields(body, wrong, message):
    """``condense=`` refuses fields that cannot be condensed from F, with the remedy."""
    with raises(TypeError if "is 7" in message else ValueError, message):
        create(body, **wrong(body))


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
    """A coefficient on another mesh is refused, and the message names it."""
    other = cube(2, 3)
    f = dolfinx.fem.Function(dolfinx.fem.functionspace(other, element), name="source")
    name = "F" if nonlinear else "L"
    with raises(ValueError, f"{name} contains the Function 'source' on another mesh.*interpolate"):
        poisson_on(cube(2, 4), f, nonlinear=nonlinear)


@pytest.mark.parametrize("nonlinear", [False, True])
def test_coordinate_of_another_mesh(nonlinear):
    """A SpatialCoordinate of another mesh is refused."""
    x = ufl.SpatialCoordinate(cube(2, 3))
    with raises(ValueError, "coordinate of another mesh|on another mesh"):
        poisson_on(cube(2, 4), x[0], nonlinear=nonlinear)


@pytest.mark.parametrize("wrong", [2.5, 4.0, "4", np.float64(3.0)])
def test_subdomains_that_are_no_whole_number(wrong):
    """``subdomains`` raises a TypeError unless it is an integer."""
    with raises(TypeError, rf"subdomains is .*{wrong}.*: give a whole number"):
        poisson_on(cube(2, 4), subdomains=wrong)


@pytest.mark.parametrize("nonlinear", [False, True])
def test_conditions_on_dofs_that_are_not_there(nonlinear):
    """A condition on a dof beyond those of the space is refused on all processes."""

    def of_another(V):
        """Return a condition on a dof that the space does not have."""
        size = V.dofmap.index_map.size_local + V.dofmap.index_map.num_ghosts
        return [dolfinx.fem.dirichletbc(0.0, np.array([2 * size], dtype=np.int32), V)]

    with raises(ValueError, r"bcs\[0\] prescribes dof .* one number for all components"):
        poisson_on(cube(2, 4), nonlinear=nonlinear, bcs=of_another)
