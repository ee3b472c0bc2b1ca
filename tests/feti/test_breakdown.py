# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Failures are said: a negative converged reason and a remedy, never a silent wrong answer."""

from __future__ import annotations

import logging

from petsc4py import PETSc

import numpy as np
import pytest
from collective import agree, equal, raises, whole
from problems import cube, elasticity, owned, poisson

import dolfinx
import ufl

import dolfinx_feti
from dolfinx_feti import FETI
from dolfinx_feti.feti.report import table

SEED = 6174
Reason = PETSc.KSP.ConvergedReason

GRID = {"subdomains": (2, 2), "cells": (3, 3), "components": 2}


def attempt(ksp, problem, values=None):
    """Solve; return the context and x."""
    if values is None:
        values = np.random.default_rng(SEED).standard_normal(len(problem.dirichlet))
    x = problem.A.createVecRight()
    ksp.solve(problem.vector(values), x)
    return ksp.getPythonContext(), whole(x.array_r)


def failed(ksp, reason, *words):
    """Assert that all processes see this reason and a message with these words."""
    message = ksp.getPythonContext().message
    agree(ksp.getConvergedReason() == reason, (ksp.getConvergedReason(), message))
    agree(all(word in message for word in words), message)


def indefinite(K, dofs):
    """Shift K so that the assembled matrix gets negative eigenvalues."""
    for K_i in K:
        K_i -= 0.3 * np.abs(K_i).max() * np.eye(len(K_i))


# ---- numbers that are none ------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["all_floating", "classical"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("where", ["diagonal", "everywhere"])
def test_nan_in_the_matrix(where, value, kind, torn_grid, feti):
    def change(K, dofs):
        rows = len(K[1]) // 2 if where == "diagonal" else slice(None)
        K[1][rows, rows] = value

    problem = torn_grid(change=change, **GRID)
    ksp = feti(problem.A, feti_type=kind)
    attempt(ksp, problem)
    failed(ksp, Reason.DIVERGED_PCSETUP_FAILED, "NaN")


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("on_boundary", [False, True])
@pytest.mark.parametrize("options", [{}, {"feti_dual_ksp_type": "gmres"}], ids=["cg", "gmres"])
def test_nan_in_the_load(value, on_boundary, options, torn_grid, feti):
    problem = torn_grid(**GRID)
    ksp = feti(problem.A, **options)
    values = np.ones(len(problem.dirichlet))
    values[np.flatnonzero(problem.dirichlet == on_boundary)[3]] = value
    attempt(ksp, problem, values)
    failed(ksp, Reason.DIVERGED_NANORINF, "NaN", "load")


def test_solver_works_again_after_a_failure(torn_grid, feti):
    problem = torn_grid(**GRID)
    ksp = feti(problem.A)
    values = np.random.default_rng(SEED + 1).standard_normal(len(problem.dirichlet))
    attempt(ksp, problem, np.full(len(values), np.nan))
    agree(ksp.getConvergedReason() < 0)
    context, x = attempt(ksp, problem, values)
    agree(ksp.getConvergedReason() > 0 and context.message == "", context.message)
    equal(x, problem.solve(values), 1e-6)
    problem.local.scale(np.nan)
    attempt(ksp, problem, values)
    failed(ksp, Reason.DIVERGED_PCSETUP_FAILED, "NaN")


# ---- no convergence -------------------------------------------------------------------------


@pytest.mark.parametrize("options", [{}, {"feti_dual_ksp_type": "gmres"}], ids=["cg", "gmres"])
def test_maximum_of_iterations(options, torn_grid, feti):
    problem = torn_grid(**GRID)
    ksp = feti(problem.A, ksp_max_it=3, **options)
    attempt(ksp, problem)
    failed(ksp, Reason.DIVERGED_MAX_IT, "-test_ksp_max_it")
    agree(ksp.getIterationNumber() == 3)


def shares(problem, values, x):
    """Return ‖b − A x‖/‖b − A x_D‖ on the free dofs, and that of 4 times its rounding errors."""
    K, free = problem.T.T @ problem.K_torn @ problem.T, ~problem.dirichlet
    scale = np.linalg.norm((values - K @ np.where(free, 0.0, values))[free])
    squares = values**2 + problem.T.T @ (problem.K_torn**2 @ (problem.T @ x) ** 2)
    rounding = np.finfo(float).eps * np.sqrt(squares[free].sum())
    return np.linalg.norm((values - K @ x)[free]) / scale, 4.0 * rounding / scale


@pytest.mark.parametrize("options", [{}, {"feti_formulation": "primal"}], ids=["dual", "primal"])
def test_tolerance_out_of_reach_ends_at_rounding(options, torn_grid, feti):
    """Not even refinement reaches a residual below rounding; what is reached is told."""
    problem = torn_grid(**GRID)
    ksp = feti(problem.A, ksp_rtol=1e-20, **options)
    values = np.random.default_rng(SEED).standard_normal(len(problem.dirichlet))
    context, x = attempt(ksp, problem, values)
    agree(ksp.getConvergedReason() == Reason.CONVERGED_HAPPY_BREAKDOWN and context.message == "")
    residual, floor = shares(problem, values, x)
    equal(context.floor, floor, 1e-12)
    agree(max(context.residual, residual) <= floor < 1e-13, (context.residual, residual, floor))
    agree("at the floor of rounding" in table(context.report()))
    ksp.setTolerances(rtol=1e-8)
    attempt(ksp, problem, values)
    agree(np.isnan(context.floor) and "rounding" not in table(context.report()))


@pytest.mark.parametrize("rtol", [1e-15, 1e-20])
def test_residual_above_rounding_is_not_converged(rtol, torn_grid, feti, monkeypatch):
    """A Krylov method that ends far above its tolerance, on purpose, and no fresh start."""
    monkeypatch.setattr("dolfinx_feti.feti.solver.AIM", 1e-11 / rtol)
    monkeypatch.setattr("dolfinx_feti.feti.solver.RESTARTS", 0)
    problem = torn_grid(**GRID)
    ksp = feti(problem.A, ksp_rtol=rtol)
    values = np.random.default_rng(SEED).standard_normal(len(problem.dirichlet))
    context, x = attempt(ksp, problem, values)
    residual, floor = shares(problem, values, x)
    agree(1e-11 > residual > 10 * floor and np.isnan(context.floor), (residual, floor))
    failed(ksp, Reason.DIVERGED_BREAKDOWN, "stagnates", f"{context.residual:.2e}")


def test_rounding_that_leaves_a_doubt_is_a_failure(torn_grid, feti, monkeypatch):
    """Here of every solution that rounding touches."""
    monkeypatch.setattr("dolfinx_feti.feti.solver.DOUBTFUL", 1e-20)
    problem = torn_grid(**GRID)
    ksp = feti(problem.A, ksp_rtol=1e-20)
    context, _ = attempt(ksp, problem)
    failed(ksp, Reason.DIVERGED_BREAKDOWN, "rounding alone", "κ", f"{context.floor:.0e} ‖b‖")


def test_stagnation_ends_the_solve(torn_grid, feti, monkeypatch):
    """With stiffness jumping by 10⁶, three iterations bring nothing; no fresh start follows."""
    monkeypatch.setattr("dolfinx_feti.feti.dual.stopping.STAGNATION", 3)
    monkeypatch.setattr("dolfinx_feti.feti.solver.RESTARTS", 0)
    problem = torn_grid((3, 3), (2, 2), components=2, stiffness=lambda i: 1e6 ** (i % 2))
    ksp = feti(problem.A, feti_pc_type="identity", feti_scaling="multiplicity")
    context, _ = attempt(ksp, problem)
    failed(ksp, Reason.DIVERGED_BREAKDOWN, "stagnates", "-test_feti_pc_type dirichlet")
    agree(0 < context.iterations < 500)


# ---- wrong matrices -------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["all_floating", "classical"])
def test_negative_curvature_in_cg(kind, torn_grid, feti):
    """An indefinite assembled matrix, and CG asked for; left alone, GMRES solves it."""
    problem = torn_grid(change=indefinite, **GRID)
    K = problem.T.T @ problem.K_torn @ problem.T
    free = ~problem.dirichlet
    agree(np.linalg.eigvalsh(K[np.ix_(free, free)])[0] < 0.0)
    ksp = feti(problem.A, feti_type=kind, feti_dual_ksp_type="cg")
    attempt(ksp, problem)
    agree(
        ksp.getConvergedReason() in (Reason.DIVERGED_INDEFINITE_MAT, Reason.DIVERGED_INDEFINITE_PC),
        ksp.getConvergedReason(),
    )
    agree("-test_feti_dual_ksp_type gmres" in ksp.getPythonContext().message)
    ksp = feti(problem.A, feti_type=kind, ksp_rtol=1e-10)
    values = np.random.default_rng(SEED + 2).standard_normal(len(problem.dirichlet))
    context, x = attempt(ksp, problem, values)
    agree(ksp.getConvergedReason() > 0, context.message)
    equal(x, problem.solve(values), 1e-7)


@pytest.mark.parametrize("kind", ["all_floating", "classical"])
@pytest.mark.parametrize(("share", "expected"), [(0.0, 0), (0.002, 0), (0.01, 1)])
def test_coarse_matrix_shows_what_is_indefinite(kind, share, expected, torn_grid, feti):
    """Not the subdomains that buckle alone; a solve may then be refused before it begins."""

    def soften(K, dofs):
        for K_i in K:
            K_i -= share * np.abs(K_i).max() * np.eye(len(K_i))

    problem = torn_grid(change=soften, **GRID)
    K, free = problem.T.T @ problem.K_torn @ problem.T, ~problem.dirichlet
    agree(np.count_nonzero(np.linalg.eigvalsh(K[np.ix_(free, free)]) < 0.0) == expected)
    ksp = feti(problem.A, FETI(refuse_indefinite=True), feti_type=kind, feti_deflation=0)
    context = ksp.getPythonContext()
    agree((context.inertia.dual > 0) == (share > 0.0) and context.inertia.assembled == expected)
    attempt(ksp, problem)
    refused = ksp.getConvergedReason() == Reason.DIVERGED_INDEFINITE_MAT
    agree(refused == (expected > 0) and (context.iterations == 0) == refused)


@pytest.mark.parametrize("interior", ["keep", "eliminate"])
@pytest.mark.parametrize("share", [0.0, 0.05, 0.2])
def test_one_subdomain_knows_its_inertia(share, interior, torn_grid, feti):
    """Without interface all is interior, and FETI a direct solver that counts."""

    def soften(K, dofs):
        K[0] -= share * np.abs(K[0]).max() * np.eye(len(K[0]))

    problem = torn_grid((1, 1), (5, 5), components=2, change=soften)
    K, free = problem.K_torn, ~problem.dirichlet[problem.to_global]
    count = np.count_nonzero(np.linalg.eigvalsh(K[np.ix_(free, free)]) < 0.0)
    ksp = feti(
        problem.A, FETI(refuse_indefinite=True), feti_type="classical", feti_interior=interior
    )
    context = ksp.getPythonContext()
    agree(context.inertia.assembled == count and (count > 0) == (share > 0.0), count)
    values = np.random.default_rng(SEED).standard_normal(len(problem.dirichlet))
    _, x = attempt(ksp, problem, values)
    refused = ksp.getConvergedReason() == Reason.DIVERGED_INDEFINITE_MAT
    agree(refused == (count > 0))
    if not refused:
        equal(x, problem.solve(values), 1e-8)


def test_unsymmetric_matrix_with_cg(torn_grid, feti):
    """CG on an unsymmetric matrix is refused, on all processes."""

    def change(K, dofs):
        K[-1] += 0.1 * np.triu(K[-1], 1)

    problem = torn_grid(change=change, **GRID)
    ksp = feti(problem.A, feti_dual_ksp_type="cg")
    attempt(ksp, problem)
    agree(ksp.getConvergedReason() < 0)
    agree("gmres" in ksp.getPythonContext().message, ksp.getPythonContext().message)


@pytest.mark.parametrize("kind", ["all_floating", "classical"])
@pytest.mark.parametrize(("dim", "components", "kernel"), [(1, 1, 1), (2, 2, 3), (3, 3, 6)])
def test_no_dirichlet_condition_at_all(dim, components, kernel, kind, torn_grid, feti):
    problem = torn_grid(
        (2,) * dim,
        (2,) * dim,
        components=components,
        fixed=lambda x: np.zeros(len(x), dtype=bool),
    )
    ksp = feti(problem.A, feti_type=kind)
    attempt(ksp, problem)
    failed(
        ksp,
        Reason.DIVERGED_PCSETUP_FAILED,
        "singular",
        f"dimension {kernel}",
        "Dirichlet conditions",
    )


@pytest.mark.parametrize("kind", ["all_floating", "classical"])
def test_body_that_is_not_held_in_all_directions(kind, torn_grid, feti):
    """Only u_x is prescribed on one side: it can still slide."""
    problem = torn_grid(fixed=lambda x: (x == 0.0) * np.array([1, 0]), **GRID)
    ksp = feti(problem.A, feti_type=kind)
    attempt(ksp, problem)
    failed(ksp, Reason.DIVERGED_PCSETUP_FAILED, "dimension 1")


def test_failure_is_logged_once(torn_grid, feti, caplog):
    problem = torn_grid(**GRID)
    ksp = feti(problem.A, ksp_max_it=1)
    with caplog.at_level(logging.WARNING, "dolfinx_feti"):
        attempt(ksp, problem)
    logged = [record.getMessage() for record in caplog.records]
    from mpi4py import MPI

    agree(len(logged) == (MPI.COMM_WORLD.rank == 0), logged)
    agree(all("-test_ksp_max_it" in line for line in logged), logged)


# ---- the problem class ----------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["all_floating", "classical"])
@pytest.mark.parametrize(
    ("create", "dim", "kernel"), [(poisson, 2, 1), (elasticity, 2, 3), (elasticity, 3, 6)]
)
def test_singular_problem_raises(create, dim, kernel, kind, solve):
    problem = create(cube(dim, 3), clamped=None)
    with raises(dolfinx_feti.ConvergenceError, f"singular, with a kernel of dimension {kernel}"):
        solve(problem, 6, {"feti_type": kind})


@pytest.mark.parametrize("kind", ["all_floating", "classical"])
def test_loose_part_of_the_mesh_raises(kind, solve):
    """The right half is a body of its own, without a Dirichlet condition."""
    mesh = cube(2, 4)
    middle = dolfinx.mesh.locate_entities(mesh, 2, lambda x: (x[0] > 0.24) & (x[0] < 0.76))
    keep = np.setdiff1d(np.arange(count(mesh)), middle)
    parts = dolfinx.mesh.create_submesh(mesh, 2, keep.astype(np.int32))[0]
    problem = elasticity(parts)
    with raises(dolfinx_feti.ConvergenceError, "kernel of dimension 3.*not connected"):
        solve(problem, 4, {"feti_type": kind})


def count(mesh):
    index_map = mesh.topology.index_map(mesh.topology.dim)
    return index_map.size_local + index_map.num_ghosts


def test_nan_coefficient_raises_and_leaves_u(solve):
    problem = poisson(cube(2, 4))
    factor = dolfinx.fem.Constant(problem.V.mesh, np.nan)
    u = dolfinx.fem.Function(problem.V)
    u.x.array[:] = 7.0
    linear = dolfinx_feti.LinearProblem(
        factor * problem.a, problem.L, bcs=problem.bcs, u=u, subdomains=4, petsc_options_prefix="t_"
    )
    with raises(dolfinx_feti.ConvergenceError, "NaN"):
        linear.solve()
    equal(owned(u), np.full(len(owned(u)), 7.0))
    factor.value = 2.0
    linear.solve()
    agree(linear.solver.getConvergedReason() > 0)


def test_nan_load_raises(solve):
    problem = poisson(cube(2, 4))
    factor = dolfinx.fem.Constant(problem.V.mesh, np.nan)
    bad = type(problem)(problem.V, problem.a, factor * problem.L, problem.bcs)
    with raises(dolfinx_feti.ConvergenceError, "NaN"):
        solve(bad, 4)


def test_iterations_run_out_raises(solve):
    with raises(dolfinx_feti.ConvergenceError, "-test_ksp_max_it"):
        solve(elasticity(cube(2, 4)), 6, {"ksp_max_it": 2})


def test_indefinite_form_is_solved_or_said(solve):
    """The Helmholtz equation beyond its first eigenvalue: GMRES finds the solution."""
    problem = poisson(cube(2, 8))
    u, v = ufl.TrialFunction(problem.V), ufl.TestFunction(problem.V)
    wave = type(problem)(problem.V, problem.a - 40.0 * u * v * ufl.dx, problem.L, problem.bcs)
    linear = solve(wave, 6, {"ksp_rtol": 1e-10})
    equal(owned(linear.u), wave.solve_directly(), 1e-7)
    with raises(dolfinx_feti.ConvergenceError, "feti_dual_ksp_type gmres"):
        solve(wave, 6, {"feti_dual_ksp_type": "cg"})
