# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Newton's method on energies of the user's own: how it converges, and how it says it does not."""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest
from bodies import PREFIX, block, gent, least_ratio, logarithmic, yeoh
from collective import COMM, agree, equal, norm, raises, small
from mixed import by_place
from problems import cube, dirichlet, owned
from walls import tube, wall

import dolfinx
import ufl

from dolfinx_feti import ConvergenceError, NonlinearProblem
from dolfinx_feti.errors import SingularError
from dolfinx_feti.feti import setup

Reason = PETSc.SNES.ConvergedReason


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("force", [(1.0, -0.5), (1.0, -0.5, 0.3)])
def test_energy_of_the_users_own(degree, force):
    """No residual, no tangent, no pressure: an energy is enough, and Newton is quadratic."""
    body = block(yeoh, force, degree=degree)
    start = body.residual()
    problem = body.problem({"snes_rtol": 1e-11})
    problem.solve()
    small(body.residual(), 1e-9 * start)
    agree(COMM.allreduce(np.abs(owned(body.u)).max(initial=0.0)) > 0.1)
    residuals = np.array([step.residual for step in problem.history])
    agree(abs(residuals[0] - start) < 1e-12 * start)
    agree(4 <= len(residuals) <= 8 and problem.history[-1].step_length == 1.0, residuals)
    constants = residuals[2:] / residuals[1:-1] ** 2
    agree(constants.max() < 1e2 and residuals[-1] < 1e-2 * residuals[-2], residuals)


def test_residual_and_tangent_of_the_users_own():
    """A residual, and a tangent that is not its derivative: slower, to the same end."""
    body, other = block(yeoh, (0.2, 0.1)), block(yeoh, (0.2, 0.1))
    quick = body.problem({"snes_rtol": 1e-10})
    quick.solve()
    u, V = other.u, other.u.function_space
    F = ufl.derivative(other.energy, u, ufl.TestFunction(V))
    at_rest = ufl.replace(ufl.derivative(F, u, ufl.TrialFunction(V)), {u: dolfinx.fem.Function(V)})
    slow = NonlinearProblem(
        F,
        u,
        bcs=other.bcs,
        J=at_rest,
        subdomains=4,
        petsc_options_prefix=PREFIX,
        petsc_options={"snes_rtol": 1e-10, "snes_max_it": 100},
    )
    slow.solve()
    equal(owned(u), owned(body.u), 1e-8)
    agree(len(slow.history) > 2 * len(quick.history))


def test_scalar_unknown():
    """A minimal surface: nothing is a displacement here, and no volume ratio is watched."""
    mesh = cube(2, 4)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2))
    u = dolfinx.fem.Function(V)
    area = ufl.sqrt(1 + ufl.inner(ufl.grad(u), ufl.grad(u))) * ufl.dx
    edge = dirichlet(V, lambda x: np.full(x.shape[1], True), lambda x: x[0] ** 2 - x[1] ** 2)
    edge.set(u.x.array)
    problem = NonlinearProblem(
        area, u, bcs=[edge], subdomains=4, petsc_options_prefix=PREFIX, quadrature_degree=6
    )
    problem.solve()
    degree = {"quadrature_degree": 6}
    v = ufl.TestFunction(V)
    slope = ufl.inner(ufl.grad(u), ufl.grad(v)) / ufl.sqrt(1 + ufl.inner(ufl.grad(u), ufl.grad(u)))
    r = dolfinx.fem.assemble_vector(dolfinx.fem.form(slope * ufl.dx(metadata=degree)))
    r.scatter_reverse(dolfinx.la.InsertMode.add)
    edge.set(r.array, None, 0.0)
    small(norm(r.array[: len(owned(u))]), 1e-8)
    agree(len(problem.history) >= 3)


def two_wells() -> tuple[dolfinx.fem.Function, ufl.Form, list[dolfinx.fem.DirichletBC]]:
    """Π = ∫ ε/2 |∇u|² + (u² − 1)²/4: u = 0 obeys Π' = 0 on the ridge between two valleys."""
    mesh = cube(2, 8)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1))
    u = dolfinx.fem.Function(V)
    energy = 0.1 * ufl.inner(ufl.grad(u), ufl.grad(u)) / 2 * ufl.dx + (u**2 - 1) ** 2 / 4 * ufl.dx
    edge = dirichlet(V, lambda x: np.isclose(x[0], 0.0), lambda x: 0.0 * x[0])
    u.interpolate(lambda x: 0.2 * np.sin(np.pi * x[0] / 2) * (1.0 + 0.3 * np.cos(3 * x[1])))
    return u, energy, [edge]


@pytest.mark.parametrize("kind", ["all_floating", "classical"])
def test_way_down_from_a_ridge(kind):
    """Where the tangent is indefinite, a shift leads downhill; the last steps are Newton's own."""
    u, energy, bcs = two_wells()
    problem = NonlinearProblem(
        energy,
        u,
        bcs=bcs,
        subdomains=6,
        petsc_options_prefix=PREFIX,
        petsc_options={"feti_type": kind},
    )
    problem.solve()
    agree(COMM.allreduce(owned(u).max(initial=0.0), op=max) > 0.95)
    agree(COMM.allreduce(owned(u).min(initial=0.0), op=min) > -0.1)
    shifts = [step.shift for step in problem.history]
    agree(max(shifts) > 0.0 and shifts[-1] == 0.0, shifts)
    agree(all((step.solves > 1) <= (step.shift > 0.0) for step in problem.history))
    agree(all(step.linear_residual <= 1e-8 for step in problem.history))


def test_every_step_lowers_the_potential():
    """Beside Armijo no other test has a say once the boundary is in place."""
    u, energy, bcs = two_wells()
    problem = NonlinearProblem(energy, u, bcs=bcs, subdomains=6, petsc_options_prefix=PREFIX)
    form, heights = dolfinx.fem.form(energy), []

    def keep(snes, its, norm):
        heights.append(COMM.allreduce(dolfinx.fem.assemble_scalar(form)))

    problem.solver.setMonitor(keep)
    problem.solve()
    problem.solver.monitorCancel()
    agree(len(heights) == len(problem.history) + 1 > 4, heights)
    rises = np.diff(heights) / np.abs(heights[0])
    agree(rises.max() <= 1e-12 and heights[-1] < heights[0], heights)


def test_singular_on_the_way_counts_as_indefinite(monkeypatch):
    """The first tangent has to be regular; a later one that is singular gets a shift."""
    check, calls, singular = setup._check_coarse, [], []

    def check_coarse(coarse):
        check(coarse)
        calls.append(None)
        if len(calls) in singular:
            raise SingularError("singular")

    monkeypatch.setattr(setup, "_check_coarse", check_coarse)
    u, energy, bcs = two_wells()
    start = u.x.array.copy()
    problem = NonlinearProblem(energy, u, bcs=bcs, subdomains=6, petsc_options_prefix=PREFIX)
    problem.solve()
    agree(problem.history[-1].shift == 0.0)
    u.x.array[:], singular[:] = start, [len(calls)]  # the last tangent of the same way
    calls.clear()
    problem.solve()
    agree(len(calls) > singular[0] and max(s.shift for s in problem.history[-2:]) > 0.0)
    u.x.array[:], singular[:] = start, [1]
    calls.clear()
    with raises(ConvergenceError, "the linear solver: singular"):
        problem.solve()
    agree(problem.solver.getKSP().getPythonContext().singular)


def test_residual_alone_goes_where_newton_leads():
    """Without an energy nobody knows up from down: the ridge is a solution of F = 0."""
    u, energy, bcs = two_wells()
    F = ufl.derivative(energy, u, ufl.TestFunction(u.function_space))
    problem = NonlinearProblem(F, u, bcs=bcs, subdomains=6, petsc_options_prefix=PREFIX)
    problem.solve()
    agree(all(step.shift == 0.0 and step.solves == 1 for step in problem.history))
    small(COMM.allreduce(np.abs(owned(u)).max(initial=0.0), op=max), 0.5)


def test_prescribed_displacements_are_reached():
    """Inhomogeneous conditions need not hold at the start."""
    body = block(yeoh, (0.0, 0.0), degree=2)
    V = body.u.function_space
    pulled = dirichlet(V, lambda x: np.isclose(x[0], 1.0), lambda x: 0.3 + 0.1 * x[1], component=0)
    body.bcs.append(pulled)
    body.problem().solve()
    reached = owned(body.u)
    expected = reached.copy()
    for bc in body.bcs:
        bc.set(expected)
    equal(reached, expected, 1e-10)
    agree(COMM.allreduce(np.abs(reached).max(initial=0.0)) > 0.3)


@pytest.mark.parametrize("watched", [True, False])
@pytest.mark.parametrize("density", [logarithmic, gent])
def test_step_is_shortened_before_the_energy_ends(density, watched):
    """The first whole step would turn cells inside out (J ≤ 0), or overstretch chains (NaN)."""
    force = (-3.0, 0.0) if density is logarithmic else (6.0, 0.0)
    body = block(density, force)
    always = dolfinx.fem.Constant(body.u.function_space.mesh, 1.0)
    problem = body.problem(volume_ratio=None if watched else always)
    problem.solve()
    lengths = [step.step_length for step in problem.history]
    agree(min(lengths) < 1.0 and lengths[-1] == 1.0, lengths)
    agree(least_ratio(body.u) > 0.0)
    small(body.residual(), 1e-7 * abs(force[0]))


def test_load_far_too_big_for_one_step():
    """300 mmHg at once: the wall is there, or an error says how to get there."""
    body = wall(tube(), degree=1)
    problem = body.problem(2, {"snes_max_it": 15})
    try:
        body.inflate(problem, [300.0])
        failed = ""
    except ConvergenceError as error:
        failed = str(error)
        agree("smaller steps" in failed or "feti_" in failed, failed)
    agree(len(set(COMM.allgather(failed == ""))) == 1)
    agree((failed == "") == (problem.solver.getConvergedReason() > 0))
    agree(np.all(np.isfinite(body.u.x.array)) and least_ratio(body.u) > 0.0)
    body.u.x.array[:] = 0.0
    body.p.x.array[:] = 0.0
    body.inflate(problem, [5.0])
    agree(problem.solver.getConvergedReason() > 0)


def test_inexact_newton():
    """Eisenstat and Walker's tolerances save linear iterations and end in the same state."""
    choices = {"snes_ksp_ew": None, "snes_ksp_ew_rtol0": 0.01, "snes_ksp_ew_rtolmax": 0.01}
    states, costs = [], []
    for options in ({}, choices):
        body = wall(tube())
        steps = body.inflate(body.problem(4, {"snes_rtol": 1e-9, **options}), [2.0, 10.0])
        states.append(by_place(body.u))
        costs.append([step.linear_iterations for step in steps])
        loosest = max(step.linear_residual for step in steps)
        agree((loosest <= 1e-8) == (options == {}) and loosest <= 0.01, loosest)
    equal(states[1], states[0], 1e-7)
    agree(sum(costs[1]) <= 0.8 * sum(costs[0]) and len(costs[1]) <= len(costs[0]) + 2, costs)


def test_tolerance_may_refer_to_another_state():
    """A share of the large residual of a bad guess is no equilibrium."""
    body = block(yeoh, (0.3, 0.1))
    problem = body.problem({"snes_rtol": 1e-2})
    reference = body.residual()
    norms = []
    for given in (None, problem.residual_norm(), np.nan):
        body.u.interpolate(lambda x: np.stack([2.0 * x[0], 3.0 * x[0] * x[1]]))
        guess = body.residual()
        problem.solve(reference=given)
        norms.append(body.residual())
        agree(guess > 1e3 * reference and norms[-1] <= 1e-2 * guess, guess)
    agree(min(norms[0], norms[2]) > 1e-2 * reference >= norms[1], norms)
    with raises(ValueError, r"reference is -1.0: give the norm of a residual"):
        problem.solve(reference=-1.0)


def test_inverted_start():
    """J ≤ 0 at the start is found before any work, and u stays as it was."""
    body = block(yeoh, (0.1, 0.0))
    body.u.interpolate(lambda x: np.stack([-1.5 * x[0], 0 * x[1]]))
    before = owned(body.u)
    problem = body.problem()
    with raises(ConvergenceError, "det F is not positive at the start: begin with u = 0"):
        problem.solve()
    equal(owned(body.u), before)
    agree(problem.history == [])
    agree(problem.solver.getConvergedReason() == Reason.DIVERGED_FUNCTION_DOMAIN)


def test_inversion_in_one_point_is_seen():
    """A P2 cell can fold at one quadrature point while its mean volume is positive."""
    body = block(yeoh, (0.1, 0.0), degree=2)
    body.u.interpolate(lambda x: np.stack([-0.15 * np.isclose(x[0], 1.0), 0 * x[0]]))
    agree(least_ratio(body.u) > 0.0)
    with raises(ConvergenceError, "det F"):
        body.problem().solve()


def test_volume_ratio_of_the_users_own():
    """Any expression can be kept positive; here u₀ must stay below 0.01, which is too little."""
    body = block(yeoh, (1.0, 0.0))
    with raises(ConvergenceError, "no admissible step length was found: load in smaller steps"):
        body.problem(volume_ratio=0.01 - body.u[0]).solve()
    agree(0.0 < COMM.allreduce(owned(body.u)[::2].max(initial=0.0), op=MPI.MAX) < 0.015)


def test_load_that_is_no_number():
    body = block(yeoh, (np.nan, 0.0))
    problem = body.problem()
    with raises(ConvergenceError, "NaN or Inf"):
        problem.solve()
    agree(problem.solver.getConvergedReason() == -4)  # of another name in each PETSc
    body.load.value = (0.1, 0.0)
    problem.solve()
    agree(problem.solver.getConvergedReason() > 0)


def test_too_few_steps():
    body = block(yeoh, (0.3, 0.1))
    problem = body.problem({"snes_max_it": 2})
    with raises(ConvergenceError, "no convergence within 2 steps: .*raise snes_max_it"):
        problem.solve()
    agree(len(problem.history) == 2)
    agree(problem.solver.getConvergedReason() == Reason.DIVERGED_MAX_IT)
    agree(abs(body.residual() - problem.solver.getFunctionNorm()) < 1e-12)
    problem.solver.setTolerances(max_it=5)
    problem.solve()  # goes on from where it was
    agree(problem.history[0].residual < 1e-3)


def test_failure_of_the_linear_solver():
    body = block(yeoh, (0.3, 0.1))
    problem = body.problem({"ksp_max_it": 2})
    with raises(ConvergenceError, f"linear solver: no convergence within -{PREFIX}ksp_max_it"):
        problem.solve()
    agree(problem.solver.getConvergedReason() == Reason.DIVERGED_LINEAR_SOLVE)
    equal(owned(body.u), 0.0 * owned(body.u))


def test_tolerances():
    """Relative and absolute tolerance are the SNES's own."""
    runs = []
    for options in ({"snes_rtol": 1e-2}, {"snes_rtol": 1e-9, "snes_atol": 0}, {"snes_atol": 1e-3}):
        body = block(yeoh, (0.3, 0.1))
        problem = body.problem(options)
        problem.solve()
        runs.append((problem.solver.getConvergedReason(), body.residual(), problem.history))
    (r0, e0, h0), (r1, e1, h1), (r2, e2, h2) = runs
    agree(r0 == r1 == Reason.CONVERGED_FNORM_RELATIVE and r2 == Reason.CONVERGED_FNORM_ABS)
    agree(e1 < 1e-9 * h1[0].residual < e0 < 1e-2 * h0[0].residual)
    agree(e2 < 1e-3 < h2[-1].residual)
    agree(len(h0) < len(h1))


def test_monitor_and_history_of_the_snes(tmp_path):
    """PETSc's own monitor writes a line for each residual, and the SNES remembers them."""
    file = tmp_path / "monitor"
    body = block(yeoh, (0.3, 0.1))
    problem = body.problem({"snes_monitor": f"ascii:{file}", "snes_linesearch_type": "basic"})
    problem.solver.setConvergenceHistory()
    problem.solve()
    residuals = [step.residual for step in problem.history]
    remembered, _ = problem.solver.getConvergenceHistory()
    equal(remembered[:-1], residuals)
    problem.solver.destroy()
    COMM.Barrier()
    lines = file.read_text().splitlines()
    agree(len(lines) == len(residuals) + 1, lines)
    agree(
        all(
            f"{r:.6e}" in line or f"{r:.12e}" in line
            for r, line in zip(residuals, lines, strict=False)
        )
    )
