# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""FETI against a dense reference, and under prestress."""

import numpy as np
import pytest
from cases import case, each, every_type
from collective import agree, dense, equal, small, whole
from hand_torn import random_values, solve, solved

from dolfinx_feti.feti.dual.form import balanced_start, load, recover
from dolfinx_feti.feti.dual.krylov import solve as krylov_solve

SEED = 101013

GRIDS = {
    "Laplace in 1-D": case((5,), (3,)),
    "Laplace in 2-D": case((3, 2), (2, 3)),
    "Laplace in 3-D": case((2, 2, 2), (2, 2, 1)),
    "elasticity in 2-D": case((2, 3), (3, 2), 2),
    "elasticity in 3-D": case((2, 2, 1), (1, 2, 2), 3),
    "jumping stiffness": case((3, 2), (2, 2), 2, stiffness=lambda i: 20.0 ** (i % 2)),
    "component-wise conditions": case((2, 2), (2, 2), 2, fixed=lambda x: x == 0.0),
    "held in single nodes": case(
        (2, 2), (2, 2), 2, fixed=lambda x: np.isin(np.arange(len(x)), (0, len(x) - 1))
    ),
}
every_grid = each("grid", GRIDS)


def shifted(size):
    """Add ±X to the two sides of each interface: the assembled matrix stays as it is."""

    def change(K, dofs):
        rng = np.random.default_rng(SEED + 1)
        for i in range(len(K)):
            for j in range(i):
                common = np.intersect1d(dofs[i], dofs[j])
                if len(common) < 4:
                    continue
                half = rng.standard_normal((len(common), len(common)))
                X = size * np.abs(K[i]).max() * (half + half.T) / np.sqrt(len(common))
                for k, sign in ((i, 1.0), (j, -1.0)):
                    rows = np.searchsorted(dofs[k], common)
                    K[k][np.ix_(rows, rows)] += sign * X

    return change


@every_grid
@every_type
def test_multipliers_and_displacements_are_those_of_the_dense_reference(
    grid, kind, torn_grid, parts
):
    """Bᵀλ, which is unique, and u; B u = c and Gᵀλ = e."""
    problem = torn_grid(**grid)
    system = parts(problem.A, type=kind)
    torn, gluing = system.torn, system.pattern.gluing
    b = problem.vector(random_values(problem))
    u_D = np.where(torn.dirichlet, torn.tear(b.array_r), 0.0)
    f, c = load(system, b, u_D), gluing.gap(u_D)
    pair, rest = balanced_start(system, f, c)
    target = 1e-12 * b.norm()
    pair += krylov_solve(
        system.dual, rest, system.method, "", target=target, max_it=500, monitor=lambda *_: None
    )[0]
    lam = whole(system.dual.split(pair)[0])
    u = whole(np.where(system.pattern.dofs.fixed, u_D, recover(system, pair, f, c)))

    B, G = dense(gluing.B), dense(system.coarse.G)
    held = problem.dirichlet[problem.to_global]
    free = ~whole(system.pattern.dofs.fixed)
    K, C = problem.K_torn[np.ix_(free, free)], B[:, free]
    saddle = np.block([[K, C.T], [C, np.zeros(2 * [len(C)])]])  # K u + Bᵀ λ = f, B u = c
    expected = np.linalg.lstsq(saddle, np.concatenate([whole(f)[free], whole(c)]), rcond=1e-12)[0]
    equal(C.T @ lam, C.T @ expected[len(K) :], 1e-8)
    equal(u[free], expected[: len(K)], 1e-8)
    equal(u[held], (problem.T @ whole(b.array_r))[held], 1e-8)
    small(np.abs(B @ u - whole(c)).max(), 1e-8 * np.abs(u).max())
    equal(G.T @ lam, whole(system.coarse.restrict(f)), 1e-8)


@every_grid
@every_type
def test_solution_is_that_of_the_assembled_problem(grid, kind, torn_grid, feti):
    """And the residual that is reported is its own."""
    problem = torn_grid(**grid)
    values, free, K = random_values(problem), ~problem.dirichlet, problem.matrix
    ksp = feti(problem.A, feti_type=kind, ksp_rtol=1e-10)
    reason, x = solve(ksp, problem, values)
    agree(reason > 0, ksp.getPythonContext().message)
    equal(x, problem.solve(values), 1e-8)
    scale = np.linalg.norm((values - K @ np.where(free, 0.0, values))[free])
    residual = np.linalg.norm((values - K @ x)[free]) / scale
    small(residual, 1e-10)
    equal(ksp.getPythonContext().residual, residual, 1e-2 + 1e-14 / residual)


# ---- prestress ------------------------------------------------------------------------------


@every_type
@pytest.mark.parametrize("size", [1e-7, 1e-3, 0.1, 0.5])
@pytest.mark.parametrize("enriched", [True, False], ids=["enrich", "gmres"])
def test_prestress_is_solved_exactly(size, kind, enriched, torn_grid, feti, monkeypatch):
    """The modes leave the kernels, K_ρ turns indefinite, the assembled matrix does not notice."""
    grid = {"subdomains": (2, 2), "cells": (3, 3), "components": 2}
    plain, problem = torn_grid(**grid), torn_grid(**grid, change=shifted(size))
    values = random_values(problem)
    equal(problem.solve(values), plain.solve(values), 1e-10)
    if not enriched:
        monkeypatch.setattr("dolfinx_feti.feti.subdomain.pseudoinverse.ENRICHMENTS", 0)
    context = solved(feti(problem.A, feti_type=kind, ksp_rtol=1e-11), problem, values=values)
    report = context.report()
    agree(report.exact < 4, report)
    if size == 0.5:
        agree(report.inertia.dual > 0)
        # where K_ρ is positive definite, the primal form takes over
        agree(context.method == ("cg" if enriched else "gmres"))


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("size", [1e-8, 1e-2])
def test_interior_prestress_of_either_sign(sign, size, torn_grid, feti):
    """K symmetric with K R ≠ 0 in some subdomains: D ≠ 0, and the assembled problem is solved."""

    def change(K, dofs):
        rng = np.random.default_rng(SEED + 2)
        interior = slice(8, 10)  # the middle node of a 2 × 2 brick
        for i in (0, 2):
            half = rng.standard_normal((2, 2))
            K[i][interior, interior] += sign * size * np.abs(K[i]).max() * (half @ half.T)

    problem = torn_grid((2, 2), (2, 2), components=2, change=change)
    context = solved(feti(problem.A, ksp_rtol=1e-11), problem)
    report = context.report()
    agree(report.exact == 2, report.exact)
    agree((report.inertia.defect > 0) == (sign < 0), report.inertia)
    agree(context.method == "cg")
    agree(report.formulation == ("dual" if sign > 0 else "primal"))
