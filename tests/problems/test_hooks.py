# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Functions that a script sets on ``problem.solver`` are called as PETSc does, or refused."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import pytest
from cases import each
from collective import COMM, agree, equal, norm, raises, small
from problems import cube, dirichlet, left, owned, right

import dolfinx
import ufl

from dolfinx_feti import ConvergenceError, LinearProblem, NonlinearProblem
from dolfinx_feti.loading import Steps, follow_load

Reason = PETSc.SNES.ConvergedReason


class Diffusion:
    """−div((1 + u²) ∇u) = s on the unit square, u = 1 on the left."""

    def __init__(self, start: float = 1.0) -> None:
        mesh = cube(2, 6)
        V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1))
        self.u = dolfinx.fem.Function(V)
        v = ufl.TestFunction(V)
        self.u.x.array[:] = start
        self.source = dolfinx.fem.Constant(mesh, 3.0)
        flux = ufl.inner((1 + self.u**2) * ufl.grad(self.u), ufl.grad(v))
        self.F = (flux - self.source * v) * ufl.dx
        self.bcs = [dirichlet(V, left, lambda x: 1.0 + 0.0 * x[0])]

    def problem(self, **arguments: object) -> NonlinearProblem:
        return NonlinearProblem(self.F, self.u, bcs=self.bcs, subdomains=4, **arguments)


def test_update_is_called_before_each_step():
    """``setUpdate`` is called with the step number before each step, and not after the last one."""
    calls = []
    problem = Diffusion().problem()

    def update(snes, step, word, *, factor):
        calls.append((step, snes.getIterationNumber(), word, factor))

    problem.solver.setUpdate(update, ("word",), {"factor": 2.0})
    problem.solve()
    steps = len(problem.history)
    agree(steps > 2)
    agree(calls == [(i, i, "word", 2.0) for i in range(steps)], calls)
    problem.solver.setUpdate(None)
    problem.u.x.array[:] = 1.0
    problem.solve()
    agree(len(calls) == steps, f"{len(calls)} calls after the update was taken away")


def test_update_changes_a_coefficient():
    """A source that ``setUpdate`` changes is used in the same step."""
    expected = Diffusion()
    expected.source.value = 5.0
    expected.problem().solve()
    body = Diffusion()
    problem = body.problem()

    def update(snes, step):
        body.source.value = 5.0

    problem.solver.setUpdate(update)
    problem.solve()
    equal(owned(body.u), owned(expected.u), 1e-7)


def test_update_changes_the_energy():
    """The line search compares with the energy after the update, not before it."""

    def rim(x):
        return np.any(np.isclose(x[:2] * (1.0 - x[:2]), 0.0), axis=0)

    mesh = cube(2, 4)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1))
    stiffness = dolfinx.fem.Constant(mesh, 4.0)
    solutions = []
    steps = []
    for changes in (False, True):
        u = dolfinx.fem.Function(V)
        g = ufl.grad(u)
        energy = (ufl.inner(g, g) / 2 + stiffness * u**4 - 10 * u) * ufl.dx
        problem = NonlinearProblem(energy, u, bcs=[dirichlet(V, rim)], subdomains=2)

        def update(snes, step):
            stiffness.value = 1.0 if step == 0 else 4.0

        if changes:
            problem.solver.setUpdate(update)
        problem.solve()
        solutions.append(owned(u))
        steps.append(problem.history)
    equal(solutions[1], solutions[0], 1e-7)
    attempts = [step.step_length for step in steps[1]]
    agree(len(attempts) <= len(steps[0]) + 2, attempts)


@pytest.mark.parametrize("way", ["solution", "function"])
def test_update_changes_the_state(way):
    """A step starts from the state that the update writes to u or to the SNES's vector."""
    body = Diffusion()
    problem = body.problem()
    norms = []
    first = []

    def update(snes, step):
        if step == 0:
            here = snes.getSolution()
            equal(here.array_r, owned(body.u))
            if way == "solution":
                here.array[:] = 1.5
            else:
                body.u.x.array[:] = 1.5
            first.append(problem.residual_norm())

    problem.solver.setUpdate(update)
    problem.solver.setMonitor(lambda snes, step, norm: norms.append(norm))
    problem.solve()
    body.u.x.array[:] = 1.5
    moved = problem.residual_norm()
    agree(problem.history[0].residual == pytest.approx(moved), problem.history[0].residual)


def test_own_test_ends_the_solve():
    """A convergence test receives PETSc's norms of x, the step and the residual."""
    body = Diffusion(start=0.0)
    problem = body.problem()
    seen = []

    def test(snes, step, norms):
        seen.append((step, *norms, norm(snes.getFunction()[0].array_r)))
        return Reason.CONVERGED_FNORM_ABS if norms[2] < 1e-3 else 0

    problem.solver.setConvergenceTest(test)
    problem.solve()
    agree(problem.solver.getConvergedReason() == Reason.CONVERGED_FNORM_ABS)
    steps = [each[0] for each in seen]
    agree(steps == list(range(len(problem.history) + 1)), steps)
    agree(seen[0][1:3] == (0.0, 0.0), seen[0])
    held = body.bcs[0].dof_indices()
    count = COMM.allreduce(np.sum(held[0] < held[1]))
    agree(seen[0][3] >= np.sqrt(count) - 1e-12, "u − g is part of the first norm")
    small(seen[-1][1] - norm(owned(body.u)), 1e-10)
    small(seen[-1][3] - norm(problem.b.array_r), 1e-12)
    for _, _, _, petsc_norm, own_norm in seen:
        small(petsc_norm - own_norm, 1e-12 * max(petsc_norm, 1.0))
    agree(1e-9 < seen[-1][3] < 1e-3, seen[-1])
    agree(seen[-2][2] > seen[-1][2] > 0.0, "steps become shorter")


def test_own_test_against_petscs_newton():
    """A convergence test receives the same norms from PETSc's own Newton's method."""
    body = Diffusion()
    problem = body.problem(petsc_options={"ksp_rtol": 1e-12})
    found = {"own": [], "PETSc": []}

    def record(snes, step, norms, name):
        found[name].append(norms)
        return 3 if norms[2] < 1e-8 else 0

    problem.solver.setConvergenceTest(record, ("own",))
    problem.solve()
    equal(np.array([each.step_length for each in problem.history]), np.ones(len(problem.history)))
    solution = owned(body.u)
    vector, (residual, _, _) = problem.solver.getFunction()
    A, P, (tangent, _, _) = problem.solver.getJacobian()
    agree(vector.handle == problem.b.handle, "getFunction returns another vector than b")
    agree(A.handle == P.handle == problem.A.handle, "getJacobian returns other matrices than A")
    r = A.createVecLeft()
    x = A.createVecRight()
    x.set(1.0)
    snes = PETSc.SNES().create(COMM)
    snes.setFunction(residual, r)
    snes.setJacobian(tangent, A)
    snes.setKSP(problem.create_linear_solver())
    snes.setType("newtonls")
    if hasattr(snes, "getLineSearch"):
        snes.getLineSearch().setType("basic")
    snes.setConvergenceTest(record, ("PETSc",))
    snes.solve(None, x)
    equal(x.array_r, solution, 1e-6)
    equal(np.array(found["own"][:4]), np.array(found["PETSc"][:4]), 1e-6)


def test_own_test_decides_alone():
    """A convergence test alone decides whether a solve continues, converges or fails."""
    problem = Diffusion().problem(petsc_options={"snes_rtol": 1e-2})
    problem.solver.setConvergenceTest(lambda snes, step, norms: step == 7)
    problem.solve()
    agree(len(problem.history) == 7, problem.history)
    agree(problem.solver.getConvergedReason() == Reason.CONVERGED_ITS)
    problem.u.x.array[:] = 1.0
    problem.solver.setConvergenceTest(lambda snes, step, norms: -9 if step == 1 else 0)
    with raises(ConvergenceError, "the convergence test of problem.solver .* reason -9"):
        problem.solve()
    problem.u.x.array[:] = 1.0
    problem.solver.setConvergenceTest(lambda snes, step, norms: 0)
    problem.solver.setTolerances(max_it=9)
    with raises(ConvergenceError, "no convergence within 9 steps"):
        problem.solve()
    agree(len(problem.history) == 9, problem.history)


@pytest.mark.parametrize("way", ["call", "option"])
def test_petscs_own_tests(way):
    """PETSc's convergence test ``skip`` takes all steps, and ``default`` converges by rtol."""
    options = {"snes_max_it": 4}
    skip = {"snes_convergence_test": "skip"} if way == "option" else {}
    problem = Diffusion().problem(petsc_options={**options, **skip})
    if way == "call":
        problem.solver.setConvergenceTest("skip")
    problem.solve()
    agree(len(problem.history) == 4, problem.history)
    agree(problem.solver.getConvergedReason() == Reason.CONVERGED_ITS)
    problem.solver.setConvergenceTest("default")
    problem.solver.setTolerances(rtol=1e-3)
    problem.u.x.array[:] = 1.0
    problem.solve()
    agree(problem.solver.getConvergedReason() > 0)


def test_processes_that_disagree_go_on():
    """A convergence test that is met on only one process does not end the solve."""
    problem = Diffusion().problem()
    most = COMM.size + 1

    def test(snes, step, norms):
        return 2 if step > COMM.rank else 0

    problem.solver.setConvergenceTest(test)
    problem.solve()
    agree(len(problem.history) == most - 1, problem.history)


@pytest.mark.parametrize("hook", ["setUpdate", "setConvergenceTest"])
def test_hook_that_fails_on_one_process(hook):
    """An error in a hook on one process is raised on all, and the next solve works."""
    problem = Diffusion().problem()

    def fail(*arguments):
        if COMM.rank == COMM.size - 1:
            raise ZeroDivisionError("the user's own")
        return 0

    getattr(problem.solver, hook)(fail)
    with raises(ZeroDivisionError, "the user's own"):
        problem.solve()
    getattr(problem.solver, hook)(None)
    problem.solve()


REFUSED = {
    "setFunction": "as F, .*before_assembly=",
    "setJacobian": "as J, .*before_assembly=",
    "setObjective": "energy=",
    "setInitialGuess": "set u before",
    "setLineSearchPreCheck": "step length",
    "setNGS": "leave it out",
}


@pytest.mark.parametrize("when", ["before", "after"])
@pytest.mark.parametrize("hook", REFUSED)
def test_foreign_functions_are_refused(hook, when):
    """Hooks that would have no effect are refused by name, set before or after a solve."""
    body = Diffusion()
    problem = body.problem()
    if when == "after":
        problem.solve()
    own = {
        "setFunction": (lambda *_: None, problem.b.duplicate()),
        "setJacobian": (lambda *_: None, problem.A),
    }
    getattr(problem.solver, hook)(*own.get(hook, [lambda *_: None]))
    with raises(ValueError, f"problem.solver.{hook} has no effect: .*{REFUSED[hook]}"):
        problem.solve()


def test_foreign_function_on_one_process():
    """A hook without effect that is set on one process only is refused on all."""
    problem = Diffusion().problem()
    if COMM.rank == 0:
        problem.solver.setAttr("__objective__", (max, (), {}))
    with raises(ValueError, "setObjective"):
        problem.solve()


VI = ["vinewtonrsls", "vinewtonssls"]


@pytest.mark.parametrize("kind", VI)
def test_variational_inequalities_by_option(kind):
    """The option snes_type refuses variational inequalities, and recommends a penalty."""
    with raises(ValueError, f"hooked_snes_type {kind} asks for bounds .*penalty"):
        Diffusion().problem(petsc_options={"snes_type": kind}, petsc_options_prefix="hooked_")
    key = "hooked_snes_type"
    PETSc.Options().setValue(key, kind)
    try:
        with raises(ValueError, f"{key} {kind} asks for bounds"):
            Diffusion().problem(petsc_options_prefix="hooked_")
    finally:
        PETSc.Options().delValue(key)


@pytest.mark.parametrize("solved", [False, True])
@pytest.mark.parametrize("kind", [*VI, None])
def test_bounds_on_the_unknown_are_refused(kind, solved):
    """Bounds on the unknown are refused with u unchanged, before and after a solve."""
    body = Diffusion()
    problem = body.problem()
    if solved:
        problem.solve()
    if kind is not None:
        problem.solver.setType(kind)
    low = problem.x.duplicate()
    high = problem.x.duplicate()
    high.set(1e20)
    problem.solver.setVariableBounds(low, high)
    before = owned(body.u)
    with raises(ValueError, "bounds on the unknown .*penalty"):
        problem.solve()
    equal(owned(body.u), before)


#: What a script changes in the solver of a problem.
OTHER_SOLVERS = {
    "type": lambda snes: snes.setType("newtonls"),
    "context": lambda snes: snes.setPythonContext(object()),
    "type-of-the-ksp": lambda snes: snes.getKSP().setType("cg"),
    "ksp": lambda snes: snes.setKSP(PETSc.KSP().create(COMM)),
    "preconditioner": lambda snes: snes.getNPC(),
}


@each("change", OTHER_SOLVERS)
def test_other_solvers_are_refused(change):
    """Other types of the SNES or its KSP, and nonlinear preconditioners, are refused."""
    problem = Diffusion().problem()
    change(problem.solver)
    with raises(ValueError, r"problem\.solver.* has (the type|a nonlinear preconditioner)"):
        problem.solve()


def test_another_solver_of_a_linear_problem_is_refused():
    """A linear problem refuses another type of its KSP."""
    V = Diffusion().u.function_space
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    linear = LinearProblem(
        ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx,
        v * ufl.dx,
        bcs=[dirichlet(V, right)],
        subdomains=3,
    )
    linear.solver.setType("cg")
    with raises(ValueError, r"problem\.solver has the type cg"):
        linear.solve()


def test_hooks_in_load_steps():
    """Each load step counts its updates from zero, and the convergence test ends each solve."""
    body = Diffusion()
    problem = body.problem()
    starts = []
    ends = []

    def update(snes, step):
        starts.append(step)

    def test(snes, step, norms):
        ends.append(norms[2])
        return 2 if norms[2] < 1e-7 else 0

    problem.solver.setUpdate(update)
    problem.solver.setConvergenceTest(test)

    def set_load(value):
        body.source.value = value

    follow_load(problem, set_load, [2.0, 4.0], Steps(first=2.0, least=0.5))
    agree(starts.count(0) >= 2, starts)
    agree(ends[-1] < 1e-7, ends)
    free = Diffusion()
    free.source.value = 4.0
    free.problem().solve()
    equal(owned(body.u), owned(free.u), 1e-6)
