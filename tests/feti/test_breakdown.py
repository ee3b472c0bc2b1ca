# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A failed solve has a negative converged reason and a remedy; no wrong answer is silent.

A message never recommends an option that is already set.
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
from hand_torn import random_values, softened, solve, solve_and_check, unsymmetric
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
SIX_SUBDOMAINS = case((3, 2), (3, 3), 2)
ONE_SUBDOMAIN = case((1, 1), (5, 5), 2)
NINE_SUBDOMAINS = case((3, 3), (2, 2), 2)
cg_and_gmres = pytest.mark.parametrize(
    "options", [{}, {"feti_dual_ksp_type": "gmres"}], ids=["cg", "gmres"]
)


def solve_once(ksp, problem, values=None):
    """Solve, whether it converges or not; return the FETI context and x, (dofs,)."""
    _, x = solve(ksp, problem, random_values(problem, SEED) if values is None else values)
    return ksp.getPythonContext(), x


def check_failed(ksp, reason, *words):
    """Assert that all processes see this reason and a message with these words."""
    message = ksp.getPythonContext().message
    agree(ksp.getConvergedReason() == reason, (ksp.getConvergedReason(), message))
    agree(all(word in message for word in words), message)


# ---- NaN and infinity -----------------------------------------------------------------------


@every_type
@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("where", ["diagonal", "everywhere"])
def test_nan_or_inf_in_the_matrix_fails_the_set_up(where, value, kind, torn_grid, create_ksp):
    """All processes fail, although one subdomain alone has the NaN."""

    def change(K, dofs):
        rows = len(K[1]) // 2 if where == "diagonal" else slice(None)
        K[1][rows, rows] = value

    problem = torn_grid(change=change, **GRID)
    ksp = create_ksp(problem.A, feti_type=kind)
    solve_once(ksp, problem)
    check_failed(ksp, Reason.DIVERGED_PCSETUP_FAILED, "NaN")


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("on_boundary", [False, True])
@cg_and_gmres
def test_nan_or_inf_in_the_load_fails_that_solve_only(
    value, on_boundary, options, torn_grid, create_ksp
):
    """The next load is solved as usual."""
    problem = torn_grid(**GRID)
    ksp = create_ksp(problem.A, **options)
    values = np.ones(len(problem.dirichlet))
    values[np.flatnonzero(problem.dirichlet == on_boundary)[3]] = value
    solve_once(ksp, problem, values)
    check_failed(ksp, Reason.DIVERGED_NANORINF, "NaN", "load")
    agree(solve_and_check(ksp, problem, 1e-6).message == "")


# ---- no convergence -------------------------------------------------------------------------


@cg_and_gmres
def test_iteration_limit_is_reported_and_logged_once(options, torn_grid, create_ksp, caplog):
    """The message names the option that raises the limit, and the first process logs it."""
    problem = torn_grid(**GRID)
    ksp = create_ksp(problem.A, ksp_max_it=3, **options)
    with caplog.at_level(logging.WARNING, "dolfinx_feti"):
        solve_once(ksp, problem)
    check_failed(ksp, Reason.DIVERGED_MAX_IT, "-test_ksp_max_it")
    agree(ksp.getIterationNumber() == 3)
    logged = [record.getMessage() for record in caplog.records]
    agree(len(logged) == (1 if COMM.rank == 0 else 0), logged)
    agree(all("-test_ksp_max_it" in line for line in logged), logged)


def residual_and_floor(problem, values, x):
    """Return ‖b − A x‖ and its floor, relative to ‖b − A x_D‖, all on the free dofs.

    The floor is 4 times the rounding error of the residual; x_D has the prescribed values alone.
    """
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
def test_unreachable_tolerance_ends_at_the_rounding_floor(options, torn_grid, create_ksp):
    """With zero tolerances a solve ends at the rounding errors of its residual.

    The report states the floor; after a solve that meets its tolerance there is none.
    """
    problem = torn_grid(**GRID)
    ksp = create_ksp(problem.A, ksp_rtol=0.0, ksp_atol=0.0, **options)
    values = random_values(problem, SEED)
    context, x = solve_once(ksp, problem, values)
    agree(ksp.getConvergedReason() == Reason.CONVERGED_HAPPY_BREAKDOWN and context.message == "")
    residual, floor = residual_and_floor(problem, values, x)
    equal(context.floor, floor, 1e-12)
    agree(max(context.residual, residual) <= floor < 1e-13, (context.residual, residual, floor))
    agree("at the floor of rounding" in format_report(context.report()))
    ksp.setTolerances(rtol=1e-8)
    solve_once(ksp, problem, values)
    agree(np.isnan(context.floor) and "rounding" not in format_report(context.report()))


@pytest.mark.parametrize("rtol", [1e-15, 1e-20])
def test_residual_above_rounding_is_not_converged(rtol, torn_grid, create_ksp, monkeypatch):
    """A solve that stagnates far above its rounding floor is a breakdown.

    The Krylov method is made to end early, and fresh starts are disabled.
    """
    monkeypatch.setattr("dolfinx_feti.feti.outer_loop.TARGET_FACTOR", 1e-11 / rtol)
    monkeypatch.setattr("dolfinx_feti.feti.outer_loop.MAX_FRESH_STARTS", 0)
    problem = torn_grid(**GRID)
    ksp = create_ksp(problem.A, ksp_rtol=rtol)
    values = random_values(problem, SEED)
    context, x = solve_once(ksp, problem, values)
    residual, floor = residual_and_floor(problem, values, x)
    agree(1e-11 > residual > 10 * floor and np.isnan(context.floor), (residual, floor))
    check_failed(ksp, Reason.DIVERGED_BREAKDOWN, "stagnates", f"{context.residual:.2e}")


def test_large_rounding_floor_is_a_failure(torn_grid, create_ksp, monkeypatch):
    """A solution is not accepted if rounding alone exceeds the allowed share of the load.

    The limit is lowered, so that every floor exceeds it.
    """
    monkeypatch.setattr("dolfinx_feti.feti.converged_reason.MAX_ROUNDING_SHARE", 1e-20)
    problem = torn_grid(**GRID)
    ksp = create_ksp(problem.A, ksp_rtol=1e-20)
    context, _ = solve_once(ksp, problem)
    check_failed(ksp, Reason.DIVERGED_BREAKDOWN, "rounding alone", "κ", f"{context.floor:.0e} ‖b‖")


# ---- wrong matrices -------------------------------------------------------------------------


def shift_first_subdomain(K, dofs):
    """Shift the matrix of the first subdomain so far that the assembled matrix is indefinite."""
    K[0] -= 0.3 * np.abs(K[0]).max() * np.eye(len(K[0]))


INDEFINITE = {
    "dual": (softened(0.3), {"feti_dual_ksp_type": "cg"}, "-test_feti_dual_ksp_type gmres"),
    "primal": (
        shift_first_subdomain,
        {"feti_formulation": "primal"},
        "-test_feti_formulation dual",
    ),
}


@every_type
@each(("change", "options", "remedy"), INDEFINITE)
def test_cg_refuses_an_indefinite_matrix_that_the_defaults_solve(
    change, options, remedy, kind, torn_grid, create_ksp, stops_at_negative_curvature
):
    """With CG set by option, or the primal form, the message names an option that solves."""
    problem = torn_grid(change=change, **GRID)
    agree(problem.n_negative > 0)
    ksp = create_ksp(problem.A, feti_type=kind, **options)
    solve_once(ksp, problem)
    indefinite = (Reason.DIVERGED_INDEFINITE_MAT, Reason.DIVERGED_INDEFINITE_PC)
    agree(ksp.getConvergedReason() in indefinite, ksp.getConvergedReason())
    agree(remedy in ksp.getPythonContext().message, ksp.getPythonContext().message)
    solve_and_check(create_ksp(problem.A, feti_type=kind, ksp_rtol=1e-10), problem, 1e-7)


@every_type
@every_interior
@pytest.mark.parametrize(
    ("grid", "share", "min_negative"),
    [
        (GRID, 0.0, 0),
        (GRID, 0.002, 0),
        (GRID, 0.01, 1),
        (ONE_SUBDOMAIN, 0.0, 0),
        (ONE_SUBDOMAIN, 0.05, 1),
        (ONE_SUBDOMAIN, 0.2, 1),
    ],
)
def test_indefinite_matrix_is_refused_before_iterating(
    kind, interior, grid, share, min_negative, torn_grid, create_ksp
):
    """The assembled matrix must be definite; single subdomains may buckle.

    With one subdomain there is no interface: FETI is a direct solver that counts pivots.
    """
    problem = torn_grid(change=softened(share), **grid)
    agree(problem.n_negative >= min_negative and (problem.n_negative > 0) == (min_negative > 0))
    options = {"feti_type": kind, "feti_interior": interior, "feti_deflation": 0}
    ksp = create_ksp(problem.A, FETI(refuse_indefinite=True), **options)
    context = ksp.getPythonContext()
    agree(context.inertia.assembled == problem.n_negative, context.inertia)
    if grid is not ONE_SUBDOMAIN:
        agree((context.inertia.dual > 0) == (share > 0.0))
    if min_negative == 0:
        solve_and_check(ksp, problem)
    else:
        solve_once(ksp, problem)
        check_failed(ksp, Reason.DIVERGED_INDEFINITE_MAT)
        agree(context.iterations == 0)


@every_type
@every_interior
@pytest.mark.parametrize("share", [0.0, 0.002, 0.004, 0.01, 0.05, 0.2])
def test_proved_negative_eigenvalues_are_at_most_those_of_the_matrix(
    kind, interior, share, torn_grid, create_dual
):
    """The inertia gives a lower bound, which is positive if A has several of them."""
    problem = torn_grid(change=softened(share), **SIX_SUBDOMAINS)
    negative = problem.n_negative
    for pc_type in ("dirichlet", "lumped", "identity"):
        system = create_dual(problem.A, type=kind, interior=interior, pc_type=pc_type)
        proved = system.inertia.assembled
        if proved is None:  # K_II is factored for the Dirichlet preconditioner, or eliminated
            agree(interior == "keep" and pc_type != "dirichlet" and share > 0.0)
            continue
        agree(0 <= proved <= negative)
        if negative > 1 and pc_type == "dirichlet":
            agree(proved > 0, negative)
        if share == 0.0:
            agree(system.inertia.dual == 0)


# ---- the problem class ----------------------------------------------------------------------


def test_nan_coefficient_raises_and_keeps_u():
    """A failed solve does not touch the user's function, and the next one succeeds."""
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


def recommended_options(message):
    """Return (name, value) of the options that a message recommends, without those it blames."""
    return re.findall(r"(?<!but )-test_feti_(\w+) (\w+)", message)


@pytest.mark.serial
@pytest.mark.parametrize("method", ["cg", "gmres", "minres"])
@pytest.mark.parametrize("floor", [np.nan, 1e-2])
@pytest.mark.parametrize("reason", REASONS, ids=REASONS.values())
def test_no_message_recommends_an_option_that_is_set(reason, floor, method):
    """This is checked for every converged reason and all combinations of options."""
    messages = set()
    for values in itertools.product(*CHOICES.values()):
        options = FETIOptions(**dict(zip(CHOICES, values, strict=True)))
        # The options "dual" and "primal" select one formulation, "auto" either of them.
        for dual in {options.formulation != "primal", options.formulation == "dual"}:
            form = SimpleNamespace(
                pattern=SimpleNamespace(options=options),
                solves_indefinite=dual,
                method=method,
                name="dual" if dual else "primal",
                inertia=Inertia(local=0, defect=0, interior=0, assembled=0),
            )
            message = failure_message(reason, Accuracy(residual_floor=floor), form, "test_")
            messages.add(message)
            in_force = {"dual_ksp_type": method, "formulation": "dual" if dual else "primal"}
            for name, value in recommended_options(message):
                agree(in_force.get(name, getattr(options, name, None)) != value, (message, options))
                agree(name in in_force or value in CHOICES[name], message)
    agree(all(messages) and "feti_stagnation" not in " ".join(messages))


def test_following_the_advice_leads_to_convergence(torn_grid, create_ksp, monkeypatch):
    """Each failure recommends other options than those that are set, until a solve converges.

    A solve counts as stagnating after three iterations; it begins with the worst options.
    """
    problem = torn_grid(stiffness=lambda i: 1e6 ** (i % 2), **NINE_SUBDOMAINS)
    options = {"pc_type": "identity", "scaling": "multiplicity", "coarse_q": "identity"}
    options["formulation"] = "dual"
    messages = []
    monkeypatch.setattr("dolfinx_feti.feti.dual.krylov.STAGNATION_ITERATIONS", 3)
    monkeypatch.setattr("dolfinx_feti.feti.outer_loop.MAX_FRESH_STARTS", 0)
    while not messages or (messages[-1] and len(messages) < 4):
        ksp = create_ksp(problem.A, **{f"feti_{name}": value for name, value in options.items()})
        solve(ksp, problem, random_values(problem))
        messages.append(ksp.getPythonContext().message)
        if len(messages) == 1:
            check_failed(
                ksp, Reason.DIVERGED_BREAKDOWN, "stagnates", "-test_feti_pc_type dirichlet"
            )
            agree(0 < ksp.getIterationNumber() < 500)
        recommended = recommended_options(messages[-1])
        if messages[-1]:
            agree(recommended, messages)
        agree(all(options[name] != value for name, value in recommended), messages)
        options |= dict(recommended)
    agree(len(messages) > 1 and messages[-1] == "", messages)


@pytest.mark.parametrize("pc_type", ["dirichlet", "lumped"])
def test_slow_dual_solve_recommends_the_primal_formulation(pc_type, torn_grid, create_ksp):
    """The message adds the preconditioner that it requires, and following it converges."""
    problem = torn_grid(stiffness=lambda i: 1e6 ** (i % 2), **NINE_SUBDOMAINS)
    options = {"formulation": "dual", "pc_type": pc_type, "coarse_q": "identity"}
    for max_it in (2, 10_000):
        prefixed = {f"feti_{name}": value for name, value in options.items()}
        ksp = create_ksp(problem.A, ksp_max_it=max_it, **prefixed)
        solve_once(ksp, problem)
        message = ksp.getPythonContext().message
        recommended = dict(recommended_options(message))
        agree((max_it > 2) == (message == ""), message)
        expected = {"formulation": "primal"}
        if pc_type != "dirichlet":
            expected |= {"pc_type": "dirichlet"}
        if message:
            agree(recommended == expected, message)
        options |= recommended


UNFIT_FOR_UNSYMMETRIC = [
    {"dual_ksp_type": "cg"},
    {"formulation": "dual"},
    {"pc_type": "lumped"},
    {"interior": "eliminate"},
    {"formulation": "dual", "pc_type": "identity", "interior": "eliminate"},
]


@pytest.mark.parametrize("options", UNFIT_FOR_UNSYMMETRIC)
def test_following_the_advice_solves_an_unsymmetric_matrix(options, torn_grid, create_ksp):
    """Options that only fit symmetric matrices fail with a message whose options converge."""
    problem = torn_grid(change=unsymmetric(0.02), **NINE_SUBDOMAINS)
    for _ in range(2):
        ksp = create_ksp(problem.A, **{f"feti_{name}": value for name, value in options.items()})
        reason, _ = solve(ksp, problem, random_values(problem))
        message = ksp.getPythonContext().message
        agree((reason > 0) == (options.get("formulation") == "primal" or message == ""), message)
        options = options | dict(recommended_options(message))
    agree(reason > 0, message)


@pytest.mark.parametrize("scaling", CHOICES["scaling"])
@pytest.mark.parametrize("modes", [0, 12])
@every_formulation
def test_diagnosis_recommends_only_options_that_are_not_set(formulation, scaling, modes):
    """The figures claim a jump of the stiffness and a large condition number.

    Soft modes have no effect in the primal formulation, whose adaptive columns replace them.
    """
    options = {"feti_scaling": scaling, "feti_coarse_modes": modes}
    options |= {"feti_formulation": formulation}
    diagnosis = torn(elasticity(cube(2, 8)), 2 * COMM.size, "test_", **options).diagnose()
    figures = replace(diagnosis.figures, stiffness_jump=1e9)
    report = replace(diagnosis.report, eigenvalues=(1.0, 1e9), floor=1e-5)
    advice_list = advice.advise(figures, report, iterations=1000, prefix="test_")
    recommendations = recommended_options(" ".join(piece.text for piece in advice_list))
    agree(
        all(str(options[f"feti_{name}"]) != value for name, value in recommendations), advice_list
    )
    is_dual = formulation == "dual"
    agree((("formulation", "primal") in recommendations) == is_dual, advice_list)
    expected = []
    if scaling == "multiplicity":
        expected.append("scaling")
    if is_dual:
        expected.append("formulation")
    if is_dual and modes == 0:
        expected.append("coarse_modes")
    agree(sorted(name for name, _ in recommendations) == sorted(expected), advice_list)
    agree("residual that is rounding" in {piece.quantity for piece in advice_list}, advice_list)


def test_newton_messages_name_no_option_but_the_step_limit():
    """No other option of SNES, KSP or FETI remedies a failure of Newton's method."""
    texts = [CLOSER_START, SMALLER_LOAD_STEPS]
    for failure in FAILURES:
        texts += [failure.cause, failure.remedy]
    agree(re.findall(r"snes_\w+|feti_\w+|ksp_\w+", " ".join(texts)) == ["snes_max_it"], texts)
