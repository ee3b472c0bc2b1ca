# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Who creates destroys: no reference cycle, no object left, no memory that grows."""

from __future__ import annotations

import gc
import weakref
from pathlib import Path

from petsc4py import PETSc

import numpy as np
import pytest
from collective import COMM, agree
from garbage import garbage
from problems import cube, elasticity, poisson

import dolfinx_feti
from dolfinx_feti.feti.options import FETIOptions
from dolfinx_feti.feti.pattern import create_pattern
from dolfinx_feti.feti.setup import set_up
from dolfinx_feti.runtime.lifetime import Lifetime


def create(problem, **options):
    return dolfinx_feti.LinearProblem(
        problem.a,
        problem.L,
        bcs=problem.bcs,
        subdomains=6,
        petsc_options_prefix="memory_",
        petsc_options=options,
    )


def resident():
    """Resident memory of this process in MiB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 2**20


def collect():
    gc.collect()
    PETSc.garbage_cleanup()


@pytest.fixture
def without_collector():
    """Reference counting alone has to do."""
    collect()
    gc.disable()
    yield
    gc.enable()


@pytest.mark.parametrize("solved", [False, True])
def test_problem_is_freed_without_the_collector(solved, without_collector):
    """A cycle would leave the collective destruction of PETSc objects to chance."""
    linear = create(poisson(cube(2, 4)))
    if solved:
        linear.solve()
    context = linear.solver.getPythonContext()
    watched = [weakref.ref(linear), weakref.ref(context)]
    if solved:
        parts = context.form
        watched += [weakref.ref(part) for part in (parts.torn, parts.dual, parts.operator)]
        del parts
    del linear, context
    agree(all(ref() is None for ref in watched), [ref() for ref in watched])


@pytest.mark.parametrize("pc_type", ["dirichlet", "lumped", "identity"])
@pytest.mark.parametrize("kind", ["all_floating", "classical"])
def test_matrix_is_its_owners_again(kind, pc_type, torn_grid):
    """After destroy() nothing refers to the torn matrix and to its local one."""
    problem = torn_grid((2, 2), (2, 2), components=2)
    before = problem.A.getRefCount(), problem.local.getRefCount()
    with Lifetime() as owner:
        options = FETIOptions(type=kind, pc_type=pc_type)
        pattern = create_pattern(problem.A, options, "memory_", owner)
        for _ in range(2):
            with Lifetime() as matrix:
                set_up(pattern, matrix, matrix)
    del pattern
    collect()
    after = problem.A.getRefCount(), problem.local.getRefCount()
    agree(before == after, (before, after))


def test_solver_may_be_destroyed_twice_and_unused(torn_grid):
    problem = torn_grid((2, 2), (2, 2))
    before = problem.A.getRefCount()
    for steps in range(3):
        ksp = PETSc.KSP().create(COMM)
        ksp.setOperators(problem.A)
        ksp.setType(PETSc.KSP.Type.PYTHON)
        context = dolfinx_feti.FETI()
        ksp.setPythonContext(context)
        if steps > 0:
            ksp.setUp()
        if steps > 1:
            context.destroy(ksp)
        ksp.destroy()
        context.destroy()
        agree(context.report() is None)
    collect()
    agree(problem.A.getRefCount() == before, (problem.A.getRefCount(), before))


def test_failed_set_up_leaves_nothing(torn_grid):
    problem = torn_grid((2, 2), (2, 2), components=2, fixed=lambda x: np.zeros(len(x), dtype=bool))
    before = problem.A.getRefCount(), problem.local.getRefCount()
    for _ in range(3):
        ksp = PETSc.KSP().create(COMM)
        ksp.setOperators(problem.A)
        ksp.setType(PETSc.KSP.Type.PYTHON)
        ksp.setPythonContext(dolfinx_feti.FETI())
        ksp.setUp()
        agree("singular" in ksp.getPythonContext().message)
        ksp.destroy()
    del ksp
    collect()
    agree((problem.A.getRefCount(), problem.local.getRefCount()) == before)


def test_operators_outlive_the_problem():
    """The user's own references stay valid."""
    linear = create(poisson(cube(2, 4)))
    u = linear.solve()
    A, values = linear.A, u.x.array.copy()
    del linear
    collect()
    agree(np.array_equal(u.x.array, values))
    agree(A.handle == 0)  # destroyed with its problem, and says so


FORMS = {
    "dual": {"feti_formulation": "dual"},
    "primal": {"feti_formulation": "primal"},
    "Q = I": {"feti_coarse_q": "identity", "feti_formulation": "dual"},
    "classical": {"feti_type": "classical", "feti_pc_type": "lumped"},
    "no lag": {"feti_formulation": "primal", "feti_lag": 0},
}


@pytest.mark.parametrize("null_space", [False, True])
@pytest.mark.parametrize("options", FORMS.values(), ids=FORMS)
def test_nothing_waits_for_the_collector(options, null_space, torn_grid, feti):
    """Near kernel, null space and matrix are replaced between solves; all owners end together."""
    grid = {"subdomains": (3, 2), "cells": (2, 2)}
    if null_space:
        grid["fixed"] = lambda x: np.zeros(len(x), dtype=bool)
        options = {**options, "feti_type": "all_floating"}
    first = torn_grid(**grid)
    PETSc.garbage_cleanup(first.A.comm)
    ksp = feti(first.A, dolfinx_feti.FETI(newton=True), **options)
    for step in range(4):
        A = first.A if step < 2 else torn_grid(**grid).A
        if null_space:
            space = PETSc.NullSpace().create(constant=True, comm=A.comm)
            A.setNullSpace(space)
            space.destroy()
        mode = A.createVecRight()
        mode.set(1.0)
        dolfinx_feti.set_near_kernel(A, [mode])
        mode.destroy()
        ksp.setOperators(A)
        b, x = A.createVecs()
        ksp.solve(b, x)
        agree(ksp.getConvergedReason() > 0, ksp.getPythonContext().message)
        for owned in (b, x):
            owned.destroy()
        if step == 3:
            ksp.setOperators(first.A)
            A.destroy()
        agree(not garbage(COMM), garbage(COMM))
    ksp.destroy()
    agree(not garbage(COMM), garbage(COMM))


@pytest.mark.parametrize("what", ["create", "solve", "refresh"])
def test_memory_does_not_grow(what, torn_grid, feti):
    """Less than a tenth of a MiB a round, where a system takes several.

    A leak grows in each of the windows; an arena or a cache that the allocator takes once, in one.
    """
    problem = elasticity(cube(3, 4))
    linear = create(problem)
    linear.solve()

    def work():
        if what == "create":
            create(problem).solve()
        elif what == "solve":
            linear.solve()
        else:
            linear._system._K.mat.stateIncrease()
            linear.solver.getPythonContext().setUp(linear.solver)
        collect()

    rounds, windows = 5, 4
    sizes = [resident()]
    for _ in range(windows):
        for _ in range(rounds):
            work()
        sizes.append(resident())
    grown = np.diff(sizes)
    agree(grown.min() < 0.1 * rounds, f"{grown} MiB in {rounds} rounds each")


def test_one_copy_of_the_matrix():
    """Factors and interface rows included, a system holds less than six times the matrix.

    The benchmark measures the peak; this only finds a second factorisation or a dense array.
    """
    linear = create(elasticity(cube(3, 6)))
    linear.solve()
    report = linear.solver.getPythonContext().report()
    nonzeros = COMM.allreduce(linear._system._K.mat.getInfo(PETSc.Mat.InfoType.LOCAL)["nz_used"])
    matrix = nonzeros * 12 / 2**20
    agree(report.factor_mib < 6 * max(matrix, report.subdomains), (report.factor_mib, matrix))
