# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Newton's method on energies of the user: convergence, tolerances and monitors."""

from __future__ import annotations

import itertools

from petsc4py import PETSc

import numpy as np
import pytest
from bodies import block, gent, least_ratio, logarithmic, two_wells, yeoh
from collective import COMM, agree, equal, raises, small
from mixed import by_place
from problems import owned
from walls import tube, wall

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, loads
from dolfinx_feti.problems import newton

Reason = PETSc.SNES.ConvergedReason


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("force", [(1.0, -0.5), (1.0, -0.5, 0.3)])
def test_energy_alone_converges_quadratically(degree, force):
    """An energy alone suffices, and Newton's method converges quadratically."""
    body = block(yeoh, force, degree=degree)
    start = body.residual()
    problem = body.problem({"snes_rtol": 1e-11})
    problem.solve()
    small(body.residual(), 1e-9 * start)
    agree(COMM.allreduce(np.abs(owned(body.u)).max(initial=0.0)) > 0.1)
    residuals = np.array([step.residual for step in problem.history])
    agree(abs(residuals[0] - start) < 1e-12 * start)
    agree(4 <= len(residuals) <= 8 and problem.history[-1].step_length == 1.0, residuals)
    new = np.array([step.tangent_lag == 0 for step in problem.history[1:-1]])
    constants = residuals[2:] / residuals[1:-1] ** 2
    agree(constants[new].max() < 1e2 and residuals[-1] < 1e-2 * residuals[-2], residuals)


def test_linear_solves_are_as_accurate_as_the_step_deserves():
    """Linear solves reach a tenth of Newton's tolerance, unless the user sets ksp_rtol or ksp_atol.

    The formulation is the dual one, whose iterations depend on the tolerance. In the primal one the
    coarse space contains all of so small a body, and each solve takes two iterations.
    """
    found = []
    for options in ({}, {"ksp_rtol": 1e-8}, {"ksp_atol": 1e-50}):
        body = block(yeoh, (1.0, -0.5))
        tolerances = {"snes_rtol": 1e-6, "snes_atol": 1e-12}
        problem = body.problem({"feti_formulation": "dual"} | tolerances | options)
        problem.solve()
        steps = problem.history
        r = np.array([step.residual for step in steps])
        for step, rtol in zip(steps, 1e-7 * r[0] / r, strict=True):
            small(step.linear_rtol / max(1e-8, 0.0 if options else rtol) - 1.0, 1e-12)
            small(step.linear_residual, step.linear_rtol)
        agree(problem.solver.getKSP().getTolerances()[:2] == (1e-8, 1e-50))
        found.append((len(steps), sum(step.linear_iterations for step in steps)))
    agree(found[0][0] == found[1][0] and found[1] == found[2], "as many Newton steps")
    agree(found[0][1] < found[1][1], found)


@pytest.mark.parametrize("kappa", [1e4, 1e5])
def test_a_tangent_is_kept_where_it_leads_to_the_end(kappa, monkeypatch):
    """Reusing a tangent saves tangents and does not change the solution."""
    found = []
    for leads_to_end in (newton.leads_to_end, lambda *_: False):
        monkeypatch.setattr(newton, "leads_to_end", leads_to_end)
        body = wall(tube(), kappa=kappa, degree=2)
        problem = body.problem(4)
        body.load.value = loads.mmhg(20.0)
        problem.solve()
        found.append((problem.history, owned(body.u).copy()))
    (history, u), (all_new, expected) = found
    equal(u, expected, 1e-8)
    lags = [step.tangent_lag for step in history]
    agree(max(lags) > 0 and all(step.tangent_lag == 0 for step in all_new), lags)
    agree(lags.count(0) < len(all_new) and len(history) <= len(all_new) + 1, (history, all_new))
    left = [after.residual / step.residual for step, after in itertools.pairwise(history)]
    kept = [share for share, lag in zip(left, lags, strict=False) if lag]
    agree(max(kept, default=0.0) < 0.3, kept)


@pytest.mark.parametrize("kind", ["all_floating", "classical"])
def test_each_step_from_a_ridge_lowers_the_potential(kind):
    """From a ridge each step lowers the potential; the last steps have no shift."""
    u, energy, bcs = two_wells()
    problem = NonlinearProblem(energy, u, bcs, subdomains=6, petsc_options={"feti_type": kind})
    form = dolfinx.fem.form(energy)
    heights = []

    def keep(snes, its, norm):
        heights.append(COMM.allreduce(dolfinx.fem.assemble_scalar(form)))

    problem.solver.setMonitor(keep)
    problem.solve()
    problem.solver.monitorCancel()
    agree(len(heights) == len(problem.history) + 1 > 4, heights)
    rises = np.diff(heights) / np.abs(heights[0])
    agree(rises.max() <= 1e-12 and heights[-1] < heights[0], heights)
    agree(COMM.allreduce(owned(u).max(initial=0.0), op=max) > 0.95)
    agree(COMM.allreduce(owned(u).min(initial=0.0), op=min) > -0.1)
    shifts = [step.shift for step in problem.history]
    agree(max(shifts) > 0.0 and shifts[-1] == 0.0, shifts)
    agree(all(step.shift > 0.0 for step in problem.history if step.solves > 1))
    agree(all(step.linear_residual <= step.linear_rtol for step in problem.history))
    counts = [step.indefinite for step in problem.history]
    agree(counts[0] > 0 and counts[-1] == 0 and None in counts, counts)
    agree(all(step.shift > 0.0 for step in problem.history if step.indefinite is None), counts)


def test_residual_alone_takes_no_shift():
    """Without an energy, no shift is applied, and Newton's method may end at a saddle point."""
    u, energy, bcs = two_wells()
    F = ufl.derivative(energy, u, ufl.TestFunction(u.function_space))
    problem = NonlinearProblem(F, u, bcs, subdomains=6)
    problem.solve()
    agree(all(step.shift == 0.0 and step.solves == 1 for step in problem.history))
    small(COMM.allreduce(np.abs(owned(u)).max(initial=0.0), op=max), 0.5)


@pytest.mark.parametrize("watched", [True, False])
@pytest.mark.parametrize("density", [logarithmic, gent])
def test_step_is_shortened_before_the_energy_ends(density, watched):
    """A step is shortened where a whole one leaves the energy's domain, J ≤ 0 or NaN."""
    force = (-3.0, 0.0) if density is logarithmic else (6.0, 0.0)
    body = block(density, force)
    always = dolfinx.fem.Constant(body.u.function_space.mesh, 1.0)
    problem = body.problem(volume_ratio=None if watched else always)
    problem.solve()
    lengths = [step.step_length for step in problem.history]
    agree(min(lengths) < 1.0 and lengths[-1] == 1.0, lengths)
    agree(least_ratio(body.u) > 0.0)
    small(body.residual(), 1e-7 * abs(force[0]))


def test_eisenstat_walker_tolerances_save_linear_iterations():
    """The tolerances of Eisenstat and Walker save linear iterations at the same solution."""
    choices = {"snes_ksp_ew": None, "snes_ksp_ew_rtol0": 0.01, "snes_ksp_ew_rtolmax": 0.01}
    states = []
    costs = []
    for options in ({"ksp_rtol": 1e-8}, choices):
        body = wall(tube())
        steps = body.inflate(body.problem(4, {"snes_rtol": 1e-9, **options}), [2.0, 10.0])
        states.append(by_place(body.u))
        costs.append([step.linear_iterations for step in steps])
        loosest = max(step.linear_residual for step in steps)
        agree((loosest <= 1e-8) == (options is not choices) and loosest <= 0.01, loosest)
    equal(states[1], states[0], 1e-7)
    agree(sum(costs[1]) <= 0.8 * sum(costs[0]) and len(costs[1]) <= 1.5 * len(costs[0]), costs)


def test_tolerance_may_refer_to_another_state():
    """``reference=`` replaces the residual at the start, which a bad guess makes too large."""
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


def test_tolerances_end_a_solve_with_petscs_reasons():
    """Relative and absolute tolerance end a solve with PETSc's converged reasons."""
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
    """PETSc's monitor and convergence history have the residual of each Newton step."""
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
    pairs = zip(residuals, lines, strict=False)
    agree(all(f"{r:.6e}" in line or f"{r:.12e}" in line for r, line in pairs), lines)
