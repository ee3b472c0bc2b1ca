# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""If Newton's method fails, its message states where, why and what helps.

What fails on the last process alone fails on all.
"""

from __future__ import annotations

import gc

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest
from bodies import PREFIX, block, least_ratio, yeoh
from cases import every_formulation
from collective import COMM, agree, equal, raises, small
from problems import cube, owned, poisson, torn
from walls import tube, wall

import dolfinx
import ufl

from dolfinx_feti import ConvergenceError, NonlinearProblem
from dolfinx_feti.fem import assembly
from dolfinx_feti.fem.condensation.condensation import Condensation
from dolfinx_feti.problems.equations.deformation_gradient import DeformationGradient

Reason = PETSc.SNES.ConvergedReason


def test_load_far_too_big_for_one_step():
    """A load of 300 mmHg in one step converges or names a remedy, and later solves work."""
    body = wall(tube(), degree=1)
    problem = body.problem(2, {"snes_max_it": 15})
    failed = ""
    try:
        body.inflate(problem, [300.0])
    except ConvergenceError as error:
        failed = str(error)
    agree(not failed or "smaller steps" in failed or "feti_" in failed, failed)
    agree(COMM.bcast(failed == "") == (failed == "") == (problem.solver.getConvergedReason() > 0))
    agree(np.all(np.isfinite(body.u.x.array)) and least_ratio(body.u) > 0.0)
    body.u.x.array[:] = body.p.x.array[:] = 0.0
    body.inflate(problem, [5.0])
    agree(problem.solver.getConvergedReason() > 0)


@pytest.mark.parametrize("degree", [1, 2])
def test_inverted_start(degree):
    """A start with det F ≤ 0 at any point is refused before any step, and u is unchanged."""
    body = block(yeoh, (0.1, 0.0), degree=degree)

    def inverting(x):
        u_x = -1.5 * x[0] if degree == 1 else np.where(np.isclose(x[0], 1.0), -0.15, 0.0)
        return np.stack([u_x, 0 * x[1]])

    body.u.interpolate(inverting)
    agree((least_ratio(body.u) > 0.0) == (degree == 2))
    before = owned(body.u)
    problem = body.problem()
    with raises(ConvergenceError, "det F is not positive at the start: begin with u = 0"):
        problem.solve()
    equal(owned(body.u), before)
    agree(problem.history == [])
    agree(problem.solver.getConvergedReason() == Reason.DIVERGED_FUNCTION_DOMAIN)


def test_volume_ratio_of_the_users_own():
    """An expression passed as ``volume_ratio=`` is kept positive, here u₀ < 0.01."""
    body = block(yeoh, (1.0, 0.0))
    with raises(ConvergenceError, "no admissible step length was found: load in smaller steps"):
        body.problem(volume_ratio=0.01 - body.u[0]).solve()
    agree(0.0 < COMM.allreduce(owned(body.u)[::2].max(initial=0.0), op=MPI.MAX) < 0.015)


def test_load_that_is_no_number():
    """A load of NaN is an error, and the next solve works."""
    body = block(yeoh, (np.nan, 0.0))
    problem = body.problem()
    with raises(ConvergenceError, "NaN or Inf"):
        problem.solve()
    agree(problem.solver.getConvergedReason() == -4)  # of another name in each PETSc
    body.load.value = (0.1, 0.0)
    problem.solve()
    agree(problem.solver.getConvergedReason() > 0)


def test_step_limit_is_named_and_the_next_solve_continues():
    """The error of too few steps names snes_max_it, and the next solve continues from there."""
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


@every_formulation
def test_failure_of_the_linear_solver(formulation):
    """A failed linear solve is named as the reason, and u is unchanged."""
    body = block(yeoh, (0.3, 0.1))
    problem = body.problem({"ksp_max_it": 1, "feti_formulation": formulation})
    with raises(
        ConvergenceError, f"linear solver failed: no convergence within -{PREFIX}ksp_max_it"
    ):
        problem.solve()
    agree(problem.solver.getConvergedReason() == Reason.DIVERGED_LINEAR_SOLVE)
    equal(owned(body.u), 0.0 * owned(body.u))


def flat(*, energy=True, **options):
    """Π' = ∫ ε ∇u·∇v + f v with f = u − 1 − u²/2 + u² (u − 1)², by Π or its derivative.

    From zero a whole step leads to u = 1, where K 1 = 0 for f' = 0; f = 0 is further on.
    """
    u = dolfinx.fem.Function(dolfinx.fem.functionspace(cube(2, 8), ("Lagrange", 1)))
    well = u**2 / 2 - u - u**3 / 6 + u**5 / 5 - u**4 / 2 + u**3 / 3
    F = (0.05 * ufl.inner(ufl.grad(u), ufl.grad(u)) + well) * ufl.dx
    F = F if energy else ufl.derivative(F, u, ufl.TestFunction(u.function_space))
    return u, NonlinearProblem(F, u, subdomains=6, petsc_options=options)


def arrived(u):
    """Require that f(u) = 0."""
    x = owned(u)
    small(np.abs(x - 1 - x**2 / 2 + x**2 * (x - 1) ** 2).max(initial=0.0), 1e-6)


@pytest.mark.parametrize("distance", np.logspace(-15, -9, 7))
def test_nearly_singular_is_singular_or_solved(distance):
    """A tangent at any distance from a singular one is solved or reported as singular."""
    u, problem = flat(snes_max_it=1)
    u.x.array[:] = 1.0 + distance
    with raises(ConvergenceError, r"singular|no convergence within 1 steps"):
        problem.solve()
    solved = problem.solver.getKSP().getConvergedReason() > 0
    agree(solved != problem.solver.getKSP().getPythonContext().singular)


@pytest.mark.parametrize("kind", ["all_floating", "classical"])
def test_singular_on_the_way_counts_as_indefinite(kind):
    """With an energy, a singular tangent is shifted and the solve converges."""
    u, problem = flat(feti_type=kind, ksp_rtol=1e-12)
    problem.solve()
    shifts = [step.shift for step in problem.history]
    agree(shifts[0] == shifts[-1] == 0.0 < shifts[1] and problem.history[1].solves > 1, shifts)
    agree(problem.history[1].indefinite is None, "not known of a singular tangent")
    arrived(u)


@pytest.mark.parametrize("kind", ["all_floating", "classical"])
def test_singular_tangent_of_a_trial_state(kind):
    """A singular tangent ends a solve with ``give_up_early``, and is shifted otherwise."""
    u, problem = flat(energy=False, feti_type=kind, ksp_rtol=1e-12)
    with raises(ConvergenceError, "tangent at this trial state is singular.*: begin closer to the"):
        problem.solve(give_up_early=True)
    agree(len(problem.history) == 1 and problem.history[0].step_length == 1.0)
    small(np.abs(owned(u) - 1.0).max(initial=0.0), 1e-12)
    u.x.array[:] = 0.0
    problem.solve()
    agree(problem.history[0].shift == 0.0 < problem.history[1].shift)
    arrived(u)


def test_singular_tangent_at_the_start():
    """A singular first tangent means missing supports, unless an earlier tangent was regular."""
    u, problem = flat()
    supports = (
        r"linear solver failed: .*singular, with a kernel of dimension 1.*Add Dirichlet conditions"
    )
    steps = (
        "the tangent at this trial state is singular or indefinite, although the body is supported"
    )
    for reference, message in ((None, supports), (1.0, steps), (None, supports)):
        u.x.array[:] = 1.0
        with raises(ConvergenceError, message):
            problem.solve(reference=reference)
        agree(problem.history == [] and problem.solver.getKSP().getPythonContext().singular)
    u.x.array[:] = 0.0
    problem.solve()
    u.x.array[:] = 1.0
    with raises(ConvergenceError, steps):
        problem.solve()


# -- on the last process

LAST = COMM.rank == COMM.size - 1


def broken(*_: object, **__: object) -> None:
    raise FloatingPointError("on purpose")


@pytest.mark.parametrize("name", ["form", "Expression"])
def test_compilation_error_on_one_process_is_raised_on_all(name, monkeypatch):
    """A compilation that fails on the last process raises on all."""
    original = getattr(dolfinx.fem, name)

    def compiled(*args, **options):
        result = original(*args, **options)  # all take part in it
        if LAST:
            raise RuntimeError("the cache is full")
        return result

    body = block(yeoh, (0.3, 0.1))
    monkeypatch.setattr(dolfinx.fem, name, compiled)
    with raises(RuntimeError, "the cache is full"):
        body.problem()


@pytest.mark.parametrize(
    ("which", "collected"),
    [("SNES", False), ("KSP", False), ("linear", False), ("KSP", True), ("linear", True)],
)
def test_monitor_of_the_users_own(which, collected):
    """An error in a user's monitor is raised on all processes, during garbage collection too."""
    problem = torn(poisson(cube(2, 4))) if which == "linear" else block(yeoh, (0.3, 0.1)).problem()
    solver = problem.solver.getKSP() if which == "KSP" else problem.solver

    def monitor(solver: object, its: int, norm: float) -> None:
        for _ in range(100 * collected):
            cycle = []
            cycle.append(cycle)
        if its == 1 and (LAST or collected):
            raise ZeroDivisionError("in the monitor")

    solver.setMonitor(monitor)
    before = gc.get_threshold()
    gc.set_threshold(*((1,) if collected else before))
    try:
        with raises(ZeroDivisionError, "in the monitor"):
            problem.solve()
    finally:
        gc.set_threshold(*before)
    assert gc.isenabled()
    if which == "SNES":
        agree(len(problem.history) == 1)


WORK = [(Condensation, name) for name in ("assemble", "residual", "condense")]


@pytest.mark.parametrize(("owner", "name"), [*WORK, (DeformationGradient, "_smallest_on_process")])
def test_error_in_a_newton_step_on_one_process_is_raised_on_all(owner, name, monkeypatch):
    """An error on the last process in a part of a Newton step is raised on all."""
    body = wall(tube(), degree=1)
    problem = body.problem(4)
    body.load.value = 1.0
    if LAST:
        monkeypatch.setattr(owner, name, broken)
    with raises(FloatingPointError, "on purpose"):
        problem.solve()


def test_error_in_the_potential_restores_the_pressure(monkeypatch):
    """An error in the potential is raised on all, and the pressure has its values from before."""
    body = wall(tube(), degree=1)
    problem = body.problem(4)
    system = problem._system
    body.p.x.array[:] = before = np.arange(len(body.p.x.array), dtype=float)
    monkeypatch.setattr(system, "_energy", object())
    monkeypatch.setattr(assembly, "integrate", broken if LAST else lambda _: 1.0)
    with raises(FloatingPointError, "on purpose"):
        system.potential()
    equal(body.p.x.array, before)
