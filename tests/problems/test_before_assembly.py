# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A stress from outside of UFL: a return mapping in NumPy, called before each assembly.

The reference is a Newton loop as a dolfinx script writes it: dolfinx assembles, MUMPS solves, and
the same return mapping updates stress and tangent at the quadrature points.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

import numpy as np
import pytest
from collective import COMM, agree, equal, logged_messages, lu_solve, raises, small
from problems import cube, dirichlet, left, owned, right
from wall_files import ROOT

import basix
import basix.ufl
import dolfinx
import dolfinx.fem.petsc
import ufl

from dolfinx_feti import NonlinearProblem

#: Shear modulus, bulk modulus, yield stress and hardening modulus, in one unit of stress.
SHEAR = 1.0
BULK = 2.0
YIELD = 0.01
HARDENING = 0.5

#: Vertical displacement of the right side in each load step: elastic, plastic, unloading.
LIFTS = (0.003, 0.006, 0.007, 0.0065)

#: Share of the yield stress by which an excess is rounding: a state on the surface is elastic.
ON_THE_SURFACE = 1e-10

#: Deviatoric projection and unit tensor, for (xx, yy, zz, √2 xy).
UNIT = np.array([1.0, 1.0, 1.0, 0.0])
DEVIATOR = np.eye(4) - np.outer(UNIT, UNIT) / 3.0

TIGHT = {"snes_rtol": 1e-10, "ksp_rtol": 1e-12}


def return_mapping(strain, plastic_strain, hardened):
    """Return stress (n, 4) and tangent (n, 4, 4) of von Mises plasticity with linear hardening."""
    elastic = strain - plastic_strain
    s = 2 * SHEAR * elastic @ DEVIATOR
    size = np.sqrt((s**2).sum(axis=1))
    direction = s / np.maximum(size, 1e-300)[:, None]
    excess = size - np.sqrt(2 / 3) * (YIELD + HARDENING * hardened)
    slope = 2 * SHEAR + 2 / 3 * HARDENING
    step = np.maximum(excess, 0.0) / slope
    yields = (excess > ON_THE_SURFACE * YIELD).astype(float)
    stress = s - 2 * SHEAR * step[:, None] * direction
    stress += BULK * (elastic @ UNIT)[:, None] * UNIT
    beta = 2 * SHEAR * step / np.maximum(size, 1e-300)
    outer = direction[:, :, None] * direction[:, None, :]
    tangent = (
        BULK * np.outer(UNIT, UNIT)
        + 2 * SHEAR * (1 - beta)[:, None, None] * DEVIATOR
        - 2 * SHEAR * (yields * 2 * SHEAR / slope - beta)[:, None, None] * outer
    )
    return stress, tangent


@dataclass
class Plate:
    """A plate in plane strain whose stress and tangent are Functions at quadrature points."""

    cells: int = 4
    calls: int = field(default=0, init=False)

    def __post_init__(self):
        mesh = cube(2, self.cells)
        degree = 2
        points, _ = basix.make_quadrature(basix.CellType.triangle, degree)
        dx = ufl.Measure("dx", mesh, metadata={"quadrature_degree": degree})

        def at_points(*shape):
            element = basix.ufl.quadrature_element("triangle", value_shape=shape, degree=degree)
            return dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, element))

        V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (2,)))
        self.u = dolfinx.fem.Function(V, name="u")
        v = ufl.TestFunction(V)
        du = ufl.TrialFunction(V)
        self.stress = at_points(4)
        self.plastic_strain = at_points(4)
        self.tangent = at_points(4, 4)
        self.hardened = at_points()
        self.lift = dolfinx.fem.Constant(mesh, 0.0)
        fixed = dirichlet(V, left)
        facets = dolfinx.mesh.locate_entities_boundary(mesh, 1, right)
        V1 = V.sub(1)
        lifted = dolfinx.fem.dirichletbc(
            self.lift, dolfinx.fem.locate_dofs_topological(V1, 1, facets), V1
        )
        self.bcs = [fixed, lifted]
        self.mesh = mesh
        self.F = ufl.inner(self.stress, strain(v)) * dx
        self.J = ufl.inner(self.tangent * strain(du), strain(v)) * dx
        self.strain = dolfinx.fem.Expression(strain(self.u), points)
        # the elastic strain of a stress is C⁻¹ σ
        trace = self.stress[0] + self.stress[1] + self.stress[2]
        unit = ufl.as_vector(list(UNIT))
        deviator = self.stress - trace / 3 * unit
        flow = strain(self.u) - deviator / (2 * SHEAR) - trace / (9 * BULK) * unit
        change = flow - self.plastic_strain
        size = ufl.sqrt(2 / 3 * ufl.inner(change, change))
        self.memory = {self.plastic_strain: flow, self.hardened: self.hardened + size}
        self.update(self.u)

    def update(self, u):
        """Update stress and tangent from the present displacement."""
        assert u is self.u
        self.calls += 1
        topology = self.mesh.topology.index_map(2)
        cells = np.arange(topology.size_local + topology.num_ghosts, dtype=np.int32)
        found = self.strain.eval(self.mesh, cells).reshape(-1, 4)
        past = self.plastic_strain.x.array.reshape(-1, 4)
        stress, tangent = return_mapping(found, past, self.hardened.x.array)
        self.stress.x.array[:] = stress.ravel()
        self.tangent.x.array[:] = tangent.ravel()

    def problem(self, **changes):
        """Return the problem of the plate."""
        arguments = {
            "J": self.J,
            "bcs": self.bcs,
            "before_assembly": self.update,
            "internal_variables": self.memory,
            "subdomains": 4,
            "petsc_options": TIGHT,
        }
        return NonlinearProblem(self.F, self.u, **(arguments | changes))


def strain(w):
    """Return the strain (xx, yy, zz, √2 xy) in the plane."""
    e = ufl.sym(ufl.grad(w))
    return ufl.as_vector([e[0, 0], e[1, 1], 0.0 * e[0, 0], np.sqrt(2) * e[0, 1]])


def newton_steps(plate):
    """Return ‖r‖ of the free dofs at each state of a Newton loop with dolfinx and MUMPS.

    It ends where ‖r‖ is 1e-9 of the reactions.
    """
    F = dolfinx.fem.form(plate.F)
    J = dolfinx.fem.form(plate.J)
    n = len(owned(plate.u))
    norms = []
    while True:
        plate.update(plate.u)
        r = dolfinx.fem.assemble_vector(F)
        r.scatter_reverse(dolfinx.la.InsertMode.add)
        b = r.array[:n]
        free = np.ones(n)
        gap = np.zeros(n)
        for bc in plate.bcs:
            bc.set(free, None, 0.0)
            bc.set(gap, plate.u.x.array, 1.0)
        norms.append(np.sqrt(COMM.allreduce(float((free * b) @ (free * b)))))
        reaction = np.sqrt(COMM.allreduce(float(b @ b)))
        if len(norms) > 1 and norms[-1] <= 1e-9 * reaction:
            return norms
        agree(len(norms) < 12, norms)
        A = dolfinx.fem.petsc.assemble_matrix(J)
        A.assemble()
        lifting = A.createVecRight()
        lifting.array[:] = gap
        rhs = A.createVecLeft()
        A.mult(lifting, rhs)  # the columns of the gap move to the right-hand side
        rhs.array[:] = np.where(free == 0.0, gap, -b - rhs.array_r)
        held = np.flatnonzero(free == 0.0) + A.getOwnershipRange()[0]
        A.zeroRowsColumns(held.astype(np.int32), 1.0)
        plate.u.x.array[:n] += lu_solve(A, rhs)
        plate.u.x.scatter_forward()
        for each in (A, lifting, rhs):
            each.destroy()


def test_return_mapping_in_numpy():
    """A return mapping in NumPy has the residuals of a Newton loop with dolfinx and MUMPS."""
    ours = Plate()
    theirs = Plate()
    problem = ours.problem()
    reference = theirs.problem()
    yielded = []
    for lift in LIFTS:
        ours.lift.value = theirs.lift.value = lift
        problem.solve()
        expected = newton_steps(theirs)
        found = [step.residual for step in problem.history]
        several = min(len(found), len(expected))
        agree(abs(len(found) + 1 - len(expected)) <= 1, (found, expected))
        agree(all(step.step_length == 1.0 for step in problem.history), problem.history)
        pairs = zip(found[:several], expected[:several], strict=True)
        missed = max(abs(one - other) for one, other in pairs)
        small(missed, 1e-6 * max(expected) + 1e-13 * YIELD)  # or rounding alone is compared
        equal(owned(ours.u), owned(theirs.u), 1e-8)
        problem.update_internal_variables()
        reference.update_internal_variables()
        yielded.append(COMM.allreduce(float(np.abs(ours.hardened.x.array).sum())))
    agree(yielded[0] < 1e-12 < yielded[1] < yielded[2] == pytest.approx(yielded[3]), yielded)
    equal(ours.plastic_strain.x.array, theirs.plastic_strain.x.array, 1e-6)


def test_each_state_is_announced():
    """Before each assembly the function is called with the state, also in the line search."""
    plate = Plate(cells=2)
    seen = []

    def update(u):
        plate.update(u)
        seen.append(owned(u))

    problem = plate.problem(before_assembly=update)
    plate.lift.value = LIFTS[1]
    problem.solve()
    agree(len(seen) >= len(problem.history) + 1)
    equal(seen[-1], owned(plate.u))
    agree(problem.residual_norm() == pytest.approx(problem.b.norm(), abs=1e-12))
    before = len(seen)
    problem.linear_system()[1].destroy()
    agree(len(seen) == before + 1)  # the residual and the tangent are of one state


@pytest.mark.parametrize("everywhere", [True, False], ids=["all-ranks", "one-rank"])
def test_error_in_the_function(everywhere):
    """An error in ``before_assembly`` on one process is raised on all of them."""
    plate = Plate(cells=2)
    plate.lift.value = LIFTS[0]
    for first in (0, 1):
        plate.u.x.array[:] = 0.0
        count = 0

        def update(u, first=first):
            nonlocal count
            count += 1
            if count > first and (everywhere or COMM.rank == COMM.size - 1):
                raise ArithmeticError("the law has no solution")
            plate.update(u)

        problem = plate.problem(before_assembly=update)
        with raises(ArithmeticError, "the law has no solution"):
            problem.solve()
    with raises(ValueError, "before_assembly is 3: give a function of u"):
        plate.problem(before_assembly=3)


def test_unknown_is_not_in_the_residual(caplog):
    """F without u needs J; with J a warning recommends ``before_assembly=``."""
    plate = Plate(cells=2)
    for _ in range(2):
        plate.problem(before_assembly=None)
    warnings = logged_messages(caplog)
    agree(
        len(warnings) == 2 and all("pass before_assembly=update" in text for text in warnings),
        warnings,
    )
    with raises(ValueError, "'u' does not occur in F: .* by J=, and .* by before_assembly="):
        plate.problem(J=None)


def test_energy_with_coefficients_that_change():
    """Kačanov's iteration converges although its coefficient, and thus the energy, follows u."""
    mesh = cube(2, 6)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1))
    u = dolfinx.fem.Function(V)
    v = ufl.TestFunction(V)
    k = dolfinx.fem.Function(V)
    k.x.array[:] = 1.0
    bcs = [dirichlet(V, left)]
    dx = ufl.Measure("dx", mesh, metadata={"quadrature_degree": 4})

    def conduct(w):
        k.x.array[:] = 1.0 + 0.1 * w.x.array**2

    energy = (0.5 * k * ufl.inner(ufl.grad(u), ufl.grad(u)) - 2.0 * u) * dx
    common = {"bcs": bcs, "subdomains": 4, "petsc_options": {"snes_rtol": 1e-9}}
    problem = NonlinearProblem(energy, u, before_assembly=conduct, **common)
    problem.solve()
    w = dolfinx.fem.Function(V)
    kw = dolfinx.fem.Function(V)
    F = ufl.inner(kw * ufl.grad(w), ufl.grad(v)) * dx - 2.0 * v * dx
    small(problem.residual_norm(), 1e-8)
    w.x.array[:] = u.x.array
    kw.x.array[:] = 1.0 + 0.1 * u.x.array**2
    r = dolfinx.fem.assemble_vector(dolfinx.fem.form(F))
    r.scatter_reverse(dolfinx.la.InsertMode.add)
    bcs[0].set(r.array, None, 0.0)
    small(np.abs(r.array[: len(owned(u))]).max(initial=0.0), 1e-8)


def test_the_page_solves_what_it_says(page_program):
    """The program of docs/external_laws.md has the solution of the same law written in UFL."""
    names = page_program
    u = names["u"]
    w = dolfinx.fem.Function(names["V"])
    e = names["strain"](w)
    v = ufl.TestFunction(names["V"])
    F = ufl.inner((1 + 50 * ufl.inner(e, e)) * e, names["strain"](v)) * names["dx"]
    F -= 0.1 * v[1] * names["dx"]
    NonlinearProblem(F, w, bcs=[names["bc"]], subdomains=4).solve()
    equal(owned(u), owned(w), 1e-6)


@pytest.fixture
def page_program():
    """Return the names that the program of docs/external_laws.md defines, on a coarse mesh."""
    text = (ROOT / "docs/external_laws.md").read_text(encoding="utf-8")
    (source,) = re.findall(r"^```python\n(.*?)^```", text, re.M | re.S)
    names = {}
    exec(source.replace("8, 8", "3, 3"), names)
    return names
