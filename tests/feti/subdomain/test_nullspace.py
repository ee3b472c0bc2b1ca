# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Null vectors beyond the rigid body modes: those of a few P2–P0 cells, and of random matrices."""

from __future__ import annotations

from types import SimpleNamespace

from petsc4py import PETSc

import numpy as np
import pytest
import scipy.linalg
from collective import COMM, agree, equal, norm, small, whole
from mixed import solve_assembled
from walls import tube, wall

from dolfinx_feti.feti.subdomain import nullspace
from dolfinx_feti.feti.subdomain.dense import DenseFactors, pack
from dolfinx_feti.feti.subdomain.nullspace import factor_tells_singular, null_space
from dolfinx_feti.feti.subdomain.sparse.factors import BlockFactors
from dolfinx_feti.feti.subdomain.sparse.fronts import load_fronts
from dolfinx_feti.feti.subdomain.sparse.regularised import RegularisedFactors

SEED = 60221

every_size = pytest.mark.parametrize("dense", [1000, 10], ids=["all vectors", "inverse iteration"])
every_kind = pytest.mark.parametrize("kind", ["pivots", "fronts", "dense"])


def singular(n, nullity, spread, *, softest=1e-6):
    """A positive semi-definite matrix, its null vectors, and its diagonal; scales far apart."""
    rng = np.random.default_rng(SEED + n)
    root = 10.0 ** (spread * (rng.random(n) - 0.5))
    Q = np.linalg.qr(rng.standard_normal((n, n)))[0]
    values = np.concatenate([np.zeros(nullity), np.geomspace(softest, 1.0, n - nullity)])
    K = root[:, None] * ((Q * values) @ Q.T) * root
    K = 0.5 * (K + K.T)
    return K, Q[:, :nullity] / root[:, None], np.abs(K.diagonal())


def factors_of(K, kind):
    """Factors of one block that is the whole matrix."""
    rows = np.arange(len(K), dtype=np.int32)
    if kind == "dense":
        factors = DenseFactors([rows])
        factors.set_block(0, pack(K))
        return factors, None
    M = PETSc.Mat().createAIJ(K.shape, nnz=len(K), comm=PETSc.COMM_SELF)
    M.setValues(rows, rows, K)
    M.assemble()
    factors = BlockFactors(M, [rows], prefix="null_", symmetric=True)
    if kind == "fronts":
        torn = SimpleNamespace(K=M, n=len(K))
        factors = RegularisedFactors(torn, [rows], factors, load_fronts(COMM))
    return factors, M


@every_size
@every_kind
@pytest.mark.parametrize("spread", [0.0, 3.0])
@pytest.mark.parametrize(("known", "unknown"), [(0, 0), (3, 0), (0, 2), (3, 3), (1, 14)])
def test_null_vectors_are_found(dense, kind, spread, known, unknown, monkeypatch):
    """All of them but those that are known, whatever the scales."""
    monkeypatch.setattr(nullspace, "DENSE", dense)
    K, null, d = singular(50, known + unknown, spread)
    R = np.linalg.qr(null[:, :known])[0]
    factors, matrix = factors_of(K, kind)
    rho = float(d.mean())
    factors.update_block(0, R, rho)
    agree(factor_tells_singular(factors, 0, d) == (unknown > 0))
    before = factors.solve_many(0, np.ones((50, 2)))
    Y = null_space(factors, 0, lambda X: K @ X, d, R, rho)
    agree(Y.shape == (50, unknown), Y.shape)
    root = np.sqrt(d)[:, None]
    both = np.linalg.qr(root * np.hstack([R, Y]))[0]
    expected = np.linalg.qr(root * null)[0]
    small(np.linalg.norm(expected - both @ (both.T @ expected)), 1e-6)
    if unknown == 0:  # the factor is as it was
        equal(factors.solve_many(0, np.ones((50, 2))), before, 1e-12)
    factors.destroy()
    if matrix is not None:
        matrix.destroy()


@every_kind
@pytest.mark.parametrize("softest", [1e-9, -1e-9])
def test_soft_and_buckling_modes_are_no_null_vectors(kind, softest):
    K, _, d = singular(40, 0, 2.0, softest=abs(softest))
    if softest < 0.0:
        values, Q = np.linalg.eigh(K)
        K = K - 2.0 * values[0] * np.outer(Q[:, 0], Q[:, 0])
    factors, matrix = factors_of(K, kind)
    factors.update_block(0)
    agree(not factor_tells_singular(factors, 0, d))
    agree(null_space(factors, 0, lambda X: K @ X, d).shape[1] == 0)
    factors.destroy()
    if matrix is not None:
        matrix.destroy()


def test_right_null_vectors_of_an_unsymmetric_matrix():
    rng = np.random.default_rng(SEED)
    K = rng.standard_normal((30, 28)) @ rng.standard_normal((28, 30))
    factors, matrix = factors_of(K, "pivots")
    Y = null_space(factors, 0, lambda X: K @ X, np.abs(K.diagonal()))
    agree(Y.shape == (30, 2))
    small(np.abs(K @ Y).max(), 1e-10 * np.abs(K).max() * np.abs(Y).max())
    factors.destroy()
    matrix.destroy()


def test_an_empty_block_is_regular():
    factors = DenseFactors([np.zeros(0, dtype=np.int32)])
    factors.update_block(0)
    agree(not factor_tells_singular(factors, 0, np.zeros(0)))


# ---- a few P2–P0 cells ----------------------------------------------------------------------

QUARTER = {"media": 2, "around": 11, "along": 1, "length": 0.13, "quarter": True}
CELLS = 198


def quarter_tube(subdomains, kappa=1000.0, **options):
    body = wall(tube(**QUARTER), kappa=kappa, quarter=True)
    return body, body.problem(subdomains, options)


@pytest.mark.parametrize("interior", ["keep", "eliminate"])
@pytest.mark.parametrize("kappa", [1000.0, 1e5])
@pytest.mark.parametrize("subdomains", [64, CELLS])
def test_kernel_of_a_few_cells(subdomains, kappa, interior, parts):
    """A cell has three null vectors beside the rigid ones; all count as kernel, with D = 0."""
    _, problem = quarter_tube(subdomains, kappa)
    problem._system.residual()
    problem._system.linearise()
    system = parts(problem.A, interior=interior, coarse_modes=0)
    torn, modes = system.torn, system.modes
    expected = []
    for K in torn.blocks(torn.subdomains):
        K = K.toarray()
        root = np.sqrt(K.diagonal())
        scaled = K / root[:, None] / root
        expected.append(scipy.linalg.null_space(scaled, rcond=1e-11).shape[1])
    equal(modes.kernels, expected)
    agree(len(whole(np.array(expected))) >= subdomains and COMM.allreduce(sum(expected)) > 0)
    agree(subdomains < CELLS or set(expected) <= {9}, expected)
    agree(all(modes.exact))
    small(max((np.abs(D).max(initial=0.0) for D in modes.D), default=0.0), 0.0)
    error = 0.0
    for i, (E, rho) in enumerate(zip(modes.E, modes.rho, strict=True)):
        image = system.matrices.multiply_many(i, E)
        error = max(error, np.abs(image).max(initial=0.0) / rho)
    small(error, 1e-11)


@pytest.mark.parametrize("interior", ["keep", "eliminate"])
@pytest.mark.parametrize("kind", ["all_floating", "classical"])
def test_few_cells_agree_with_a_direct_solver(kind, interior):
    """Every linear solve of a load step, with null vectors at rest and without them under load."""
    body, problem = quarter_tube(64, feti_type=kind, feti_interior=interior)
    errors = []

    def compare(ksp, b, x):
        expected = solve_assembled(ksp.getOperators()[0], b)
        errors.append(norm(x.array_r - expected) / norm(expected))

    problem.solver.getKSP().setPostSolve(compare)
    steps = body.inflate(problem, [5.0])
    agree(len(steps) == len(errors) >= 3)
    small(max(errors), 1e-7)
    small(max(step.linear_residual for step in steps), 1e-8)


def test_generalised_inverse_of_a_few_cells(parts):
    """K K⁺ K = K, null vectors included."""
    _, problem = quarter_tube(64)
    problem._system.residual()
    problem._system.linearise()
    system = parts(problem.A, coarse_modes=0)
    x = np.random.default_rng(SEED + COMM.rank).standard_normal(system.torn.n)
    Kx = system.torn.multiply(x)
    back = system.torn.multiply(system.inverse.solve(Kx))  # K K⁺ K x
    equal(whole(back), whole(Kx), 1e-10)
