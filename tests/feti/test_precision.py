# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Factors of K_ρ in single precision: the same solutions, and double precision where it fails."""

from __future__ import annotations

from collections.abc import Callable

from petsc4py import PETSc

import numpy as np
import pytest
from collective import agree, equal
from hand_torn import HandTorn, random_values, solve
from walls import tube, wall

from dolfinx_feti.feti.report import table
from dolfinx_feti.feti.subdomain import dense

SINGLE = {"feti_precision": "single", "feti_formulation": "primal", "feti_interior": "eliminate"}
GRID = {"subdomains": (2, 2), "cells": (4, 3), "components": 2}
SIZE = 20


def block(diagonal: np.ndarray) -> dense.DenseFactors:
    """Factor one block with these eigenvalues, and store it in single precision if that does."""
    rng = np.random.default_rng(7)
    Q = np.linalg.qr(rng.standard_normal((len(diagonal), len(diagonal))))[0]
    factors = dense.DenseFactors([np.arange(len(diagonal), dtype=np.int32)])
    factors.set_block(0, dense.pack((Q * diagonal) @ Q.T))
    factors.update_block(0)
    factors.to_single(0)
    return factors


@pytest.fixture
def primal(torn_grid: Callable[..., HandTorn], feti: Callable[..., PETSc.KSP]) -> Callable:
    """Make a problem and a KSP with these options."""

    def create(**options: object) -> tuple[HandTorn, PETSc.KSP]:
        problem = torn_grid(**GRID)
        return problem, feti(problem.A, **{**SINGLE, "ksp_rtol": 1e-11, **options})

    return create


@pytest.mark.serial
@pytest.mark.parametrize("size", [1e-30, 1.0, 1e30])
def test_solves_to_single_precision_whatever_the_unit(size):
    eigenvalues = size * np.logspace(0, 3, SIZE)
    factors, y = block(eigenvalues), np.linspace(-1.0, 2.0, SIZE)
    S = factors.multiply_many(0, np.eye(SIZE))
    x = np.zeros(SIZE)
    factors.solve(y, x)
    assert factors.singles() == 1
    assert 0.0 < np.abs(S @ x - y).max() < 1e3 * np.finfo(np.float32).eps
    np.testing.assert_array_equal(factors.solve_many(0, np.column_stack([y, y]))[:, 1], x)
    many = np.outer(y, [1.0, 1e-20, 0.0, 3.0, -2.0, 1e20, 5.0, 7.0])  # these are unpacked
    error, largest = (np.abs(a).max(axis=0) for a in (S @ factors.solve_many(0, many) - many, many))
    assert np.all(error <= 1e3 * np.finfo(np.float32).eps * largest)
    factors.solve(np.zeros(SIZE), x)
    assert not x.any()


@pytest.mark.serial
def test_takes_half_the_memory_and_comes_back():
    factors = block(np.logspace(0, 2, SIZE))
    single = factors.memory()
    factors.to_double()
    assert factors.singles() == 0
    assert single == 0.75 * factors.memory()  # S itself stays what it is
    x, y = np.zeros(SIZE), np.ones(SIZE)
    factors.solve(y, x)
    S = factors.multiply_many(0, np.eye(SIZE))
    np.testing.assert_allclose(S @ x, y, rtol=1e-12)


@pytest.mark.serial
def test_ill_conditioned_block_stays_in_double_precision():
    diagonal = np.diag(np.logspace(-12, 0, SIZE))
    factors = dense.DenseFactors([np.arange(SIZE, dtype=np.int32)])
    factors.set_block(0, dense.pack(diagonal))
    factors.update_block(0)
    factors.to_single(0)
    x = np.zeros(SIZE)
    factors.solve(np.ones(SIZE), x)
    assert factors.singles() == 0
    np.testing.assert_allclose(diagonal @ x, 1.0, rtol=1e-12)


@pytest.mark.parametrize("kind", ["all_floating", "classical"])
def test_same_solution(kind, primal):
    problem, ksp = primal(feti_type=kind)
    values = random_values(problem)
    reason, x = solve(ksp, problem, values)
    context = ksp.getPythonContext()
    agree(reason > 0, context.message)
    equal(x, problem.solve(values), 1e-8)
    agree(context.single and context.report().singles == len(problem.K))
    agree("4 in single precision" in table(context.report()))


def test_turns_to_double_where_it_fails(primal, monkeypatch):
    """At once, and for all matrices that follow."""
    problem, ksp = primal()
    monkeypatch.setattr(dense._Block, "_solve_in_single", lambda self, y: np.full_like(y, np.nan))
    values = random_values(problem)
    reason, x = solve(ksp, problem, values)
    context = ksp.getPythonContext()
    agree(reason > 0, context.message)
    equal(x, problem.solve(values), 1e-8)
    agree(not context.single and "0 in single precision" in table(context.report()))
    problem.A.getISLocalMat().scale(2.0)
    problem.A.assemble()
    reason, x = solve(ksp, problem, values)
    agree(reason > 0 and not context.single)


@pytest.mark.parametrize(
    "options", [{"feti_formulation": "dual"}, {"feti_interior": "keep"}, {"feti_type": "classical"}]
)
def test_only_dense_factors_of_the_primal_form(options, primal):
    problem, ksp = primal(**options)
    values = random_values(problem)
    reason, x = solve(ksp, problem, values)
    agree(reason > 0, ksp.getPythonContext().message)
    equal(x, problem.solve(values), 1e-8)
    agree(ksp.getPythonContext().single == ("feti_type" in options))


def test_dual_form_of_an_indefinite_matrix(torn_grid, feti):
    """``auto`` goes over to it, with factors in double precision."""

    def change(K: list[np.ndarray], dofs: list[np.ndarray]) -> None:
        K[1] -= 0.002 * np.diag(K[1].diagonal())  # D of this subdomain gets negative eigenvalues
        K[2] *= -1.0

    problem = torn_grid(**GRID, change=change)
    ksp = feti(problem.A, ksp_rtol=1e-11, **SINGLE | {"feti_formulation": "auto"})
    values = random_values(problem)
    reason, x = solve(ksp, problem, values)
    report = ksp.getPythonContext().report()
    agree(reason > 0 and report.formulation == "dual" and report.singles == 0, report)
    equal(x, problem.solve(values), 1e-8)


def test_wall_under_pressure():
    """Newton's history tells, and u is the same."""
    ends = []
    for precision in ("double", "single"):
        body = wall(tube(), degree=1)
        problem = body.problem(4, {"snes_rtol": 1e-11, "feti_precision": precision})
        body.inflate(problem, [4.0])
        agree(all(step.single == (precision == "single") for step in problem.history))
        agree(all(step.linear_residual <= 1e-8 for step in problem.history))
        ends.append(body.u.x.array.copy())
    equal(ends[1], ends[0], 1e-9)
