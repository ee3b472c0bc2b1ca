# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Newton's method stops only if the error is small, even where the residual hides it."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import NamedTuple

from petsc4py import PETSc

import numpy as np
import pytest
from cases import each, every_formulation
from collective import agree, equal, logged_messages, lu_solve, small
from penalty import bar_mesh, far, greatest, off_by
from problems import dirichlet, left, owned, tagged
from walls import beam, tube, wall

import dolfinx
import ufl

from dolfinx_feti import ConvergenceError, NonlinearProblem
from dolfinx_feti.comparison import assembled_system
from dolfinx_feti.feti.accuracy import ComponentNorms
from dolfinx_feti.problems.iteration.state_error import StateError
from dolfinx_feti.scalars import mean_value

Reason = PETSc.SNES.ConvergedReason

#: Largest difference to Newton's method with LU, over max |u|, for the default tolerance of 1e-8.
ACCURATE = 1e-6


class Bar(NamedTuple):
    """A bar whose far end hangs on springs."""

    u: dolfinx.fem.Function
    energy: ufl.Form
    bcs: list[dolfinx.fem.DirichletBC]
    fields: Sequence[dolfinx.fem.Function]
    ds: ufl.Measure

    def problem(self, formulation="auto", *, energy=True, **options):
        """Return the problem of the energy, or of its residuals."""
        residuals = [
            ufl.derivative(self.energy, f, ufl.TestFunction(f.function_space))
            for f in (self.u, *self.fields)
        ]
        keywords = {"subdomains": 6, "condense": self.fields or None}
        scalars = options.pop("scalars", ())
        keywords |= {key: options.pop(key) for key in ("volume_tolerance",) if key in options}
        F = residuals if self.fields else residuals[0]
        return NonlinearProblem(
            self.energy if energy else F,
            self.u,
            bcs=self.bcs,
            scalars=scalars,
            petsc_options={"feti_formulation": formulation, **options},
            **keywords,
        )


def bar(ratio, dim=2, *, condensed=False, linear=False, units=(1.0, 1.0), pull=(0.3, 0.2, 0.1)):
    """Pull a neo-Hookean bar, or a linear one, by springs of the stiffness ratio μ.

    Units are factors of stress and length.
    """
    stress, length = units
    mesh = bar_mesh(dim, None, 2 if dim == 3 else 3)
    mesh.geometry.x[:] *= length
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2 if condensed else 1, (dim,)))
    u = dolfinx.fem.Function(V)
    ds = tagged(mesh, lambda x: far(x / length))(1)
    mu = 2.0 * stress
    lmbda = 4.0 * stress
    F = ufl.Identity(dim) + ufl.grad(u)
    J = ufl.det(F)
    fields = []
    e = ufl.sym(ufl.grad(u))
    body = mu / 2 * (ufl.inner(F, F) - dim - 2 * ufl.ln(J)) + lmbda / 2 * ufl.ln(J) ** 2
    if linear:
        body = mu * ufl.inner(e, e) + lmbda / 2 * ufl.tr(e) ** 2
    if condensed:
        p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)))
        kappa = 1e3 * mu
        body = mu / 2 * (ufl.inner(F, F) - dim - 2 * ufl.ln(J)) + p * (J - 1) - p**2 / (2 * kappa)
        fields = [p]
    g = ufl.as_vector([length * each for each in pull[:dim]])
    k = ratio * mu / length
    energy = body * ufl.dx(degree=2) + k / 2 * ufl.inner(u - g, u - g) * ds
    return Bar(u, energy, [dirichlet(V, left)], fields, ds)


def reference(body, steps=25):
    """Solve with MUMPS by whole steps until they are rounding."""
    problem = body.problem()
    n = len(owned(body.u))
    change = np.inf
    for _ in range(steps):
        A, b = problem.linear_system()
        K, f = assembled_system(A, b)
        du = lu_solve(K, f)
        residual = problem._system.residual()
        increment = problem._system.increment(residual, du)
        state = problem._system.state
        state.set(state.values().moved(1.0, increment))
        for used in (K, f, b):
            used.destroy()
        change = greatest(du) / greatest(body.u.x.array[:n])
        if change <= 1e-13:
            break
    agree(change <= 1e-10)
    found = owned(body.u)
    fields = [field.x.array.copy() for field in body.fields]
    for used in (body.u, *body.fields):
        used.x.array[:] = 0.0
    return found, fields


def check(problem, body, exact, tolerance=ACCURATE):
    """Solve; require the reference state, and an estimated error of 1e-8 or an end by rounding."""
    problem.solve()
    small(off_by(owned(body.u), exact), tolerance)
    last = problem.history[-1]
    agree(
        last.error <= 1e-8 or problem.solver.getConvergedReason() == Reason.CONVERGED_FNORM_ABS,
        last,
    )
    return problem.history


@every_formulation
@pytest.mark.parametrize("energy", [True, False], ids=["energy", "residual"])
@pytest.mark.parametrize("ratio", [1e5, 1e8], ids="{:g}".format)
@pytest.mark.parametrize("dim", [2, 3])
def test_bar_on_springs_of_any_stiffness_has_the_reference_solution(
    dim, ratio, energy, formulation
):
    """A bar on springs of any stiffness has the reference solution when Newton's method stops."""
    body = bar(ratio, dim)
    exact, _ = reference(body)
    history = check(body.problem(formulation, energy=energy), body, exact)
    agree(len(history) <= 14, [step.residual for step in history])


@every_formulation
@pytest.mark.parametrize("ratio", [1e2, 1e8], ids="{:g}".format)
def test_condensed_pressure_is_as_accurate_as_u(ratio, formulation):
    """The condensed pressure of each cell is as accurate as u."""
    body = bar(ratio, 3, condensed=True, pull=(0.1, 0.05, 0.05))
    exact, (pressure,) = reference(body)
    check(body.problem(formulation), body, exact)
    small(off_by(body.fields[0].x.array, pressure), 1e-5)


@every_formulation
def test_linear_body_takes_one_tangent(formulation):
    """A linear body is accurate after at most three steps, all with one tangent."""
    body = bar(1e8, linear=True)
    exact, _ = reference(body)
    history = check(body.problem(formulation), body, exact)
    agree(len(history) <= 3, [step.error for step in history])
    agree(all(step.tangent_lag for step in history[1:]), history)


@pytest.mark.parametrize("units", [(1e-6, 1e3), (1e9, 1e-3)], ids=["MPa-km", "mm"])
def test_steps_and_estimated_errors_do_not_depend_on_units(units):
    """Steps, iterations and estimated errors do not depend on the units."""
    histories = []
    for stress_and_length in ((1.0, 1.0), units):
        body = bar(1e6, units=stress_and_length)
        problem = body.problem()
        problem.solve()
        histories.append([(step.linear_iterations, step.step_length) for step in problem.history])
        histories.append(problem.history[-1].error)
    agree(histories[0] == histories[2], histories)
    agree(0.3 <= histories[1] / histories[3] <= 3.0, histories)


def test_second_solve_takes_at_most_one_step():
    """A second solve from the solution takes at most one step, and leaves u accurate."""
    body = bar(1e8)
    exact, _ = reference(body)
    problem = body.problem()
    problem.solve()
    problem.solve()
    agree(len(problem.history) <= 1, problem.history)
    small(off_by(owned(body.u), exact), ACCURATE)


def test_small_first_residual_does_not_end_a_solve():
    """A small first residual does not end a solve before the error is estimated."""
    body = bar(1e3)
    exact, _ = reference(body)
    body.u.x.array[: len(exact)] = exact * (1.0 + 1e-4)
    body.u.x.scatter_forward()
    problem = body.problem(snes_rtol=1e-8)
    problem.solve(reference=1e12)
    small(off_by(owned(body.u), exact), ACCURATE)
    agree(len(problem.history) >= 1)


def test_absolute_tolerance_of_the_user_ends_without_a_solve():
    """A residual below snes_atol ends the solve before the first linear solve."""
    body = bar(1e3)
    problem = body.problem(snes_atol=1e12)
    problem.solve()
    agree(not problem.history)
    agree(problem.solver.getKSP().getPythonContext().formulation is None)


def test_no_load_needs_no_step(caplog):
    """Zero load ends at once with the zero solution, and with one warning for each problem."""
    body = bar(1e3, pull=(0.0, 0.0, 0.0))
    problem = body.problem()
    with caplog.at_level(logging.WARNING, "dolfinx_feti"):
        for _ in range(2):
            problem.solve()
    agree(not problem.history)
    equal(owned(body.u), np.zeros(len(owned(body.u))))
    (said,) = logged_messages(caplog)
    agree("no load acts on a free dof" in said and "boundary=" in said, said)


def test_error_that_no_step_reduces_ends_with_a_warning(monkeypatch, caplog):
    """An error that no step reduces ends the solve with a warning that has its size."""
    body = bar(1e3)
    problem = body.problem()
    monkeypatch.setattr(StateError, "_measured", lambda self, iterate: 3e-5)
    with caplog.at_level(logging.WARNING, "dolfinx_feti"):
        problem.solve()
    said = logged_messages(caplog)
    agree(len(said) == 1 and "estimated error of 3e-05" in said[0], said)
    agree(problem.solver.getConvergedReason() > 0 and len(problem.history) < 12)


def test_step_limit_with_a_large_error_is_a_failure():
    """Reaching snes_max_it with a small residual but a large error is a failure."""
    body = bar(1e8)
    problem = body.problem(snes_max_it=1)
    with pytest.raises(ConvergenceError, match="within 1 steps"):
        problem.solve()


@every_formulation
@pytest.mark.parametrize("ratio", [1e2, 1e7], ids="{:g}".format)
def test_prescribed_mean_is_accurate_beside_springs(ratio, formulation):
    """A prescribed mean of u and springs are both accurate at the end."""
    body = bar(ratio)
    mean = mean_value(body.u, ufl.as_vector([0.16, 0.09]))
    problem = body.problem(formulation, scalars=[mean])
    problem.solve()
    agree(problem.history[-1].error <= 1e-8, problem.history)
    before = owned(body.u)
    force = mean.unknown.value.copy()
    tight = body.problem(formulation, scalars=[mean], snes_rtol=1e-14, ksp_rtol=1e-12)
    tight.solve()
    small(off_by(before, owned(body.u)), ACCURATE)
    small(np.abs(force / mean.unknown.value - 1.0).max(), 1e-5)


@every_formulation
def test_last_solve_of_volume_multipliers_is_accurate(formulation):
    """The last solve of volume multipliers is accurate, although those before it are not."""
    body = bar(1e7, 3, condensed=True, pull=(0.1, 0.05, 0.05))
    problem = body.problem(formulation, volume_tolerance=1e-8)
    problem.solve()
    before = owned(body.u)
    agree(problem.history[-1].error <= 1e-8, problem.history[-1])
    again = body.problem(formulation, volume_tolerance=1e-8, snes_rtol=1e-13)
    again.solve()
    small(off_by(before, owned(body.u)), ACCURATE)


# ---- what it costs --------------------------------------------------------------------------


def path(create, pressures, formulation):
    """Follow pressures, and return the linear iterations of each step."""
    body = create()
    problem = body.problem(8, {"feti_formulation": formulation})
    return [step.linear_iterations for step in body.inflate(problem, pressures)]


WALLS = {
    "tube P2": (lambda: wall(tube(), kappa=1000.0), [5.0, 15.0]),
    "tube P2 soft": (lambda: wall(tube(), kappa=10.0), [5.0]),
    "beam": (lambda: beam(tangent="symmetric"), [0.006]),
}


@every_formulation
@each(("create", "pressures"), WALLS)
def test_error_control_hardly_costs_iterations_without_a_penalty(
    create, pressures, formulation, monkeypatch
):
    """Without a penalty, controlling the error costs at most 3 % more linear iterations."""
    now = path(create, pressures, formulation)
    monkeypatch.setattr(ComponentNorms, "largest_ratio", lambda *_: 0.0)
    before = path(create, pressures, formulation)
    agree(sum(now) <= 1.03 * sum(before), (now, before))
