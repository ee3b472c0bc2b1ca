# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""An error of one subdomain, on one process alone, is one error on all processes."""

import numpy as np
import pytest
import scipy.sparse
import scipy.sparse.linalg
from cases import each, every_formulation
from collective import COMM, agree, raises
from hand_torn import aij, random_values, solve, solve_and_check, subdomains_of
from modes import factors_of

from dolfinx_feti.errors import FactorError, SetUpError
from dolfinx_feti.feti.subdomain.factors import create
from dolfinx_feti.feti.subdomain.factors.packed import PackedMatrix
from dolfinx_feti.feti.subdomain.factors.petsc_factor import PetscFactor
from dolfinx_feti.feti.subdomain.factors.petsc_solver import FactorOptions, factor_matrix
from dolfinx_feti.feti.subdomain.factors.work_space import WorkSpace, pack
from dolfinx_feti.feti.subsolver_options import DirectOptions
from dolfinx_feti.runtime.petsc_options import inserted

any_number = pytest.mark.processes(1, 2, 3, 4, 8)

GRID = {"subdomains": (4, 2), "cells": (5, 2), "components": 2}
WORK_SPACE = "dolfinx_feti.feti.subdomain.factors.petsc_solver.WORK_SPACE"
LAST = COMM.rank == COMM.size - 1

#: Kinds of errors and what they are raised with; a raised one would keep its frames alive.
ERRORS = {
    "LAPACK": (np.linalg.LinAlgError, "SVD did not converge"),
    "ARPACK": (scipy.sparse.linalg.ArpackError, -9),
    "SciPy": (ValueError, "array must not contain infs or NaNs"),
    "memory": (MemoryError, "Unable to allocate 3 TiB"),
    "MUMPS": (MemoryError, "not enough memory or work space (MUMPS: INFOG(1) = -9)"),
    "pivot": (FactorError, "a zero pivot (MUMPS: INFOG(1) = -10)"),
}


def fail_on_last(monkeypatch, place, error):
    """Replace a function by one that raises an error on the last process.

    Args:
        monkeypatch: The fixture.
        place: Name of the function in ``dolfinx_feti.feti.subdomain``.
        error: Class of the error and its argument, a value of ERRORS.
    """

    def fail(*args, **kwargs):
        raise error[0](error[1])

    if LAST:
        monkeypatch.setattr(f"dolfinx_feti.feti.subdomain.{place}", fail)


@any_number
@each("error", ERRORS)
def test_error_on_one_process_is_a_set_up_error_on_all(error, torn_grid, create_dual, monkeypatch):
    """The message has the subdomain and the message of the error."""
    fail_on_last(monkeypatch, "mode_search.soft_modes", error)
    A = torn_grid(**GRID).A
    first = subdomains_of(COMM.size - 1, 8)[0]
    words = str(error[0](error[1])).split("(")[0].strip()
    with raises(SetUpError, rf"failed \(subdomain {first}: .*{words}"):
        create_dual(A)


@any_number
@every_formulation
def test_set_up_succeeds_once_the_cause_is_gone(formulation, torn_grid, create_ksp, monkeypatch):
    """Before, the failure is a negative reason with a message.

    Without adaptive columns both formulations look for soft modes.
    """
    problem = torn_grid(**GRID)
    with monkeypatch.context() as patched:
        fail_on_last(patched, "mode_search.soft_modes", ERRORS["memory"])
        ksp = create_ksp(problem.A, feti_formulation=formulation, feti_coarse_adaptive=0)
        agree(solve(ksp, problem, random_values(problem))[0] < 0)
        agree("MemoryError: Unable to allocate" in ksp.getPythonContext().message)
        agree(not ksp.getPythonContext().singular)
    solve_and_check(ksp, problem, 1e-5)


def test_mumps_gets_more_work_space_if_it_is_short(torn_grid, create_dual, monkeypatch):
    """The first attempt really fails; if the last one does, the message names the option."""
    monkeypatch.setattr(create, "multifrontal_code", lambda *_: None)
    monkeypatch.setattr(WORK_SPACE, (-99, 50))
    problem = torn_grid((2, 2), (12, 12), components=2)
    factors = factors_of(create_dual(problem.A, interior="keep"))
    agree(all(factor.memory() > 0.0 for factor in factors))
    monkeypatch.setattr(WORK_SPACE, (-99,))
    memory = r"MemoryError: not enough memory or work space .*INFOG\(1\) = -9"
    remedy = r"raise -test_feti_\w+_mat_mumps_icntl_14, .*smaller subdomains"
    with raises(SetUpError, rf"subdomain \d: {memory}.*{remedy}"):
        create_dual(problem.A, interior="keep")


def test_memory_is_in_mebibytes(torn_grid, create_dual, monkeypatch):
    """MUMPS counts in units of 10⁶ bytes, the dense blocks in bytes."""
    monkeypatch.setattr(create, "multifrontal_code", lambda *_: None)
    system = create_dual(torn_grid((2, 2), (12, 12), components=2).A, interior="keep")
    factors = factors_of(system)
    agree(all(isinstance(factor, PetscFactor) for factor in factors))
    millions = sum(factor._pc.getFactorMatrix().getMumpsInfog(22) for factor in factors)
    agree(abs(system.inverse.memory() - millions / 1.048576) < 1e-9 * max(millions, 1))
    dense = PackedMatrix(pack(np.eye(512)), 512, WorkSpace())
    agree(dense.memory() == 256 * 513 * 8 / 2**20)


def test_inertia_is_unknown_with_petscs_own_factorisation(torn_grid, create_dual):
    """Its pivots are not counted."""
    with inserted("test_feti_local_", {"pc_factor_mat_solver_type": "petsc"}):
        system = create_dual(torn_grid(**GRID).A, interior="keep", type="classical")
    counts = [factor.inertia for factor in factors_of(system)]
    agree(len(counts) > 0 and all(count == (None, None) for count in counts), counts)
    agree(system.inverse.count_negative_eigenvalues() is None)


def test_ill_conditioned_interior_is_accepted(torn_grid, create_dual, monkeypatch):
    """It may amplify random vectors without having a null vector."""
    name = "dolfinx_feti.feti.subdomain.interior.is_numerically_singular"
    monkeypatch.setattr(name, lambda *_: True)
    create_dual(torn_grid(**GRID).A, interior="eliminate")


# ---- MUMPS runs out of memory ---------------------------------------------------------------

PREFIX = "test_local_"
CHOICE = FactorOptions(DirectOptions(PREFIX), is_symmetric=True, right_hand_sides=4)

#: A work space that no machine has, too low a limit: INFOG(1) and the remedy.
SHORTAGES = {
    "allocation": ({"mat_mumps_icntl_14": 10**8}, -13, "set -{}mat_mumps_icntl_22 1"),
    "limit": ({"mat_mumps_icntl_23": 1}, -19, "raise -{}mat_mumps_icntl_23, the limit in MB"),
}


@pytest.fixture
def laplacian(lifetime):
    """The five-point Laplacian on 60 × 60 points."""
    T = scipy.sparse.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(60, 60))
    return lifetime.own(aij(scipy.sparse.csr_array(scipy.sparse.kronsum(T, T))))


@pytest.mark.serial
@each(("options", "infog", "remedy"), SHORTAGES)
def test_shortage_of_memory_names_the_option_of_mumps(options, infog, remedy, laplacian):
    """An allocation that fails and too low a limit have different remedies."""
    with inserted(PREFIX, options), pytest.raises(MemoryError) as caught:
        factor_matrix(laplacian, CHOICE)
    assert f"not enough memory or work space (MUMPS: INFOG(1) = {infog}" in str(caught.value)
    assert remedy.format(PREFIX) in str(caught.value)


@pytest.mark.serial
@pytest.mark.parametrize("option", [{"mat_mumps_icntl_22": 1}, {"mat_mumps_icntl_23": 64}])
def test_options_against_a_shortage_of_memory_work(option, laplacian, lifetime):
    """Factors out of core, or with a limit that suffices, solve accurately."""
    with inserted(PREFIX, option):
        factor = lifetime.own(factor_matrix(laplacian, CHOICE))
    b, x = map(lifetime.own, laplacian.createVecs())
    b.set(1.0)
    factor.apply(b, x)
    assert (laplacian * x - b).norm() < 1e-11 * b.norm()
