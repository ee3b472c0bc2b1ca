# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The averaged coarse space and the flux columns, against dense matrices."""

from __future__ import annotations

import itertools

import numpy as np
import primal_form
import pytest
import scipy.linalg
from collective import COMM, agree, dense, equal, small, whole
from hand_torn import gradients

from dolfinx_feti.feti.coarse.averaged import AveragedSpace, averaged_fields
from dolfinx_feti.feti.coarse.flux import flux_columns

SEED = 2003
GRID = {"subdomains": (3, 2), "cells": (3, 2), "components": 2}
every_type = pytest.mark.parametrize("kind", ["all_floating", "classical"])


@pytest.fixture
def form(parts):
    """Make the primal form of a problem, with options as keywords."""
    made = []

    def create(problem, more=None, **options):
        made.append(primal_form.create(parts(problem.A, **options), more))
        return made[-1]

    yield create
    for each in made:
        primal_form.destroy(each)


def random(n):
    return np.random.default_rng(SEED + COMM.rank).standard_normal(n)


@every_type
def test_fields(kind, torn_grid, form):
    """W = T V: on each subdomain its own columns and those of its neighbours, averaged."""
    problem = torn_grid(**GRID)
    primal = form(problem, type=kind, interior="eliminate", coarse_modes=2)
    exact = primal_form.reference(problem, primal)
    copies, start = primal.copies, COMM.scan(primal.copies.n) - primal.copies.n
    expected = exact.T @ exact.V
    worst = 0.0
    fields = averaged_fields(copies, primal.system.space.V.columns)
    for i, rows in enumerate(copies.blocks):
        W = np.zeros((rows.stop - rows.start, expected.shape[1]))
        W[:, fields.numbers[i]] = fields[i].dense()
        local = expected[start + rows.start : start + rows.stop]
        worst = max(worst, float(np.abs(W - local).max(initial=0.0)))
    small(worst, 1e-10 * np.abs(expected).max())


@every_type
@pytest.mark.parametrize("interior", ["keep", "eliminate"])
def test_galerkin_matrix_and_projection(kind, interior, torn_grid, form):
    """A₀ = Vᵀ A V in a basis of unit energy; Π V = 0 and Vᵀ A Π = 0."""
    problem = torn_grid(**GRID)
    primal = form(problem, type=kind, interior=interior, coarse_modes=2)
    exact = primal_form.reference(problem, primal)
    space, copies = primal.system.space, primal.copies
    basis = scipy.linalg.block_diag(*COMM.allgather(space._basis.toarray()))
    equal(dense(space.A_0), basis.T @ exact.V.T @ exact.A @ exact.V @ basis, 1e-10)
    equal(dense(space.A_0).diagonal(), np.ones(space.A_0.getSize()[0]), 1e-12)
    v, zero = space.V.prolong(random(space.V.size)), np.zeros(copies.n)
    small(np.abs(space.correct(v, zero)).max(initial=0.0), 1e-9 * np.abs(whole(v)).max())
    z = space.correct(copies.average(random(copies.n)), zero)
    image = exact.V.T @ exact.A @ (exact.average @ whole(z))
    small(np.abs(image).max(), 1e-9 * np.abs(exact.A).max() * np.abs(whole(z)).max())
    r = copies.sum(random(copies.n))
    agree(np.array_equal(space.start(r), space.correct(zero, r)))
    start = exact.average @ whole(space.start(r))
    equal(exact.V.T @ exact.A @ start, exact.V.T @ (exact.average @ whole(r)), 1e-9)


@pytest.fixture
def repeated(torn_grid, form):
    """A form, and the same with all columns twice, a hair's breadth apart, and a zero one."""
    problem = torn_grid(**GRID)
    plain = form(problem, type="all_floating", interior="eliminate", coarse_modes=2)

    def again(parts, copies):
        columns = []
        for U_i in plain.system.space.V.columns:
            noise = 1e-12 * np.random.default_rng(SEED).standard_normal(U_i.shape)
            columns.append(np.hstack([1e5 * (U_i + noise), 0.0 * U_i[:, :1]]))
        return columns

    twice = form(problem, again, type="all_floating", interior="eliminate", coarse_modes=2)
    return plain, twice


def test_dependent_columns_are_dropped(repeated):
    """Columns that come twice, zero ones and large ones do no harm."""
    plain, twice = repeated
    space = twice.system.space
    agree(space.dropped == plain.system.space.total + 6)
    agree(plain.system.space.dropped == 0 and space.negative() == 0)
    z, zero = plain.copies.average(random(plain.copies.n)), np.zeros(plain.copies.n)
    equal(space.correct(z, zero), plain.system.space.correct(z, zero), 1e-7)


def test_columns_and_their_choice_serve_another_matrix(repeated):
    """V and its combinations with another S, here 2 S: the same projection, A₀ doubled."""
    _, twice = repeated
    space, copies = twice.system.space, twice.copies

    class Doubled:
        def multiply_panels(self, i, W):
            return 2.0 * twice.parts.preconditioner.multiply_panels(i, W)

        def multiply_many(self, i, W):
            return 2.0 * twice.parts.preconditioner.multiply_many(i, W)

    later = AveragedSpace(
        space.V, Doubled(), prefix="test_feti_coarse_", combinations=space.combinations
    )
    agree(later.dropped == space.dropped > 0 and later.V is space.V)
    equal(dense(later.A_0), 2.0 * dense(space.A_0), 1e-12)
    z, zero = copies.average(random(copies.n)), np.zeros(copies.n)
    equal(later.correct(z, zero), space.correct(z, zero), 1e-7)
    later.destroy()


def volume_changes(cells):
    """K_p: ∫ div φ over each cell of a brick, and the monomials 1, x, y of the cells."""
    shape = [n + 1 for n in cells]
    number = np.arange(np.prod(shape)).reshape(shape)
    corners = np.array(list(itertools.product((0, 1), repeat=2)))
    mean = gradients(corners, np.full(2, 0.5))
    K_p = np.zeros((np.prod(cells), number.size, 2))
    corner = np.array(list(itertools.product(*map(range, cells))))
    for row, (i, j) in zip(K_p, corner, strict=True):
        row[number[i : i + 2, j : j + 2].ravel()] = mean
    patterns = np.column_stack([np.ones(len(corner)), corner - corner.mean(axis=0)])
    return K_p.reshape(len(K_p), -1), patterns


def flux_of(system, copies, K_p, patterns):
    """The patterns' flux, condensed to the interface, (n, patterns)."""
    g = np.tile(K_p.T @ patterns, (len(copies.blocks), 1))
    g[system.inverse.fixed] = 0.0
    return system.matrices.condense(g)[copies.dofs]


@every_type
def test_flux_columns(kind, torn_grid, form, monkeypatch):
    """They balance the flux, and a large κ costs fewer iterations."""
    monkeypatch.setattr("dolfinx_feti.feti.coarse.flux.DOFS", 4)
    cells = (4, 4)
    K_p, patterns = volume_changes(cells)
    iterations = {}
    for κ, with_flux in itertools.product((1e2, 1e6), (False, True)):

        def stiffen(K, dofs, κ=κ):
            for K_i in K:
                K_i += κ * K_p.T @ K_p

        def columns(system, copies):
            g = flux_of(system, copies, K_p, patterns)
            return flux_columns(copies, g, system.inverse.solve_many)

        problem = torn_grid((4, 3), cells, components=2, change=stiffen)
        more = columns if with_flux else None
        primal = form(problem, more, type=kind, interior="eliminate", coarse_modes=0)
        copies, system = primal.copies, primal.system
        last = COMM.scan(copies.n)
        values = np.random.default_rng(SEED).standard_normal(COMM.allreduce(copies.n))
        f = values[last - copies.n : last]
        outcome = primal_form.cg(system, f)
        agree(outcome.reason > 0)
        iterations[κ, with_flux] = outcome.iterations
        r = system.residual(f, primal_form.cg(system, f, max_it=2).x)
        w = system.solve(copies.delta * r)
        c = (1.0 - copies.delta)[:, None] * flux_of(primal.parts, copies, K_p, patterns)
        size = np.linalg.norm(c, axis=0) * np.linalg.norm(w)
        flow = [np.abs(c[rows].T @ w[rows]) / size for rows in copies.blocks]
        most = max(COMM.allgather(np.max(flow, initial=0.0)))
        agree(most <= 1e-7 if with_flux else most > 1e-4)
    agree(iterations[1e2, True] < iterations[1e2, False], iterations)
    agree(iterations[1e6, False] >= 1.3 * iterations[1e6, True], iterations)


def test_small_subdomains_have_few_flux_columns(torn_grid, form):
    """That share of them which they have of 640 interface dofs, and one at least."""
    problem = torn_grid((2, 1), (9, 3), components=2)
    copies = form(problem, type="all_floating", interior="eliminate").copies
    sizes = [rows.stop - rows.start for rows in copies.blocks]
    for dofs, patterns in ((190, 3), (60, 3), (20, 3), (1, 3), (20, 0)):
        g = np.random.default_rng(SEED).standard_normal((copies.n, patterns))
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("dolfinx_feti.feti.coarse.flux.DOFS", dofs)
            columns = flux_columns(copies, g, lambda i, c: c)
        most = [min(patterns, max(1, patterns * n // dofs)) for n in sizes]
        agree([U.shape[1] for U in columns] == most, (dofs, sizes))
