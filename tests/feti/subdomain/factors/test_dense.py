# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Dense factors in single precision, against inverses and factors in double."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import pytest

from dolfinx_feti.feti.subdomain.factors.dense import SINGLE, DenseFactor, PackedMatrix, pack
from dolfinx_feti.feti.subdomain.factors.direct import Choice
from dolfinx_feti.feti.subdomain.factors.pivoted import PivotedFactor
from dolfinx_feti.feti.subdomain.nullspace import growth

RHO = 2.0


def block(n: int, least: float, scale: float = 1.0) -> tuple[PackedMatrix, np.ndarray, np.ndarray]:
    """Return S, packed and dense, with eigenvalues from ``least`` to 1 times a scale, and R."""
    rng = np.random.default_rng(n)
    Q = np.linalg.qr(rng.standard_normal((n, n)))[0]
    S = scale * (Q * np.geomspace(least, 1.0, n)) @ Q.T
    R = np.linalg.qr(rng.standard_normal((n, min(n, 3))))[0]
    return PackedMatrix(pack(np.asfortranarray(S)), n, np.empty(n * n)), S, R


@pytest.mark.parametrize("scale", [1.0, 1e-60, 1e60])
@pytest.mark.parametrize("n", [1, 2, 40])
def test_inverse_up_to_rounding_in_single_precision(n, scale):
    """Columns and a vector, whatever the units; S stays as it is."""
    packed, S, R = block(n, 1e-3, scale)
    before = packed.values.copy()
    factor = DenseFactor.in_single(packed, R, RHO * scale)
    S_ρ = S + RHO * scale * R @ R.T
    exact = np.linalg.inv(S_ρ)
    Y = np.random.default_rng(1).standard_normal((n, 5)) / scale
    bound = 10.0 * SINGLE * np.linalg.cond(S_ρ)
    for y, solved in (
        (Y, factor.solver()(Y)),
        (Y, factor.solve(Y)),
        (Y[:, 0], factor.solve(Y[:, 0])),
    ):
        assert solved.dtype == np.float64
        assert np.linalg.norm(solved - exact @ y) <= bound * np.linalg.norm(exact @ y)
    assert not factor.solve(0.0 * Y).any()
    assert np.array_equal(packed.values, before)
    assert factor.pivots == (0, 0)


def test_half_the_memory():
    packed, _, R = block(40, 1e-3)
    single, double = DenseFactor.in_single(packed, R, RHO), DenseFactor(packed, R, RHO)
    assert single.memory() == 0.5 * double.memory()
    single.destroy()
    assert single.memory() == 0.0


@pytest.mark.parametrize("kind", ["single", "dense", "indefinite", "pivoted"])
def test_destroyed_factor_raises(kind):
    """A vector, columns of either number, and none; memory that is free is not read."""
    packed, S, R = block(40, 1e-3)
    matrix = PETSc.Mat().createDense(S.shape, array=S, comm=PETSc.COMM_SELF)
    if kind == "single":
        factor = DenseFactor.in_single(packed, R, RHO)
    elif kind == "pivoted":
        rows = np.arange(40, dtype=np.int32)
        sparse = matrix.convert(PETSc.Mat.Type.SEQAIJ, PETSc.Mat())
        factor = PivotedFactor(sparse, rows, Choice("some_", True, 8), R, RHO)
        sparse.destroy()
    else:
        S = np.diag(np.r_[{"dense": 1.0, "indefinite": -1.0}[kind], np.ones(39)])
        factor = DenseFactor(PackedMatrix(pack(np.asfortranarray(S)), 40, np.empty(1600)))
    matrix.destroy()
    shapes = [(40,), (40, 3), (40, 9), (40, 0)]
    for shape in shapes:
        assert np.isfinite(factor.solve(np.ones(shape))).all()
    factor.destroy()
    factor.destroy()
    for shape in shapes:
        with pytest.raises(RuntimeError, match="has been destroyed"):
            factor.solve(np.ones(shape))


def test_error_is_that_of_the_growth():
    """A solve is off by about ε times the growth of random vectors, which is found with it."""
    for least in (1e-1, 1e-3, 1e-5):
        packed, S, R = block(60, least)
        factor, double = DenseFactor.in_single(packed, R, RHO), DenseFactor(packed, R, RHO)
        y = np.random.default_rng(2).standard_normal(60)
        error = np.linalg.norm(factor.solve(y) - double.solve(y)) / np.linalg.norm(double.solve(y))
        stiffest = np.linalg.norm(S + RHO * R @ R.T, 2) / S.diagonal().mean()
        assert error <= SINGLE * stiffest * growth(factor, S.diagonal())


def test_no_factor_of_an_indefinite_or_an_empty_matrix():
    packed, _, R = block(20, 1e-3)
    packed.values[0] = -1.0
    assert DenseFactor.in_single(packed, R, RHO) is None
    empty = PackedMatrix(np.zeros(0), 0, np.zeros(0))
    assert DenseFactor.in_single(empty, np.zeros((0, 0)), 1.0) is None
