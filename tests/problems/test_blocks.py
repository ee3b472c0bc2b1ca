# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Problems in blocks, as dolfinx has them since 0.10, have MUMPS' solution on the mixed space."""

from __future__ import annotations

import itertools
import logging
import re
from dataclasses import dataclass

import numpy as np
import pytest
from collective import COMM, agree, equal, logged_messages, lu_solve, raises, small
from problems import cube, dirichlet, left, owned
from wall_files import ROOT

import basix.ufl
import dolfinx
import dolfinx.fem.petsc
import ufl

from dolfinx_feti import LinearProblem, NonlinearProblem

#: Shear modulus, and the modulus of a nearly incompressible body.
MU = 3.0
KAPPA = 600.0

TIGHT = {"snes_rtol": 1e-10, "ksp_rtol": 1e-11}
DX = {"quadrature_degree": 4}


def neo_hooke(u, p, v, q, *, kappa=None, scale=1.0):
    """Return the residuals of a panel in plane strain with a pressure; without κ incompressible."""
    dx = ufl.Measure("dx", metadata=DX)
    F = ufl.Identity(2) + ufl.grad(u)
    J = ufl.det(F)
    B = ufl.inv(F).T
    P = MU * (F - B) + p * J * B
    constraint = J - 1 if kappa is None else J - 1 - p / kappa
    return ufl.inner(P, ufl.grad(v)) * dx - 0.25 * v[1] * dx, scale * constraint * q * dx


def elastic(u, p, v, q, *, kappa=None, scale=1.0):
    """Return the two rows of the bilinear form of linear elasticity with a pressure."""
    dx = ufl.Measure("dx", metadata=DX)
    constraint = ufl.div(u) if kappa is None else ufl.div(u) - p / kappa
    shear = 2 * MU * ufl.inner(ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v)))
    return (shear + p * ufl.div(v)) * dx, scale * constraint * q * dx


@dataclass
class Panel:
    """A panel of P2–P0 triangles that is clamped on the left."""

    def __post_init__(self):
        self.mesh = cube(2, 4)
        P2 = basix.ufl.element("Lagrange", "triangle", 2, shape=(2,))
        P0 = basix.ufl.element("DG", "triangle", 0)
        self.V = dolfinx.fem.functionspace(self.mesh, P2)
        self.Q = dolfinx.fem.functionspace(self.mesh, P0)
        self.W = dolfinx.fem.functionspace(self.mesh, basix.ufl.mixed_element([P2, P0]))
        self.bcs = [dirichlet(self.V, left)]

    def functions(self):
        """Return new unknowns."""
        u = dolfinx.fem.Function(self.V, name="u")
        p = dolfinx.fem.Function(self.Q, name="p")
        return u, p

    def reference(self, rows, L=None):
        """Solve on the mixed space by Newton's method with MUMPS; return u and p, owned values.

        ``rows`` maps (u, p, v, q) to two forms, residuals or with L the rows of a bilinear form.
        """
        w = dolfinx.fem.Function(self.W)
        v, q = ufl.TestFunctions(self.W)
        F = sum(rows(*ufl.split(w), v, q))
        if L is not None:
            F = F - L(v, q)
        J = dolfinx.fem.form(ufl.derivative(F, w, ufl.TrialFunction(self.W)))
        F = dolfinx.fem.form(F)
        W0, _ = self.W.sub(0).collapse()
        facets = dolfinx.mesh.locate_entities_boundary(self.mesh, 1, left)
        dofs = dolfinx.fem.locate_dofs_topological((self.W.sub(0), W0), 1, facets)
        bc = dolfinx.fem.dirichletbc(dolfinx.fem.Function(W0), dofs, self.W.sub(0))
        n = self.W.dofmap.index_map.size_local
        for _ in range(15):
            A = dolfinx.fem.petsc.assemble_matrix(J, bcs=[bc])
            A.assemble()
            r = dolfinx.fem.assemble_vector(F)
            r.scatter_reverse(dolfinx.la.InsertMode.add)
            bc.set(r.array, w.x.array, -1.0)
            b = A.createVecLeft()
            b.array[:] = r.array[:n]
            step = lu_solve(A, b)
            w.x.array[:n] -= step
            w.x.scatter_forward()
            A.destroy()
            b.destroy()
            if COMM.allreduce(float(step @ step)) < 1e-26:
                break
        u, p = self.functions()
        u.interpolate(w.sub(0).collapse())
        p.interpolate(w.sub(1).collapse())
        return owned(u), owned(p)


@pytest.fixture(scope="module")
def panel():
    return Panel()


def tangent(forms, functions, trials):
    """Return the blocks of the tangent, the derivatives of residuals."""
    return [
        [ufl.derivative(F, f, d) for f, d in zip(functions, trials, strict=True)] for F in forms
    ]


@pytest.fixture(scope="module")
def nearly(panel):
    """Reference solution of the nearly incompressible panel."""
    return panel.reference(lambda *args: neo_hooke(*args, kappa=KAPPA))


@pytest.fixture(scope="module")
def exactly(panel):
    """Reference solution of the incompressible panel."""
    return panel.reference(neo_hooke)


@pytest.mark.parametrize("with_J", [False, True], ids=["derived", "J"])
@pytest.mark.parametrize("order", ["up", "pu", "parts"])
def test_order_of_blocks_does_not_change_the_solution(panel, nearly, order, with_J):
    """The order of the blocks, and blocks of J, do not change the solution."""
    u, p = panel.functions()
    if order == "parts":
        W = ufl.MixedFunctionSpace(panel.V, panel.Q)
        (v, q) = ufl.TestFunctions(W)
        trials = ufl.TrialFunctions(W)
        F = ufl.extract_blocks(sum(neo_hooke(u, p, v, q, kappa=KAPPA)))
        functions = [u, p]
    else:
        v = ufl.TestFunction(panel.V)
        q = ufl.TestFunction(panel.Q)
        trials = ufl.TrialFunction(panel.V), ufl.TrialFunction(panel.Q)
        F = list(neo_hooke(u, p, v, q, kappa=KAPPA))
        functions = [u, p]
        if order == "pu":
            F = F[::-1]
            functions = functions[::-1]
            trials = trials[::-1]
    J = tangent(F, functions, trials) if with_J else None
    problem = NonlinearProblem(
        F, functions, bcs=panel.bcs, J=J, subdomains=4, petsc_options=TIGHT, kind="nest"
    )
    found = problem.solve()
    agree(isinstance(found, list) and all(a is b for a, b in zip(found, functions, strict=True)))
    agree(problem.u is found and problem.unknown is u)
    equal(owned(u), nearly[0], 1e-8)
    equal(owned(p), nearly[1], 1e-7)
    steps = [step.residual for step in problem.history]
    agree(len(steps) <= 8, steps)


@pytest.mark.parametrize("scale", [1.0, -2.5e3], ids=["plain", "scaled"])
def test_missing_pressure_block_makes_p_a_multiplier(panel, exactly, caplog, scale):
    """Without a p–p block p becomes a multiplier, whatever the scale of its equation."""
    u, p = panel.functions()
    v = ufl.TestFunction(panel.V)
    q = ufl.TestFunction(panel.Q)
    F = list(neo_hooke(u, p, v, q, scale=scale))
    trials = ufl.TrialFunction(panel.V), ufl.TrialFunction(panel.Q)
    J = tangent(F, (u, p), trials)
    J[1][1] = None
    problem = NonlinearProblem(F, [u, p], bcs=panel.bcs, J=J, subdomains=4, petsc_options=TIGHT)
    problem.solve()
    equal(owned(u), exactly[0], 1e-7)
    equal(owned(p), exactly[1], 1e-6)
    agree(len(problem.volume_changes) <= 12, problem.volume_changes)
    small(problem.volume_changes[-1], 1e-8)
    warnings = logged_messages(caplog)
    agree(
        len(warnings) == 1 and "'p' has no term in it" in warnings[0] and "kappa=" in warnings[0],
        warnings,
    )


def test_kappa_gives_incompressible_forms_the_solution_of_that_penalty(panel, caplog):
    """With ``kappa=`` the incompressible forms have the solution of that κ, without a warning."""
    kappa = 50.0
    expected = panel.reference(lambda *args: neo_hooke(*args, kappa=kappa))
    for scale in (1.0, -10.0):
        u, p = panel.functions()
        v = ufl.TestFunction(panel.V)
        q = ufl.TestFunction(panel.Q)
        F = list(neo_hooke(u, p, v, q, scale=scale))
        common = {"bcs": panel.bcs, "subdomains": 4, "petsc_options": TIGHT}
        NonlinearProblem(F, [u, p], kappa=kappa, **common).solve()
        equal(owned(u), expected[0], 1e-7)
        equal(owned(p), expected[1], 1e-6)
    warnings = [record for record in caplog.records if record.levelno >= logging.WARNING]
    agree(not COMM.bcast(warnings))


def test_energy_of_an_incompressible_body(panel, exactly):
    """An energy Π(u, p) has the incompressible solution, with [u, p] or ``condense=p``."""
    for as_list, order in itertools.product((True, False), (1, -1)):
        u, p = panel.functions()
        F = ufl.Identity(2) + ufl.grad(u)
        J = ufl.det(F)
        psi = MU / 2 * (ufl.inner(F, F) - 2 - 2 * ufl.ln(J)) + p * (J - 1) - 0.25 * u[1]
        energy = psi * ufl.Measure("dx", metadata=DX)
        common = {"bcs": panel.bcs, "subdomains": 4, "petsc_options": TIGHT}
        if as_list:
            NonlinearProblem(energy, [u, p][::order], **common).solve()
        elif order == 1:
            NonlinearProblem(energy, u, condense=p, volume_tolerance=1e-9, **common).solve()
        else:
            continue
        equal(owned(u), exactly[0], 1e-7)
        equal(owned(p), exactly[1], 1e-6)


def linear_blocks(panel, order, *, kappa=None, scale=1.0, g=0.0):
    """Return a, L in blocks or on a MixedFunctionSpace."""
    W = ufl.MixedFunctionSpace(panel.V, panel.Q)
    if order == "parts":
        (u, p) = ufl.TrialFunctions(W)
        (v, q) = ufl.TestFunctions(W)
    else:
        u = ufl.TrialFunction(panel.V)
        p = ufl.TrialFunction(panel.Q)
        v = ufl.TestFunction(panel.V)
        q = ufl.TestFunction(panel.Q)
    above, below = elastic(u, p, v, q, kappa=kappa, scale=scale)
    L = [-0.25 * v[1] * ufl.dx, scale * g * q * ufl.dx(panel.mesh)]
    if order == "parts":
        return above + below, sum(L[1:], L[0])
    dx = ufl.Measure("dx", metadata=DX)
    shear = 2 * MU * ufl.inner(ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))) * dx
    corner = None if kappa is None else -scale * p / kappa * q * dx
    a = [[shear, p * ufl.div(v) * dx], [scale * ufl.div(u) * q * dx, corner]]
    if order == "up":
        return a, L
    return [row[::-1] for row in a[::-1]], L[::-1]


@pytest.mark.parametrize("order", ["up", "pu", "parts"])
@pytest.mark.parametrize("kappa", [KAPPA, None], ids=["nearly", "exactly"])
@pytest.mark.parametrize("scale", [1.0, -20.0], ids=["plain", "scaled"])
def test_linear_blocks(panel, order, kappa, scale):
    """Linear problems in blocks have the mixed solution, also with a source in the constraint."""
    g = 0.01
    a, L = linear_blocks(panel, order, kappa=kappa, scale=scale, g=g)
    problem = LinearProblem(a, L, bcs=panel.bcs, subdomains=4, petsc_options=TIGHT)
    for _ in range(2):  # a second solve begins anew
        found = problem.solve()
    agree(isinstance(found, list) and len(found) == 2 and problem.u is found)
    u, p = found[::-1] if order == "pu" else found

    def load(v, q):
        return -0.25 * v[1] * ufl.dx + g * q * ufl.dx

    expected = panel.reference(lambda *args: elastic(*args, kappa=kappa), load)
    equal(owned(u), expected[0], 1e-6)
    equal(owned(p), expected[1], 1e-5)


def test_load_in_the_constraint_alone(panel):
    """``None`` as the load of u is zero, so that div u = g alone moves the body."""
    a, (_, of_p) = linear_blocks(panel, "up", kappa=KAPPA, g=0.01)
    common = {"bcs": panel.bcs, "subdomains": 4, "petsc_options": TIGHT}
    zero = ufl.inner(dolfinx.fem.Constant(panel.mesh, (0.0, 0.0)), ufl.TestFunction(panel.V))
    expected = LinearProblem(a, [zero * ufl.dx, of_p], **common).solve()
    solution = LinearProblem(a, [None, of_p], **common).solve()
    agree(np.abs(owned(solution[0])).max(initial=0.0) > 1e-4)
    for w, reference in zip(solution, expected, strict=True):
        equal(owned(w), owned(reference), 1e-10)


@pytest.mark.parametrize("place", ["load", "corner"])
def test_zero_forms(panel, place):
    """A block ``ufl.ZeroBaseForm`` is zero, as None is."""
    a, L = linear_blocks(panel, "up", kappa=KAPPA if place == "load" else None)
    (_, p), (q, _) = (form.arguments() for form in (a[0][1], a[1][0]))
    if place == "load":
        with_none = (a, [L[0], None])
        with_zero = (a, [L[0], ufl.ZeroBaseForm((q,))])
    else:
        corner = ufl.ZeroBaseForm((q, p))
        with_none = (a, L)
        with_zero = ([a[0], [a[1][0], corner]], L)
    common = {"bcs": panel.bcs, "subdomains": 4, "petsc_options": TIGHT}
    expected = LinearProblem(*with_none, **common).solve()
    solution = LinearProblem(*with_zero, **common).solve()
    for w, reference in zip(solution, expected, strict=True):
        equal(owned(w), owned(reference), 1e-10)


def test_given_functions(panel):
    """Solutions are written to the Functions passed as u, also in lists of one."""
    a, L = linear_blocks(panel, "up", kappa=KAPPA)
    u, p = panel.functions()
    solution = LinearProblem(a, L, u=[u, p], bcs=panel.bcs, subdomains=4).solve()
    agree(solution[0] is u and solution[1] is p)
    alone = LinearProblem([[a[0][0]]], [L[0]], bcs=panel.bcs, subdomains=4)
    (single,) = alone.solve()
    w = dolfinx.fem.Function(panel.V)
    same = LinearProblem([[a[0][0]]], [L[0]], u=[w], bcs=panel.bcs, subdomains=4).solve()
    agree(same[0] is w)
    equal(owned(w), owned(single), 1e-8)
    u.x.array[:] = 0.0
    F = ufl.action(a[0][0], u) - L[0]
    J = [[a[0][0]]]
    problem = NonlinearProblem([F], [u], J=J, bcs=panel.bcs, subdomains=4)
    agree(problem.solve()[0] is u and isinstance(problem.u, list))
    equal(owned(u), owned(w), 1e-7)


def test_blocks_of_the_tangent_are_used(panel, nearly):
    """The blocks of J that the user passes are used: a wrong one costs Newton steps."""
    u, p = panel.functions()
    v = ufl.TestFunction(panel.V)
    q = ufl.TestFunction(panel.Q)
    F = list(neo_hooke(u, p, v, q, kappa=KAPPA))
    J = tangent(F, (u, p), (ufl.TrialFunction(panel.V), ufl.TrialFunction(panel.Q)))
    common = {"bcs": panel.bcs, "subdomains": 4, "petsc_options": TIGHT}
    J[0][1] = 1.3 * J[0][1]
    problem = NonlinearProblem(F, [u, p], J=J, **common)
    problem.solve()
    equal(owned(u), nearly[0], 1e-7)
    agree(len(problem.history) > 8)
    with raises(ValueError, r"J is no 2 × 2 block: .*'u', 'p'.* leave J out"):
        NonlinearProblem(F, [u, p], J=[[J[0][0]]], **common)
    with raises(ValueError, r"J\[0\]\[1\] has test and trial functions on other spaces than 'u'"):
        NonlinearProblem(F, [u, p], J=[[J[0][0], J[0][0]], [None, J[1][1]]], **common)


def stress_and_strain(panel, *, flexible):
    """Return the energy of the Hellinger–Reissner principle, u, and the stress tensor.

    Linear stresses contain those of quadratic displacements, so that u is that of the displacement
    method. A flexible body has stresses that stiffen it.
    """
    dx = ufl.Measure("dx", metadata=DX)
    u, _ = panel.functions()
    tensors = basix.ufl.element("DG", "triangle", 1, shape=(2, 2), symmetry=True)
    stress = dolfinx.fem.Function(dolfinx.fem.functionspace(panel.mesh, tensors), name="stress")
    strain = ufl.sym(ufl.grad(u))
    energy = (ufl.inner(stress, strain) - ufl.inner(stress, stress) / (4 * MU)) * dx
    energy -= 0.25 * u[1] * dx
    if flexible:
        energy += MU * ufl.inner(u, u) ** 2 * dx
    return energy, u, stress


@pytest.mark.parametrize("way", ["energy", "blocks", "condense"])
def test_condensed_tensor(panel, way):
    """Condensed stresses of the two-field principle give the displacements of the one-field one."""
    energy, u, stress = stress_and_strain(panel, flexible=True)
    common = {"bcs": panel.bcs, "subdomains": 4, "petsc_options": TIGHT}
    unknowns = (u, stress)
    F = [ufl.derivative(energy, w, ufl.TestFunction(w.function_space)) for w in unknowns]
    if way == "energy":
        NonlinearProblem(energy, u, condense=stress, **common).solve()
    elif way == "condense":
        NonlinearProblem(F, u, condense=[stress], **common).solve()
    else:
        trials = [ufl.TrialFunction(w.function_space) for w in unknowns]
        J = tangent(F, unknowns, trials)
        NonlinearProblem(F, [u, stress], J=J, **common).solve()
    w = dolfinx.fem.Function(panel.V)
    dx = ufl.Measure("dx", metadata=DX)
    strain = ufl.sym(ufl.grad(w))
    alone = MU * ufl.inner(strain, strain) * dx - 0.25 * w[1] * dx
    alone += MU * ufl.inner(w, w) ** 2 * dx
    NonlinearProblem(alone, w, **common).solve()
    equal(owned(u), owned(w), 1e-8)
    expected = dolfinx.fem.Function(stress.function_space)
    points = expected.function_space.element.interpolation_points
    points = points() if callable(points) else points  # dolfinx 0.9
    expected.interpolate(dolfinx.fem.Expression(2 * MU * strain, points))
    equal(owned(stress), owned(expected), 1e-7)


def test_condensed_tensor_of_a_linear_problem(panel):
    """A linear problem with condensed stresses needs a block of u, such as a foundation."""
    energy, u, stress = stress_and_strain(panel, flexible=False)
    unknowns = (u, stress)
    tests = [ufl.TestFunction(w.function_space) for w in unknowns]
    trials = [ufl.TrialFunction(w.function_space) for w in unknowns]
    F = [ufl.derivative(energy, w, v) for w, v in zip(unknowns, tests, strict=True)]
    a = tangent(F, unknowns, trials)
    L = [0.25 * tests[0][1] * ufl.dx, None]
    common = {"bcs": panel.bcs, "subdomains": 4, "petsc_options": TIGHT}
    with raises(ValueError, "a has no block of u, a.0..0.: .* cannot be torn"):
        LinearProblem(a, L, **common)
    foundation = 0.1 * MU * ufl.inner(trials[0], tests[0]) * ufl.dx
    a[0][0] = foundation
    displacement, _ = LinearProblem(a, L, **common).solve()
    strain = ufl.sym(ufl.grad(trials[0]))
    alone = 2 * MU * ufl.inner(strain, ufl.sym(ufl.grad(tests[0]))) * ufl.dx + foundation
    expected = LinearProblem(alone, L[0], **common).solve()
    equal(owned(displacement), owned(expected), 1e-8)


def test_condensed_tensors_are_no_pressures(panel):
    """A condensed tensor cannot be a volume multiplier, nor may its block be zero."""
    energy, u, stress = stress_and_strain(panel, flexible=True)
    with raises(ValueError, "A volume tolerance turns condensed pressures into multipliers, but"):
        NonlinearProblem(energy, u, condense=stress, volume_tolerance=1e-6, bcs=panel.bcs)
    constraint = ufl.inner(stress, ufl.sym(ufl.grad(u))) * ufl.dx + ufl.inner(u, u) * ufl.dx
    with raises(ValueError, "K_pp of 'stress' is zero"):
        NonlinearProblem(constraint, u, condense=stress, bcs=panel.bcs)


def test_what_is_refused(panel):
    """Conditions on a condensed field, residuals in another order and an unused κ are refused."""
    u, p = panel.functions()
    v = ufl.TestFunction(panel.V)
    q = ufl.TestFunction(panel.Q)
    F = list(neo_hooke(u, p, v, q, kappa=KAPPA))
    on_p = dolfinx.fem.dirichletbc(0.0, np.arange(1, dtype=np.int32), panel.Q)
    common = {"bcs": panel.bcs, "subdomains": 4}
    with raises(ValueError, r"bcs\[1\] prescribes 'p', which is condensed"):
        NonlinearProblem(F, [u, p], bcs=[*panel.bcs, on_p], subdomains=4)
    with raises(ValueError, "residual of 'u' is tested in another space: .* order"):
        NonlinearProblem(F[::-1], [u, p], **common)
    with raises(ValueError, "F has 2 residuals for 3 unknowns"):
        NonlinearProblem(F, [u, p, dolfinx.fem.Function(panel.Q)], **common)
    with raises(ValueError, "u holds a Function twice"):
        NonlinearProblem(F, [u, u], **common)
    with raises(ValueError, "kappa is 3.0, but no condensed field is without a term"):
        NonlinearProblem(F, [u, p], kappa=3.0, **common)
    with raises(ValueError, "kappa is -1: give a positive modulus"):
        NonlinearProblem(F, [u, p], kappa=-1, **common)
    a, L = linear_blocks(panel, "up", kappa=KAPPA)
    with raises(ValueError, "There are 2 unknowns: give a as 2 × 2 blocks"):
        LinearProblem([a[0]], L, u=[u, p], **common)
    with raises(ValueError, "volume_tolerance is 0.1, but no condensed field"):
        LinearProblem(a, L, volume_tolerance=0.1, **common)


def test_the_page_solves_what_it_says():
    """The body of docs/blocks.md keeps its volume."""
    text = (ROOT / "docs/blocks.md").read_text(encoding="utf-8")
    (source,) = re.findall(r"^```python\n(.*?)^```", text, re.M | re.S)
    names = {}
    exec(source.replace("8, 8", "4, 4"), names)
    form = dolfinx.fem.form((names["J"] - 1) * names["dx"])
    small(COMM.allreduce(dolfinx.fem.assemble_scalar(form)), 1e-8)
    agree(COMM.allreduce(np.abs(names["u"].x.array).max(initial=0.0), op=max) > 1e-2)
