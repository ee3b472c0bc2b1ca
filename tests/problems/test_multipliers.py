# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Volume multipliers with a small κ give the incompressible solution."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from collective import COMM, agree, equal, raises, small
from mixed import Block, Mixed, block, by_cell, by_place
from problems import owned

import dolfinx
import ufl

from dolfinx_feti import ConvergenceError, NonlinearProblem
from dolfinx_feti.loading import Steps, follow_load
from dolfinx_feti.problems import multipliers
from dolfinx_feti.runtime.anderson import Anderson

ELEMENTS = ["p2-p1d", "q2-p1d", "p2-p0-p0"]
INCOMPRESSIBLE = 1e12
TIGHT = {"snes_rtol": 1e-10, "snes_atol": 1e-14, "ksp_rtol": 1e-10}


def part(n):
    """Return the slice of n entries that this process owns."""
    return slice(n * COMM.rank // COMM.size, n * (COMM.rank + 1) // COMM.size)


def test_three_rates_are_gone_after_four_updates():
    """Anderson's acceleration removes k linear rates in k + 1 updates, as GMRES does."""
    rate = np.array([0.9, 0.7, 0.3, 0.9])[part(4)]
    λ = np.zeros(4)[part(4)]
    anderson = Anderson(COMM, len(λ))
    for _ in range(4):
        λ = anderson.next(λ, 1.0 - λ + rate * (λ - 1.0))
    small(np.abs(λ - 1.0).max(initial=0.0), 1e-10)


def test_n_unknowns_take_one_more_evaluation():
    """Anderson's acceleration solves n linear equations in n + 1 updates, also if divergent."""
    n = 12
    random = np.random.default_rng(1)
    A = random.uniform(-0.8, 0.8, (n, n))
    b = random.uniform(-1.0, 1.0, n)
    agree(np.abs(np.linalg.eigvals(A)).max() > 1.2)
    owned_rows = np.r_[part(n)]
    order = np.r_[owned_rows, np.setdiff1d(np.arange(n), owned_rows)]
    anderson = Anderson(COMM, len(owned_rows))
    U = np.zeros(n)
    for _ in range(n + 1):
        U[order] = anderson.next(U[order], (A @ U + b - U)[order])
    small(np.abs(A @ U + b - U).max(), 1e-8)


def at_rest(comm: MPI.Comm, element: str, kappa: float) -> Block:
    """Create a block at rest, with a dilation if the element has one."""
    body = block(comm, element, kappa, n=2)
    for dilation in body.fields[:-1]:
        dilation.x.array[:] = 1.0
    return body


def problem(body: Block, tolerance: float) -> NonlinearProblem:
    """Create the block's problem with four subdomains."""
    common = {"volume_tolerance": tolerance, "subdomains": 4, "petsc_options": TIGHT}
    return NonlinearProblem(body.energy, body.u, bcs=body.bcs, condense=body.fields, **common)


def swelling(body: Block) -> float:
    """Return the greatest |mean J − 1| of the cells of this process."""
    u = body.u
    mesh = u.function_space.mesh
    q = ufl.TestFunction(dolfinx.fem.functionspace(mesh, ("DG", 0)))
    J = ufl.det(ufl.Identity(len(u)) + ufl.grad(u))
    dx = ufl.dx(mesh, metadata={"quadrature_degree": 4})
    forms = (J - 1) * q * dx, q * dx
    change, volume = (dolfinx.fem.assemble_vector(dolfinx.fem.form(f)).array for f in forms)
    n = mesh.topology.index_map(mesh.topology.dim).size_local
    return float(np.abs(change[:n] / volume[:n]).max(initial=0.0))


@pytest.mark.parametrize("element", ELEMENTS[1:])
def test_the_incompressible_solution(element):
    """With κ ten times the shear modulus, multipliers give the solution of κ = ∞."""
    body = at_rest(COMM, element, 10.0)
    alone = at_rest(MPI.COMM_SELF, element, INCOMPRESSIBLE)
    solved = problem(body, 1e-9)
    solved.solve()
    small(swelling(body), 1e-9)
    agree(2 <= len(solved.volume_changes) <= len(solved.history))
    agree(solved.volume_changes[-1] <= 1e-9 < solved.volume_changes[-2])
    Mixed(alone).solve(tolerance=1e-10)
    equal(by_place(body.u), by_place(alone.u), 1e-7)
    equal(by_cell(body.fields[-1]), by_cell(alone.fields[-1]), 1e-6)


@pytest.mark.parametrize("element", ELEMENTS)
def test_slope_of_the_potential(element):
    """The relaxed residual with multipliers is the derivative of the potential."""
    body = at_rest(COMM, element, 10.0)
    body.deform()
    with_multipliers = problem(body, 1e-6)
    with_multipliers._volume_multipliers.set_to_pressure()
    system = with_multipliers._system
    body.fields[-1].x.array[:] += 0.3
    system.condensation.relax()
    r = system.residual().condensed
    u = owned(body.u).copy()
    w = np.cos(np.arange(len(u)))
    h = 1e-5
    values = []
    for sign in (1.0, -1.0):
        body.u.x.array[: len(u)] = u + sign * h * w
        body.u.x.scatter_forward()
        values.append(system.potential())
    body.u.x.array[: len(u)] = u
    body.u.x.scatter_forward()
    F = dolfinx.fem.assemble_vector(dolfinx.fem.form(body.F_u))
    F.scatter_reverse(dolfinx.la.InsertMode.add)
    equal(r, system.conditions.free(F.array[: len(u)]), 1e-10)
    slope = COMM.allreduce(float(F.array[: len(u)] @ w))
    small((values[0] - values[1]) / (2 * h) / slope - 1.0, 1e-6)


def test_a_state_brings_its_multipliers_along():
    """A restored equilibrium includes its multipliers, whatever was solved in between."""
    body = at_rest(COMM, "p2-p0-p0", 10.0)
    solved = problem(body, 1e-8)
    solved.solve()
    functions = (body.u, *body.fields)
    before = [f.x.array.copy() for f in functions]
    solved.bcs[0].g.x.array[:] = 0.02
    solved.solve()
    solved.bcs[0].g.x.array[:] = 0.0
    for f, values in zip(functions, before, strict=True):
        f.x.array[:] = values
    small(solved.residual_norm(), 1e-7)
    solved.solve()
    agree(len(solved.history) <= 1)
    equal(body.u.x.array, before[0], 1e-7)


def test_load_steps():
    """Each cell keeps its volume at the end of a path with a rejected and a halved step."""
    body = at_rest(COMM, "q2-p1d", 10.0)
    load = dolfinx.fem.Constant(body.u.function_space.mesh, 0.0)
    body = Block(body.u, body.fields, body.energy + load * body.u[2] * ufl.dx, body.bcs)
    solved = problem(body, 1e-6)
    attempts = []

    def set_load(value: float) -> None:
        load.value = value
        attempts.append(value)
        first = attempts.count(0.4) == 1 and value == 0.4
        solved.solver.setTolerances(max_it=1 if first else 30)

    steps = Steps(first=0.2, least=0.05)
    state = [body.u, *body.fields]
    accepted = follow_load(solved, set_load, [0.2, 0.4, 0.6], steps, state=state)
    agree(sum(step.failures for step in accepted) == 1)
    small(swelling(body), 1e-6)
    agree(accepted[-1].load == 0.6)


def test_a_kappa_that_is_too_small(monkeypatch):
    """If the volume does not settle within MAX_UPDATES, the error recommends a larger κ."""
    monkeypatch.setattr(multipliers, "MAX_UPDATES", 2)
    solved = problem(at_rest(COMM, "q2-p1d", 1.0), 1e-12)
    with raises(ConvergenceError, "After 2 updates .* is still off by .*: take a larger κ"):
        solved.solve()
    agree(len(solved.volume_changes) == 2)
    agree(solved.solver.getTolerances()[0] == TIGHT["snes_rtol"])
