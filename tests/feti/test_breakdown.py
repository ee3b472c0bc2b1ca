# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Failures have a negative converged reason and a remedy; no wrong answer is silent.

Advice is never what is in force.
"""

import itertools
import logging
import re
from dataclasses import replace
from types import SimpleNamespace

from petsc4py import PETSc

import numpy as np
import pytest
from cases import case, each, every_formulation, every_interior, every_type
from collective import COMM, agree, equal, raises
from hand_torn import random_values, softened, solve, solved, unsymmetric
from problems import cube, elasticity, owned, poisson, torn

import dolfinx

import dolfinx_feti
from dolfinx_feti import FETI
from dolfinx_feti.diagnosis import advice
from dolfinx_feti.feti.converged_reason import failure_message
from dolfinx_feti.feti.options import CHOICES, FETIOptions
from dolfinx_feti.feti.report import format_report
from dolfinx_feti.feti.setup import Inertia
from dolfinx_feti.feti.solve_info import Accuracy
from dolfinx_feti.problems.iteration.failures import CLOSER_START, FAILURES, SMALLER_LOAD_STEPS

SEED = 6174
Reason = PETSc.KSP.ConvergedReason

GRID = case((2, 2), (3, 3), 2)
WIDE = case((3, 2), (3, 3), 2)
ALONE = case((1, 1), (5, 5), 2)
MANY = case((3, 3), (2, 2), 2)
cg_and_gmres = pytest.mark.parametrize(
    "options", [{}, {"feti_dual_ksp_type": "gmres"}], ids=["cg", "gmres"]
)


def attempt(ksp, problem, values=None):
    """Solve; return the context and x."""
    _, x = solve(ksp, problem, random_values(problem, SEED) if values is None else values)
    return ksp.getPythonContext(), x


def failed(ksp, reason, *words):
    """Assert that all processes see this reason and a message with these words."""
    message = ksp.getPythonContext().message
    agree(ksp.getConvergedReason() == reason, (ksp.getConvergedReason(), message))
    agree(all(word in message for word in words), message)


# ---- numbers that are none ------------------------------------------------------------------


@every_type
@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("where", ["diagonal", "everywhere"])
def test_nan_in_the_matrix(where, value, kind, torn_grid, create_ksp):
    def change(K, dofs):
        rows = len(K[1]) // 2 if where == "diagonal" else slice(None)
        K[1][rows, rows] = value

    problem = torn_grid(change=change, **GRID)
    ksp = create_ksp(problem.A, feti_type=kind)
    attempt(ksp, problem)
    failed(ksp, Reason.DIVERGED_PCSETUP_FAILED, "NaN")


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("on_boundary", [False, True])
@cg_and_gmres
def test_nan_in_the_load(value, on_boundary, options, torn_grid, create_ksp):
    """The solver works again afterwards."""
    problem = torn_grid(**GRID)
    ksp = create_ksp(problem.A, **options)
    values = np.ones(len(problem.dirichlet))
    values[np.flatnonzero(problem.dirichlet == on_boundary)[3]] = value
    attempt(ksp, problem, values)
    failed(ksp, Reason.DIVERGED_NANORINF, "NaN", "load")
    agree(solved(ksp, problem, 1e-6).message == "")


# ---- no convergence -------------------------------------------------------------------------


@cg_and_gmres
def test_maximum_of_iterations(options, torn_grid, create_ksp, caplog):
    """The message is logged once."""
    problem = torn_grid(**GRID)
    ksp = create_ksp(problem.A, ksp_max_it=3, **options)
    with caplog.at_level(logging.WARNING, "dolfinx_feti"):
        attempt(ksp, problem)
    failed(ksp, Reason.DIVERGED_MAX_IT, "-test_ksp_max_it")
    agree(ksp.getIterationNumber() == 3)
    logged = [record.getMessage() for record in caplog.records]
    agree(len(logged) == (1 if COMM.rank == 0 else 0), logged)
    agree(all("-test_ksp_max_it" in line for line in logged), logged)


def shares(problem, values, x):
    """Return ‖b − A x‖/‖b − A x_D‖ on the free dofs, and that of 4 times its rounding errors."""
    K = problem.matrix
    free = ~problem.dirichlet
    scale = np.linalg.norm((values - K @ np.where(free, 0.0, values))[free])
    squares = values**2 + problem.T.T @ (problem.K_torn**2 @ (problem.T @ x) ** 2)
    rounding = np.finfo(float).eps * np.sqrt(squares[free].sum())
    return np.linalg.norm((values - K @ x)[free]) / scale, 4.0 * rounding / scale


@pytest.mark.parametrize(
    "options",
    [{}, {"feti_formulation": "primal"}, {"feti_dual_ksp_type": "gmres", "feti_type": "classical"}],
    ids=["dual", "primal", "gmres"],
)
def test_tolerance_out_of_reach_ends_at_rounding(options, torn_grid, create_ksp):
    """Refinement does not reach a residual below rounding; the message has the one reached."""
    problem = torn_grid(**GRID)
    ksp = create_ksp(problem.A, ksp_rtol=0.0, ksp_atol=0.0, **options)
    values = random_values(problem, SEED)
    context, x = attempt(ksp, problem, values)
    agree(ksp.getConvergedReason() == Reason.CONVERGED_HAPPY_BREAKDOWN and context.message == "")
    residual, floor = shares(problem, values, x)
    equal(context.floor, floor, 1e-12)
    agree(max(context.residual, residual) <= floor < 1e-13, (context.residual, residual, floor))
    agree("at the floor of rounding" in format_report(context.report()))
    ksp.setTolerances(rtol=1e-8)
    attempt(ksp, problem, values)
    agree(np.isnan(context.floor) and "rounding" not in format_report(context.report()))


@pytest.mark.parametrize("rtol", [1e-15, 1e-20])
def test_residual_above_rounding_is_not_converged(rtol, torn_grid, create_ksp, monkeypatch):
    """A Krylov method that ends far above its tolerance, on purpose, and no fresh start."""
    monkeypatch.setattr("dolfinx_feti.feti.outer_loop.TARGET_FACTOR", 1e-11 / rtol)
    monkeypatch.setattr("dolfinx_feti.feti.outer_loop.MAX_FRESH_STARTS", 0)
    problem = torn_grid(**GRID)
    ksp = create_ksp(problem.A, ksp_rtol=rtol)
    values = random_values(problem, SEED)
    context, x = attempt(ksp, problem, values)
    residual, floor = shares(problem, values, x)
    agree(1e-11 > residual > 10 * floor and np.isnan(context.floor), (residual, floor))
    failed(ksp, Reason.DIVERGED_BREAKDOWN, "stagnates", f"{context.residual:.2e}")


def test_rounding_that_leaves_a_doubt_is_a_failure(torn_grid, create_ksp, monkeypatch):
    """The limit is lowered, so that rounding makes every solution doubtful."""
    monkeypatch.setattr("dolfinx_feti.feti.converged_reason.MAX_ROUNDING_SHARE", 1e-20)
    problem = torn_grid(**GRID)
    ksp = create_ksp(problem.A, ksp_rtol=1e-20)
    context, _ = attempt(ksp, problem)
    failed(ksp, Reason.DIVERGED_BREAKDOWN, "rounding alone", "κ", f"{context.floor:.0e} ‖b‖")


# ---- wrong matrices -------------------------------------------------------------------------


def push(K, dofs):
    K[0] -= 0.3 * np.abs(K[0]).max() * np.eye(len(K[0]))


INDEFINITE = {
    "dual": (softened(0.3), {"feti_dual_ksp_type": "cg"}, "-test_feti_dual_ksp_type gmres"),
    "primal": (push, {"feti_formulation": "primal"}, "-test_feti_formulation dual"),
}


@every_type
@each(("change", "options", "remedy"), INDEFINITE)
def test_negative_curvature(
    change, options, remedy, kind, torn_grid, create_ksp, stops_at_negative_curvature
):
    """CG fails on an indefinite matrix if the user asks for CG; by default GMRES solves.

    The remedy has an effect on the form in force.
    """
    problem = torn_grid(change=change, **GRID)
    agree(problem.negative > 0)
    ksp = create_ksp(problem.A, feti_type=kind, **options)
    attempt(ksp, problem)
    indefinite = (Reason.DIVERGED_INDEFINITE_MAT, Reason.DIVERGED_INDEFINITE_PC)
    agree(ksp.getConvergedReason() in indefinite, ksp.getConvergedReason())
    agree(remedy in ksp.getPythonContext().message, ksp.getPythonContext().message)
    solved(create_ksp(problem.A, feti_type=kind, ksp_rtol=1e-10), problem, 1e-7)


@every_type
@every_interior
@pytest.mark.parametrize(
    ("grid", "share", "least"),
    [
        (GRID, 0.0, 0),
        (GRID, 0.002, 0),
        (GRID, 0.01, 1),
        (ALONE, 0.0, 0),
        (ALONE, 0.05, 1),
        (ALONE, 0.2, 1),
    ],
)
def test_indefinite_matrix_is_refused(kind, interior, grid, share, least, torn_grid, create_ksp):
    """It is refused before the first iteration, but not if only subdomains buckle.

    Without an interface all is interior, and FETI a direct solver that counts.
    """
    problem = torn_grid(change=softened(share), **grid)
    agree(problem.negative >= least and (problem.negative > 0) == (least > 0))
    options = {"feti_type": kind, "feti_interior": interior, "feti_deflation": 0}
    ksp = create_ksp(problem.A, FETI(refuse_indefinite=True), **options)
    context = ksp.getPythonContext()
    agree(context.inertia.assembled == problem.negative, context.inertia)
    if grid is not ALONE:
        agree((context.inertia.dual > 0) == (share > 0.0))
    if least == 0:
        solved(ksp, problem)
    else:
        attempt(ksp, problem)
        failed(ksp, Reason.DIVERGED_INDEFINITE_MAT)
        agree(context.iterations == 0)


@every_type
@every_interior
@pytest.mark.parametrize("share", [0.0, 0.002, 0.004, 0.01, 0.05, 0.2])
def test_what_is_proved_is_there(kind, interior, share, torn_grid, create_dual):
    """The proved number is at most that of A's negative eigenvalues; it is positive for many."""
    problem = torn_grid(change=softened(share), **WIDE)
    there = problem.negative
    for pc_type in ("dirichlet", "lumped", "identity"):
        system = create_dual(problem.A, type=kind, interior=interior, pc_type=pc_type)
        proved = system.inertia.assembled
        if proved is None:  # K_II is factored for the Dirichlet preconditioner, or eliminated
            agree(interior == "keep" and pc_type != "dirichlet" and share > 0.0)
            continue
        agree(0 <= proved <= there, (proved, there))
        if there > 1 and pc_type == "dirichlet":
            agree(proved > 0, there)
        if share == 0.0:
            agree(system.inertia.dual == 0)


# ---- the problem class ----------------------------------------------------------------------


def test_nan_coefficient_raises_and_leaves_u():
    problem = poisson(cube(2, 4))
    factor = dolfinx.fem.Constant(problem.V.mesh, np.nan)
    linear = torn(replace(problem, a=factor * problem.a), prefix="t_")
    linear.u.x.array[:] = 7.0
    with raises(dolfinx_feti.ConvergenceError, "NaN"):
        linear.solve()
    equal(owned(linear.u), np.full(len(owned(linear.u)), 7.0))
    factor.value = 2.0
    linear.solve()
    agree(linear.solver.getConvergedReason() > 0)


# ---- advice ---------------------------------------------------------------------------------

REASONS = {value: name for name, value in vars(Reason).items() if name.startswith("DIVERGED")}


def recommended(message):
    """Return the options with a value that a message recommends, and not those that it blames."""
    return re.findall(r"(?<!but )-test_feti_(\w+) (\w+)", message)


@pytest.mark.serial
@pytest.mark.parametrize("method", ["cg", "gmres", "minres"])
@pytest.mark.parametrize("floor", [np.nan, 1e-2])
@pytest.mark.parametrize("reason", REASONS, ids=REASONS.values())
def test_no_remedy_is_in_force(reason, floor, method):
    """No message recommends an option that is set already."""
    texts = set()
    for values in itertools.product(*CHOICES.values()):
        options = FETIOptions(**dict(zip(CHOICES, values, strict=True)))
        for dual in {options.formulation != "primal", options.formulation == "dual"}:
            form = SimpleNamespace(
                pattern=SimpleNamespace(options=options),
                solves_indefinite=dual,
                method=method,
                name="dual" if dual else "primal",
                inertia=Inertia(local=0, defect=0, interior=0, assembled=0),
            )
            text = failure_message(reason, Accuracy(residual_floor=floor), form, "test_")
            texts.add(text)
            force = {"dual_ksp_type": method, "formulation": "dual" if dual else "primal"}
            for name, value in recommended(text):
                agree(force.get(name, getattr(options, name, None)) != value, (text, options))
                agree(name in force or value in CHOICES[name], text)
    agree(all(texts) and "feti_stagnation" not in " ".join(texts))


def test_advice_that_is_followed_is_not_repeated(torn_grid, create_ksp, monkeypatch):
    """Three iterations that bring nothing end a solve; options are worse than the defaults."""
    problem = torn_grid(stiffness=lambda i: 1e6 ** (i % 2), **MANY)
    options = {"pc_type": "identity", "scaling": "multiplicity", "coarse_q": "identity"}
    options["formulation"] = "dual"
    said = []
    monkeypatch.setattr("dolfinx_feti.feti.dual.krylov.STAGNATION_ITERATIONS", 3)
    monkeypatch.setattr("dolfinx_feti.feti.outer_loop.MAX_FRESH_STARTS", 0)
    while not said or (said[-1] and len(said) < 4):
        ksp = create_ksp(problem.A, **{f"feti_{name}": value for name, value in options.items()})
        solve(ksp, problem, random_values(problem))
        said.append(ksp.getPythonContext().message)
        if len(said) == 1:
            failed(ksp, Reason.DIVERGED_BREAKDOWN, "stagnates", "-test_feti_pc_type dirichlet")
            agree(0 < ksp.getIterationNumber() < 500)
        new = recommended(said[-1])
        if said[-1]:
            agree(new, said)
        agree(all(options[name] != value for name, value in new), said)
        options |= dict(new)
    agree(len(said) > 1 and said[-1] == "", said)


@pytest.mark.parametrize("pc_type", ["dirichlet", "lumped"])
def test_dual_solve_that_takes_too_long_names_the_primal_formulation(
    pc_type, torn_grid, create_ksp
):
    """And the preconditioner that goes with it; followed, it solves."""
    problem = torn_grid(stiffness=lambda i: 1e6 ** (i % 2), **MANY)
    options = {"formulation": "dual", "pc_type": pc_type, "coarse_q": "identity"}
    for most in (2, 10_000):
        own = {f"feti_{name}": value for name, value in options.items()}
        ksp = create_ksp(problem.A, ksp_max_it=most, **own)
        attempt(ksp, problem)
        said = ksp.getPythonContext().message
        new = dict(recommended(said))
        agree((most > 2) == (said == ""), said)
        expected = {"formulation": "primal"}
        if pc_type != "dirichlet":
            expected |= {"pc_type": "dirichlet"}
        if said:
            agree(new == expected, said)
        options |= new


UNFIT = [
    {"dual_ksp_type": "cg"},
    {"formulation": "dual"},
    {"pc_type": "lumped"},
    {"interior": "eliminate"},
    {"formulation": "dual", "pc_type": "identity", "interior": "eliminate"},
]


@pytest.mark.parametrize("options", UNFIT)
def test_unsymmetric_matrix_is_solved_as_its_message_says(options, torn_grid, create_ksp):
    problem = torn_grid(change=unsymmetric(0.02), **MANY)
    for _ in range(2):
        ksp = create_ksp(problem.A, **{f"feti_{name}": value for name, value in options.items()})
        reason, _ = solve(ksp, problem, random_values(problem))
        said = ksp.getPythonContext().message
        agree((reason > 0) == (options.get("formulation") == "primal" or said == ""), said)
        options = options | dict(recommended(said))
    agree(reason > 0, said)


@pytest.mark.parametrize("scaling", CHOICES["scaling"])
@pytest.mark.parametrize("modes", [0, 12])
@every_formulation
def test_advice_of_a_diagnosis_is_not_in_force(formulation, scaling, modes):
    """Whatever else is measured: a jump of the stiffness, and a large condition number.

    Soft modes have no effect in the primal formulation, whose adaptive columns take their place.
    """
    chosen = {"feti_scaling": scaling, "feti_coarse_modes": modes}
    chosen |= {"feti_formulation": formulation}
    found = torn(elasticity(cube(2, 8)), 2 * COMM.size, "test_", **chosen).diagnose()
    figures = replace(found.figures, stiffness_jump=1e9)
    report = replace(found.report, eigenvalues=(1.0, 1e9), floor=1e-5)
    said = advice.advise(figures, report, iterations=1000, prefix="test_")
    new = recommended(" ".join(piece.text for piece in said))
    agree(all(str(chosen[f"feti_{name}"]) != value for name, value in new), said)
    is_dual = formulation == "dual"
    agree((("formulation", "primal") in new) == is_dual, said)
    expected = []
    if scaling == "multiplicity":
        expected.append("scaling")
    if is_dual:
        expected.append("formulation")
    if is_dual and modes == 0:
        expected.append("coarse_modes")
    agree(sorted(name for name, _ in new) == sorted(expected), said)
    agree("residual that is rounding" in {piece.quantity for piece in said}, said)


def test_newtons_messages_name_no_option_but_the_limit_of_steps():
    texts = [CLOSER_START, SMALLER_LOAD_STEPS]
    for failure in FAILURES:
        texts += [failure.cause, failure.remedy]
    agree(re.findall(r"snes_\w+|feti_\w+|ksp_\w+", " ".join(texts)) == ["snes_max_it"], texts)
