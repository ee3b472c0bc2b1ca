# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What stands beside FETI: the assembled system, a direct solver, time and memory."""

from __future__ import annotations

import math
import mmap
import time

from petsc4py import PETSc

import numpy as np
import pytest
from collective import COMM, agree, dense, equal, small, whole

from dolfinx_feti.comparison import (
    PeakMemory,
    assembled_system,
    create_solver,
    measure,
    relative_residual,
    timed_solve,
)
from dolfinx_feti.runtime import cost as comparison
from dolfinx_feti.runtime.petsc_options import inserted

SEED = 8363
MIB = 2**20
#: What a process may allocate beside what is asked for [MiB].
NOISE = 4.0


def skew(K, _dofs):
    """Make the local matrices unsymmetric."""
    for K_i in K:
        n = len(K_i) // 2
        K_i[:n, n:] *= 1.1
        K_i[n:, :n] *= 0.9


# -- the assembled system


@pytest.mark.parametrize("held", [True, False])
@pytest.mark.parametrize("components", [1, 2])
def test_assembled_system(torn_grid, components, held):
    """Unit rows and columns at Dirichlet dofs, whose values move to the right; A stays."""
    free = {} if held else {"fixed": lambda x: np.zeros(len(x), dtype=bool)}
    problem = torn_grid((2, 2), (2, 3), components=components, **free)
    b = np.random.default_rng(SEED).standard_normal(len(problem.dirichlet))
    vector = problem.vector(b)
    K, f = assembled_system(problem.A, vector)
    fixed = problem.dirichlet
    A = problem.T.T @ problem.K_torn @ problem.T
    expected = np.where(fixed[:, None] | fixed[None, :], np.eye(len(b)), A)
    equal(dense(K), expected, 1e-13)
    equal(dense(problem.A.convert("aij", PETSc.Mat())), A, 1e-13)
    equal(whole(f.array_r), np.where(fixed, b, b - A[:, fixed] @ b[fixed]), 1e-13)
    equal(whole(vector.array_r), b)
    x = problem.solve(b) if held else np.zeros(len(b))
    small(relative_residual(K, f, problem.vector(x)) - (0.0 if held else 1.0), 1e-11)
    agree(K.isSymmetricKnown() == (True, True) and K.getBlockSize() == components)
    modes, kept = (M.getNearNullSpace().getVecs() for M in (problem.A, K))
    agree(len(kept) == len(modes) == (1 if components == 1 else 3))
    for mode, same in zip(modes, kept, strict=True):
        equal(same.array_r, mode.array_r)
    for made in (K, f, vector):
        made.destroy()


@pytest.mark.parametrize("symmetric", [True, False])
def test_mumps(torn_grid, symmetric):
    """A symmetric matrix is found to be so, and gets the factorisation that fits, with options."""
    problem = torn_grid((2, 2), (2, 2), components=2, change=None if symmetric else skew)
    b = np.random.default_rng(SEED + 1).standard_normal(len(problem.dirichlet))
    K, f = assembled_system(problem.A, problem.vector(b))
    with inserted("mumps_", {"mat_mumps_icntl_7": 5, "mat_mumps_icntl_14": 77}):
        ksp = create_solver(K)
    agree(ksp.getPC().getType() == ("cholesky" if symmetric else "lu"))
    factor = ksp.getPC().getFactorMatrix()
    agree((factor.getMumpsIcntl(7), factor.getMumpsIcntl(14)) == (5, 77))
    x = f.duplicate()
    ksp.solve(f, x)
    equal(whole(x.array_r), problem.solve(b), 1e-10)
    for made in (ksp, K, f, x):
        made.destroy()


# -- the measure


def test_measure_tells_set_up_from_solution(torn_grid):
    """Times and counts are the solver's own, on all processes; the solver is freed."""

    class Slow:
        def setUp(self, pc):
            time.sleep(0.2)

        def apply(self, pc, b, x):
            time.sleep(0.05)
            b.copy(x)

    problem = torn_grid((2, 2), (2, 2))
    made = []

    def create():
        ksp = PETSc.KSP().create(COMM)
        ksp.setOperators(K)
        ksp.setType("cg")
        ksp.setTolerances(rtol=1e-30, atol=1e-300, max_it=3)
        ksp.getPC().setType("python")
        ksp.getPC().setPythonContext(Slow())
        made.append(ksp)
        return ksp

    b = problem.vector(np.ones(len(problem.dirichlet)))
    K, f = assembled_system(problem.A, b)
    cost, x = measure(create, f)
    agree(0.2 <= cost.seconds_setup < 10 and 0.15 <= cost.seconds_solve < 10, cost)
    too_many = PETSc.KSP.ConvergedReason.DIVERGED_MAX_IT
    agree((cost.iterations, cost.converged_reason) == (3, too_many), cost)
    agree(not made[0].handle)
    for owned_here in (K, f, b, x):
        owned_here.destroy()


def test_timed_solver_is_kept(torn_grid):
    """It belongs to the caller, and serves again with the factor that it has."""
    problem = torn_grid((3, 2), (2, 2))
    K, f = assembled_system(problem.A, problem.vector(np.ones(len(problem.dirichlet))))
    x = f.duplicate()
    first, ksp = timed_solve(lambda: create_solver(K), f, x)
    small(relative_residual(K, f, x), 1e-12)
    factor = ksp.getPC().getFactorMatrix().handle
    x.set(0.0)
    second, same = timed_solve(lambda: ksp, f, x)
    agree(same is ksp and ksp.getPC().getFactorMatrix().handle == factor)
    agree(first.iterations == second.iterations == 1 and second.converged_reason > 0)
    small(relative_residual(K, f, x), 1e-12)
    for owned_here in (ksp, K, f, x):
        owned_here.destroy()


def test_peak_counts_what_was_given_back():
    """Over all processes, and of the second only its own."""
    if not all(COMM.allgather(math.isfinite(PeakMemory().mib_above_start(COMM)))):
        pytest.skip("/proc/self does not tell")
    everybody, last = range(COMM.size), [COMM.size - 1]
    for mib, ranks in ((48, everybody), (24, last), (0, [])):
        peak = PeakMemory()
        if COMM.rank in ranks:
            with mmap.mmap(-1, mib * MIB) as block:  # free() may keep what it is given
                block[:: mmap.PAGESIZE] = b"1" * (len(block) // mmap.PAGESIZE)
        small(peak.mib_above_start(COMM) - mib * len(ranks), NOISE * COMM.size)
        agree(peak.mib(COMM) > mib * len(ranks) + 10 * COMM.size, "so much takes an interpreter")


@pytest.mark.parametrize("told", [False, True])
def test_peak_where_the_mark_stays(monkeypatch, tmp_path, told):
    """The peak of the whole run, where the system tells it, says nothing about a solver."""
    if COMM.rank == 0 and told:
        (tmp_path / "clear_refs").mkdir()
        (tmp_path / "status").write_text("Name:\tpython3\nVmHWM:\t 2048 kB\nVmRSS:\t 1024 kB\n")
    COMM.Barrier()
    monkeypatch.setattr(comparison, "PROC", tmp_path)
    peak = PeakMemory()
    agree(peak.mib(COMM) == 2.0 * COMM.size if told else math.isnan(peak.mib(COMM)))
    agree(math.isnan(peak.mib_above_start(COMM)))
