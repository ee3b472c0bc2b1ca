# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The choice of a factorisation, and the work space that dense factors share."""

from __future__ import annotations

import numpy as np
import pytest
from collective import COMM, agree, equal

from dolfinx_feti.feti.subdomain.factors import create
from dolfinx_feti.feti.subdomain.factors.bunch_kaufman import BunchKaufmanFactor
from dolfinx_feti.feti.subdomain.factors.cholesky import (
    CholeskyFactor,
    SingleCholeskyFactor,
    factor_cholesky_in_single_precision,
)
from dolfinx_feti.feti.subdomain.factors.packed import PackedMatrix
from dolfinx_feti.feti.subdomain.factors.protocol import EmptyFactor
from dolfinx_feti.feti.subdomain.factors.work_space import PackedTriangle, WorkSpace, pack
from dolfinx_feti.feti.subsolver_options import DirectOptions

#: Columns of one right-hand side, of few, and of many.
COLUMNS = (1, 4, 9)


def spd(n, seed):
    """Return a random symmetric positive definite matrix, (n, n)."""
    X = np.random.default_rng(seed).standard_normal((n, n))
    return X @ X.T + n * np.eye(n)


def create_packed(S, work):
    """Return a matrix in packed format that unpacks into a shared work space."""
    return PackedMatrix(pack(np.asfortranarray(S)), len(S), work)


@pytest.mark.parametrize("single", [False, True], ids=["double", "single"])
def test_factors_that_share_a_work_space_do_not_interfere(single):
    """Solves and products in turn do not spoil each other's triangles."""
    work = WorkSpace()
    matrices = [spd(30, 1), spd(20, 2)]
    stored = [create_packed(S, work) for S in matrices]
    R = [S[:, :0] for S in matrices]
    create_factor = create.factor_dense_for_preconditioner if single else create.factor_dense
    factors = [create_factor(S, columns, 40.0) for S, columns in zip(stored, R, strict=True)]
    tolerance = 1e-5 if single else 1e-12
    for columns in COLUMNS:
        for i in (0, 1, 1, 0, 0):
            Y = np.random.default_rng(columns).standard_normal((len(matrices[i]), columns))
            equal(matrices[i] @ factors[i].solve(Y), Y, tolerance)
        for S, matrix in zip(matrices, stored, strict=True):
            Y = np.random.default_rng(columns).standard_normal((len(S), columns))
            equal(matrix.multiply_many(Y), S @ Y, 1e-13)


def test_work_space_unpacks_the_same_triangle_once():
    """A triangle is unpacked again only after another one, or other entries, took its place."""
    work = WorkSpace()
    L = PackedTriangle(pack(np.asfortranarray(spd(4, 3))), 4)
    other = PackedTriangle(L.entries.copy(), 4)
    first = work.unpack(L)
    first[3, 0] = 7.0
    agree(work.unpack(L)[3, 0] == 7.0)  # not unpacked again
    agree(work.unpack_copy(L)[3, 0] == L.entries[3])
    first = work.unpack(L)
    first[3, 0] = 7.0
    agree(work.unpack(other)[3, 0] == L.entries[3])
    agree(work.unpack(L)[3, 0] == L.entries[3])
    first = work.unpack(L)
    work.entries(5)[:] = 8.0
    equal(np.tril(work.unpack(L)), np.tril(spd(4, 3)))
    single = PackedTriangle(L.entries.astype(np.float32), 4)
    agree(work.unpack(single).dtype == np.float32)
    equal(np.tril(work.unpack(L)), np.tril(spd(4, 3)))


def test_dense_factorisation_is_chosen_by_definiteness():
    """Cholesky for definite blocks, Bunch and Kaufman's factor for indefinite ones."""
    work = WorkSpace()
    definite = create_packed(spd(8, 4), work)
    indefinite = create_packed(np.diag([-1.0, *np.ones(7)]), work)
    empty = create_packed(np.zeros((0, 0)), work)
    R = np.zeros((8, 0))
    agree(isinstance(create.factor_dense(definite, R, 1.0), CholeskyFactor))
    agree(isinstance(create.factor_dense(indefinite, R, 1.0), BunchKaufmanFactor))
    agree(isinstance(create.factor_dense(empty, R[:0], 1.0), EmptyFactor))
    single = create.factor_dense_for_preconditioner(definite, R, 1.0)
    agree(isinstance(single, SingleCholeskyFactor) and single.is_single_precision)
    double = create.factor_dense_for_preconditioner(indefinite, R, 1.0)
    agree(isinstance(double, BunchKaufmanFactor) and not double.is_single_precision)
    agree(isinstance(create.factor_dense_for_preconditioner(empty, R[:0], 1.0), EmptyFactor))


def test_double_precision_is_used_if_single_loses_definiteness():
    """A pivot is negative in single precision only."""
    S = create_packed(np.array([[1.0, 1.0], [1.0, 1.0 + 1e-9]]), WorkSpace())
    R = np.zeros((2, 0))
    agree(factor_cholesky_in_single_precision(S, R, 1.0) is None)
    agree(isinstance(create.factor_dense_for_preconditioner(S, R, 1.0), CholeskyFactor))


@pytest.mark.parametrize("option", ["package", "pc_type"])
def test_options_that_name_a_solver_disable_the_multifrontal_method(option):
    """The user's choice is used for all factorisations."""
    agree(create.multifrontal_code(DirectOptions("create_"), COMM) is not None)
    agree(create.multifrontal_code(DirectOptions("create_", **{option: "petsc"}), COMM) is None)


def test_mumps_factors_with_a_warning_if_the_code_cannot_be_compiled(monkeypatch, caplog):
    """The warning has the reason, and only the first process logs it."""

    def load(_comm):
        raise RuntimeError("multifrontal.c cannot be compiled (no compiler)")

    monkeypatch.setattr(create, "load_fronts", load)
    agree(create.multifrontal_code(DirectOptions("create_"), COMM) is None)
    warnings = [r.message for r in caplog.records if "MUMPS factors" in r.message]
    expected = 1 if COMM.rank == 0 else 0
    agree(len(warnings) == expected, caplog.messages)
    agree(all("no compiler" in warning for warning in warnings))
