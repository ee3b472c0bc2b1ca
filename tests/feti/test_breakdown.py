# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Failures are said: a negative converged reason and a remedy, never a silent wrong answer."""

from __future__ import annotations

import logging

from petsc4py import PETSc

import numpy as np
import pytest
from collective import COMM, agree, equal, raises
from hand_torn import random_values, softened, solve
from problems import cube, elasticity, owned, poisson

import dolfinx

import dolfinx_feti
from dolfinx_feti import FETI
from dolfinx_feti.feti.report import table

SEED = 6174
Reason = PETSc.KSP.ConvergedReason

GRID = {"subdomains": (2, 2), "cells": (3, 3), "components": 2}
WIDE = {**GRID, "subdomains": (3, 2)}


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
    values = random_values(problem, SEED + 1)
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


@pytest.mark.parametrize(
    "options",
    [{}, {"feti_formulation": "primal"}, {"feti_dual_ksp_type": "gmres", "feti_type": "classical"}],
    ids=["dual", "primal", "gmres"],
)
def test_tolerance_out_of_reach_ends_at_rounding(options, torn_grid, feti):
    """Not even refinement reaches a residual below rounding; what is reached is told."""
    problem = torn_grid(**GRID)
    ksp = feti(problem.A, ksp_rtol=0.0, ksp_atol=0.0, **options)
    values = random_values(problem, SEED)
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
    values = random_values(problem, SEED)
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
    monkeypatch.setattr("dolfinx_feti.feti.dual.krylov.STAGNATION", 3)
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
    problem = torn_grid(change=softened(0.3), **GRID)
    agree(np.linalg.eigvalsh(problem.free_matrix)[0] < 0.0)
    ksp = feti(problem.A, feti_type=kind, feti_dual_ksp_type="cg")
    attempt(ksp, problem)
    agree(
        ksp.getConvergedReason() in (Reason.DIVERGED_INDEFINITE_MAT, Reason.DIVERGED_INDEFINITE_PC),
        ksp.getConvergedReason(),
    )
    agree("-test_feti_dual_ksp_type gmres" in ksp.getPythonContext().message)
    ksp = feti(problem.A, feti_type=kind, ksp_rtol=1e-10)
    values = random_values(problem, SEED + 2)
    context, x = attempt(ksp, problem, values)
    agree(ksp.getConvergedReason() > 0, context.message)
    equal(x, problem.solve(values), 1e-7)


@pytest.mark.parametrize("kind", ["all_floating", "classical"])
@pytest.mark.parametrize(("share", "expected"), [(0.0, 0), (0.002, 0), (0.01, 1)])
def test_coarse_matrix_shows_what_is_indefinite(kind, share, expected, torn_grid, feti):
    """Not the subdomains that buckle alone; a solve may then be refused before it begins."""
    problem = torn_grid(change=softened(share), **GRID)
    agree(np.count_nonzero(np.linalg.eigvalsh(problem.free_matrix) < 0.0) == expected)
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
    problem = torn_grid((1, 1), (5, 5), components=2, change=softened(share))
    count = np.count_nonzero(np.linalg.eigvalsh(problem.free_matrix) < 0.0)
    ksp = feti(
        problem.A, FETI(refuse_indefinite=True), feti_type="classical", feti_interior=interior
    )
    context = ksp.getPythonContext()
    agree(context.inertia.assembled == count and (count > 0) == (share > 0.0), count)
    values = random_values(problem, SEED)
    _, x = attempt(ksp, problem, values)
    refused = ksp.getConvergedReason() == Reason.DIVERGED_INDEFINITE_MAT
    agree(refused == (count > 0))
    if not refused:
        equal(x, problem.solve(values), 1e-8)


def test_failure_is_logged_once(torn_grid, feti, caplog):
    problem = torn_grid(**GRID)
    ksp = feti(problem.A, ksp_max_it=1)
    with caplog.at_level(logging.WARNING, "dolfinx_feti"):
        attempt(ksp, problem)
    logged = [record.getMessage() for record in caplog.records]
    agree(len(logged) == (COMM.rank == 0), logged)
    agree(all("-test_ksp_max_it" in line for line in logged), logged)


# ---- the problem class ----------------------------------------------------------------------


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


# ---- what the coarse fields prove of the assembled matrix -----------------------------------


every_type = pytest.mark.parametrize("kind", ["all_floating", "classical"])
every_interior = pytest.mark.parametrize("interior", ["keep", "eliminate"])


@every_type
@every_interior
@pytest.mark.parametrize("share", [0.0, 0.002, 0.004, 0.01, 0.05, 0.2])
def test_what_is_proved_is_there(kind, interior, share, torn_grid, parts):
    """Never more negative eigenvalues than A has, and some wherever it has many."""
    problem = torn_grid(change=softened(share), **WIDE)
    there = np.count_nonzero(np.linalg.eigvalsh(problem.free_matrix) < 0.0)
    for pc_type in ("dirichlet", "lumped", "identity"):
        system = parts(problem.A, type=kind, interior=interior, pc_type=pc_type)
        proved = system.inertia.assembled
        if proved is None:  # K_II is factored for the Dirichlet preconditioner, or eliminated
            agree(interior == "keep" and pc_type != "dirichlet" and share > 0.0)
            continue
        agree(0 <= proved <= there, (proved, there))
        agree(proved > 0 or there <= 1 or pc_type != "dirichlet", (proved, there))
        agree(share > 0.0 or system.inertia.dual == 0)
