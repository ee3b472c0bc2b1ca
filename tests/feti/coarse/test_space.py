# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The averaged coarse space: dense matrices, negative curvature, work that fails on a process."""

import numpy as np
import primal_form
import pytest
import scipy.linalg
from cases import case, every_interior, every_type
from collective import COMM, agree, dense, equal, small, whole
from hand_torn import softened

from dolfinx_feti.feti.coarse.space import AveragedSpace
from dolfinx_feti.runtime.petsc_options import inserted

SEED = 2003
PREFIX = "test_feti_coarse_"
GRID = case((3, 2), (3, 2), 2)


def random(n):
    return np.random.default_rng(SEED + COMM.rank).standard_normal(n)


@every_type
@every_interior
def test_galerkin_matrix_and_projection(kind, interior, torn_grid, form):
    """A₀ = Vᵀ A V in a basis of unit energy; Π V = 0 and Vᵀ A Π = 0."""
    problem = torn_grid(**GRID)
    primal = form(problem, type=kind, interior=interior, coarse_modes=2)
    exact = primal_form.reference(problem, primal)
    space, copies = primal.space, primal.copies
    basis = scipy.linalg.block_diag(*COMM.allgather(space.combinations.toarray()))
    equal(dense(space.A_0), basis.T @ exact.V.T @ exact.A @ exact.V @ basis, 1e-10)
    equal(dense(space.A_0).diagonal(), np.ones(space.A_0.getSize()[0]), 1e-12)
    v, zero = space.V.prolong(random(space.V.size)), np.zeros(copies.n)
    small(np.abs(space.correct(v, zero)).max(initial=0.0), 1e-9 * np.abs(whole(v)).max())
    z = space.correct(copies.average(random(copies.n)), zero)
    image = exact.V.T @ exact.A @ (exact.average @ whole(z))
    small(np.abs(image).max(), 1e-9 * np.abs(exact.A).max() * np.abs(whole(z)).max())
    r = copies.sum(random(copies.n))
    agree(np.array_equal(space.initial_guess(r), space.correct(zero, r)))
    start = exact.average @ whole(space.initial_guess(r))
    equal(exact.V.T @ exact.A @ start, exact.V.T @ (exact.average @ whole(r)), 1e-9)


def test_projection_in_single_precision(torn_grid, form, monkeypatch):
    """A V is stored in single precision; A₀ stays as it is."""
    problem = torn_grid(**GRID)
    double = form(problem, type="all_floating", interior="eliminate", coarse_modes=2)
    monkeypatch.undo()
    single = form(problem, type="all_floating", interior="eliminate", coarse_modes=2)
    agree(all(Y.dtype == np.float32 for Y in single.space.AV))
    equal(dense(single.space.A_0), dense(double.space.A_0), 1e-12)
    copies = double.copies
    z = copies.average(random(copies.n))
    r = copies.sum(random(copies.n))
    guesses = [form.space.initial_guess(r) for form in (single, double)]
    equal(*guesses, 1e-7)
    equal(single.space.correct(z, r), double.space.correct(z, r), 1e-6)


@pytest.fixture
def repeated(torn_grid, form):
    """A form, and the same with all columns twice, a hair's breadth apart, and a zero one."""
    problem = torn_grid(**GRID)
    plain = form(problem, type="all_floating", interior="eliminate", coarse_modes=2)

    def again(parts, copies):
        columns = []
        for U_i in plain.space.V.columns:
            noise = 1e-12 * np.random.default_rng(SEED).standard_normal(U_i.shape)
            columns.append(np.hstack([1e5 * (U_i + noise), 0.0 * U_i[:, :1]]))
        return columns

    twice = form(problem, again, type="all_floating", interior="eliminate", coarse_modes=2)
    return plain, twice


def test_dependent_columns_are_dropped(repeated):
    """Columns that come twice, zero ones and large ones do no harm."""
    plain, twice = repeated
    space = twice.space
    agree(space.total - space.A_0.getSize()[0] == plain.space.total + 6)
    agree(plain.space.A_0.getSize()[0] == plain.space.total and space.negative() == 0)
    z, zero = plain.copies.average(random(plain.copies.n)), np.zeros(plain.copies.n)
    equal(space.correct(z, zero), plain.space.correct(z, zero), 1e-7)


def test_columns_and_their_choice_serve_another_matrix(repeated):
    """V and its combinations with another S, here 2 S: the same projection, A₀ doubled."""
    _, twice = repeated
    space, copies = twice.space, twice.copies

    class Doubled:
        torn = twice.parts.operator.torn

        def multiply_panels(self, i, W, *, transpose):
            return 2.0 * twice.parts.operator.multiply_panels(i, W)

        def multiply_many(self, i, W):
            return 2.0 * twice.parts.operator.multiply_many(i, W)

    later = AveragedSpace(space.V, Doubled(), prefix=PREFIX, combinations=space.combinations)
    agree(later.A_0.getSize() == space.A_0.getSize() and later.V is space.V)
    equal(dense(later.A_0), 2.0 * dense(space.A_0), 1e-12)
    z, zero = copies.average(random(copies.n)), np.zeros(copies.n)
    equal(later.correct(z, zero), space.correct(z, zero), 1e-7)
    later.destroy()


@pytest.mark.parametrize("share", [0.0, 0.02], ids=["definite", "indefinite"])
def test_solver_that_does_not_count_pivots(share, torn_grid, form):
    """Then nothing is known before the iterations."""
    problem = torn_grid((2, 2), (4, 4), components=2, change=softened(share))
    with inserted(PREFIX, {"pc_factor_mat_solver_type": "petsc"}):
        primal = form(problem, type="classical", interior="eliminate", coarse_modes=0)
    agree(primal.space.negative() is None)
    agree(not primal.system.space.indefinite)
