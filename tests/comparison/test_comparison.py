# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What stands beside FETI: the assembled system, a direct solver, time and memory."""

from __future__ import annotations

import ctypes
import math
import mmap
import time

from petsc4py import PETSc

import numpy as np
import pytest
from collective import COMM, agree, dense, equal, small, whole
from hand_torn import random_values
from problems import cube, elasticity, owned

from dolfinx_feti.comparison import (
    PeakMemory,
    assembled_system,
    create_solver,
    measure,
    relative_residual,
    timed_solve,
)
from dolfinx_feti.runtime import cost as comparison
from dolfinx_feti.runtime.petsc_library import function
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
    """A symmetric matrix is found to be so, and gets the factorisation that fits."""
    problem = torn_grid((2, 2), (2, 2), components=2, change=None if symmetric else skew)
    b = np.random.default_rng(SEED + 1).standard_normal(len(problem.dirichlet))
    K, f = assembled_system(problem.A, problem.vector(b))
    ksp = create_solver(K)
    agree(ksp.getPC().getType() == ("cholesky" if symmetric else "lu"))
    x = f.duplicate()
    ksp.solve(f, x)
    equal(whole(x.array_r), problem.solve(b), 1e-10)
    for made in (ksp, K, f, x):
        made.destroy()


def test_mumps_reads_its_options(torn_grid):
    """Those of the factor, too: ordering by METIS, and the work space in place of our own."""
    problem = torn_grid((2, 2), (2, 2), components=2)
    K, f = assembled_system(problem.A, problem.vector(random_values(problem)))
    with inserted("mumps_", {"mat_mumps_icntl_7": 5, "mat_mumps_icntl_14": 77}):
        ksp = create_solver(K)
        ksp.setUp()
        factor = ksp.getPC().getFactorMatrix()
        agree((factor.getMumpsIcntl(7), factor.getMumpsIcntl(14)) == (5, 77))
        agree(all(map(option_used, ("mumps_mat_mumps_icntl_7", "mumps_mat_mumps_icntl_14"))))
    for made in (ksp, K, f):
        made.destroy()


def option_used(name):
    """Ask PETSc whether an option of the database, without its dash, has been read."""
    arguments = (ctypes.c_void_p, ctypes.c_char_p, ctypes.POINTER(ctypes.c_int))
    used = ctypes.c_int()
    agree(function("PetscOptionsUsed", arguments)(None, name.encode(), ctypes.byref(used)) == 0)
    return bool(used.value)


def test_beside_a_linear_problem(solve):
    """Values of Dirichlet conditions that are not zero, some on single components."""
    body = elasticity(cube(3, 3), degree=2, stretched=True)
    linear = solve(body, 6, {"ksp_rtol": 1e-11})
    K, f = assembled_system(linear.A, linear.b)
    cost, x = measure(lambda: create_solver(K), f)
    equal(x.array_r, body.solve_directly(), 1e-10)
    equal(owned(linear.u), x.array_r, 1e-8)
    small(relative_residual(K, f, x), 1e-12)
    agree(cost.converged_reason > 0 and cost.iterations == 1)
    for made in (K, f, x):
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
    agree(
        cost.iterations == 3 and cost.converged_reason == PETSc.KSP.ConvergedReason.DIVERGED_MAX_IT,
        cost,
    )
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


@pytest.fixture
def mark_can_be_put_down():
    """Not all systems let a process ask for its own memory."""
    if not all(COMM.allgather(math.isfinite(PeakMemory().mib_above_start(COMM)))):
        pytest.skip("/proc/self does not tell")


def test_peak_counts_what_was_given_back(mark_can_be_put_down):
    """Over all processes, and of the second only its own."""
    everybody, last = range(COMM.size), [COMM.size - 1]
    for mib, ranks in ((48, everybody), (24, last)):
        peak = PeakMemory()
        if COMM.rank in ranks:
            with mmap.mmap(-1, mib * MIB) as block:  # free() may keep what it is given
                block[:: mmap.PAGESIZE] = b"1" * (len(block) // mmap.PAGESIZE)
        small(peak.mib_above_start(COMM) - mib * len(ranks), NOISE * COMM.size)
        agree(peak.mib(COMM) > mib * len(ranks) + 10 * COMM.size, "so much takes an interpreter")


def test_peak_of_nothing(mark_can_be_put_down):
    small(PeakMemory().mib_above_start(COMM), NOISE * COMM.size)


def test_peak_where_the_system_does_not_tell(monkeypatch, tmp_path):
    monkeypatch.setattr(comparison, "PROC", tmp_path / "none")
    peak = PeakMemory()
    agree(math.isnan(peak.mib(COMM)) and math.isnan(peak.mib_above_start(COMM)))


def test_peak_where_the_mark_stays(monkeypatch, tmp_path):
    """The peak of the whole run says nothing about what a solver took."""
    if COMM.rank == 0:
        (tmp_path / "clear_refs").mkdir()
        (tmp_path / "status").write_text("Name:\tpython3\nVmHWM:\t 2048 kB\nVmRSS:\t 1024 kB\n")
    COMM.Barrier()
    monkeypatch.setattr(comparison, "PROC", tmp_path)
    peak = PeakMemory()
    agree(peak.mib(COMM) == 2.0 * COMM.size and math.isnan(peak.mib_above_start(COMM)))
