# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Recycled directions: their algebra, and what they save along a sequence of matrices."""

from __future__ import annotations

import numpy as np
import pytest
from collective import COMM, agree, dense, equal, norm, raises, small, whole
from mixed import by_place
from walls import tube, wall

from dolfinx_feti.errors import SetUpError
from dolfinx_feti.feti.krylov.dual import DualSystem
from dolfinx_feti.feti.krylov.recycling import DeflatedSystem
from dolfinx_feti.feti.options import FETIOptions
from dolfinx_feti.feti.setup import Pattern

SEED = 8121

CHANGES = {
    "no prestress": None,
    "prestress": lambda K, dofs: [np.fill_diagonal(k, 1.01 * k.diagonal()) for k in K],
    "compression": lambda K, dofs: [np.fill_diagonal(k, 0.9995 * k.diagonal()) for k in K],
}
every_change = pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
every_interior = pytest.mark.parametrize("interior", ["keep", "eliminate"])


def block_of(system, r):
    """Random multipliers, (m, r), the same on any number of processes."""
    B = system.gluing.B
    columns = np.random.default_rng(SEED).standard_normal((B.getSize()[0], r))
    return columns[slice(*B.getOwnershipRange())]


def balance_of(system, pairs):
    """Gᵀ Λ + D S, (K, r), on all processes."""
    G, D = dense(system.coarse.G_left), dense(system.coarse.D)
    lam, s = system.dual.split(pairs)
    return G.T @ whole(lam) + D @ whole(s)


def load(problem, seed=SEED):
    values = np.random.default_rng(seed).standard_normal(len(problem.dirichlet))
    return values, problem.vector(values)


@every_change
@every_interior
@pytest.mark.parametrize("kind", ["all_floating", "classical"])
def test_blocks_are_their_columns(change, interior, kind, torn_grid, parts):
    """Balanced pairs obey Gᵀ Λ + D S = 0, and a block of them has the jumps of its columns."""
    problem = torn_grid((2, 2), (2, 3), components=2, change=change)
    system = parts(problem.A, type=kind, interior=interior)
    lam = block_of(system, 3)
    pairs = system.dual.balance(lam)
    scale = max(np.abs(system.coarse.G.norm()), np.abs(system.coarse.D.norm()))
    small(np.abs(balance_of(system, pairs)).max(), 1e-11 * scale * max(1.0, np.abs(pairs).max()))
    again = system.dual.balance(pairs[: len(lam)])
    if change is None:  # a projection: what is balanced stays
        equal(whole(again), whole(pairs), 1e-9)
    jumps = system.dual.jump(pairs)
    for pair, jump in zip(pairs.T, jumps.T, strict=True):
        equal(whole(jump), whole(system.dual.jump(pair)), 1e-9)


@every_change
@pytest.mark.parametrize("options", [{}, {"feti_dual_ksp_type": "gmres"}], ids=["own", "gmres"])
def test_deflation(change, options, torn_grid, feti):
    """Wᵀ b = 0 after the start, and (𝒜 W)ᵀ z = 0 after the preconditioner."""
    problem = torn_grid((3, 3), (3, 3), components=2, change=change)
    ksp = feti(problem.A, feti_recycle=7, **options)
    _, b = load(problem)
    ksp.solve(b, b.duplicate())
    agree(ksp.getConvergedReason() > 0, ksp.getPythonContext().message)
    context = ksp.getPythonContext()
    system = DeflatedSystem(context._form.dual, context._directions, most=7)
    agree(system.count in (6, 7), system.count)  # one less where C is indefinite on one
    m = len(system.AW)
    r = np.concatenate([block_of(context._form, 1)[:, 0], np.zeros(system.size - m)])
    x, rest = system.start(r)
    bound = 1e-9 * norm(r) * np.abs(system.W).max()
    small(np.abs(COMM.allreduce(system.W[:m].T @ rest[:m])).max(), bound)
    agree(x.shape == rest.shape == r.shape)
    z, _ = system.precondition(rest)
    lengths = np.sqrt(COMM.allreduce((system.AW**2).sum(axis=0)))
    overlap = np.abs(COMM.allreduce(system.AW.T @ z[:m])) / lengths
    small(overlap.max(), 1e-8 * max(norm(z), 1.0))


@pytest.mark.parametrize("method", ["cg", "fcg", "gmres", "fgmres", "minres"])
def test_a_solve_leaves_its_solution(method, torn_grid, feti):
    """With room for all directions the same load once more takes next to no iterations."""
    problem = torn_grid((3, 3), (3, 3), components=2)
    ksp = feti(problem.A, feti_recycle=200, feti_dual_ksp_type=method)
    values, b = load(problem)
    x, iterations = b.duplicate(), []
    for _ in range(3):
        ksp.solve(b, x)
        agree(ksp.getConvergedReason() > 0, ksp.getPythonContext().message)
        iterations.append(ksp.getPythonContext().iterations)
        equal(whole(x.array_r), problem.solve(values), 1e-7)
    agree(iterations[0] >= 5 and max(iterations[1:]) <= 2, iterations)


@every_change
def test_other_loads_and_matrices_take_fewer_iterations(change, torn_grid, feti):
    """The answer is that of a direct solver; a matrix that changes a little saves as many."""
    counts = {}
    for recycle in (0, 60):
        problem = torn_grid(
            (4, 4), (4, 4), components=2, change=change, stiffness=lambda i: 1e2 ** (i % 2)
        )
        options = {"feti_scaling": "multiplicity", "feti_coarse_modes": 0}  # iterations to save
        ksp = feti(problem.A, feti_recycle=recycle, **options)
        for step in range(4):
            values, b = load(problem, SEED + step)
            x = b.duplicate()
            ksp.solve(b, x)
            agree(ksp.getConvergedReason() > 0, ksp.getPythonContext().message)
            counts.setdefault(recycle, []).append(ksp.getPythonContext().iterations)
            equal(whole(x.array_r), problem.solve(values), 1e-6)
            for K in problem.K:
                K *= 1.0 + 0.02 * step
            problem.local.scale(1.0 + 0.02 * step)
            problem.A.stateIncrease()
    agree(counts[0][0] == counts[60][0], counts)
    agree(sum(counts[60][1:]) <= 0.7 * sum(counts[0][1:]), counts)


def test_no_more_directions_than_asked_for(torn_grid, feti):
    """And none by default; -ksp_view tells how many."""
    problem = torn_grid((3, 3), (3, 3), components=2)
    for recycle in (0, 1, 5):
        ksp = feti(problem.A, feti_recycle=recycle)
        _, b = load(problem)
        for step in range(3):
            ksp.solve(b, b.duplicate())
            report = ksp.getPythonContext().report()
            agree(report.recycled == (recycle if step else 0), report)


@pytest.mark.parametrize("method", ["cg", "gmres"])
def test_a_solve_that_failed_leaves_nothing_bad(method, torn_grid, feti):
    """Not a NaN, no direction of length zero; later solves are as good as ever."""
    problem = torn_grid((3, 3), (3, 3), components=2)
    ksp = feti(problem.A, feti_recycle=9, feti_dual_ksp_type=method)
    context = ksp.getPythonContext()
    values, b = load(problem)
    x = b.duplicate()
    for bad in (np.nan, 0.0):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(
                DualSystem, "flexibility", lambda self, lam, bad=bad: np.full(lam.shape, bad)
            )
            ksp.solve(b, x)
        agree(ksp.getConvergedReason() < 0, (bad, ksp.getConvergedReason()))
        for _ in range(2):
            ksp.solve(b, x)
            agree(ksp.getConvergedReason() > 0, context.message)
            equal(whole(x.array_r), problem.solve(values), 1e-7)
            problem.A.stateIncrease()


def test_unsymmetric_matrices_are_refused(torn_grid):
    """H and the Ritz vectors are those of a symmetric system."""

    def tilt(K, dofs):
        for k in K:
            k += 0.01 * (np.triu(k) - np.triu(k).T)

    problem = torn_grid((2, 2), (2, 2), components=2, change=tilt)
    with raises(SetUpError, "not symmetric, but -recycle_feti_recycle is 3"):
        Pattern(problem.A, FETIOptions(recycle=3), "recycle_")


def test_newtons_steps_are_shortened():
    """Along a path of load a third of the iterations is saved, at equal accuracy."""
    states, costs = [], []
    for options in ({}, {"feti_recycle": 60}):
        options = {"feti_formulation": "dual", **options}
        body = wall(tube())
        steps = body.inflate(body.problem(4, {"snes_rtol": 1e-9, **options}), [2.0, 10.0, 20.0])
        states.append(by_place(body.u))
        costs.append([step.linear_iterations for step in steps])
        agree(max(step.linear_residual for step in steps) <= 1e-8)
    equal(states[1], states[0], 1e-7)
    agree(sum(costs[1]) <= 0.7 * sum(costs[0]), costs)
