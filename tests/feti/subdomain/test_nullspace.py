# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Null vectors beyond the rigid body modes: those of a few P2–P0 cells, and of random matrices."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import pytest
import scipy.linalg
from collective import COMM, agree, equal, norm, small, whole
from mixed import solve_assembled
from modes import modes_of
from walls import tube, wall

from dolfinx_feti.feti.subdomain import nullspace
from dolfinx_feti.feti.subdomain.blocks import sparse_block
from dolfinx_feti.feti.subdomain.factors.dense import DenseFactor, PackedMatrix, pack
from dolfinx_feti.feti.subdomain.factors.direct import Choice
from dolfinx_feti.feti.subdomain.factors.multifrontal import create_fronts, load_fronts
from dolfinx_feti.feti.subdomain.factors.pivoted import PivotedFactor
from dolfinx_feti.feti.subdomain.factors.regularised import factor_by_fronts
from dolfinx_feti.feti.subdomain.nullspace import factor_tells_singular, null_space
from dolfinx_feti.runtime.connectivity import block_graph
from dolfinx_feti.runtime.petsc_library import rows_of

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


@pytest.fixture
def factor_of():
    """What factors a matrix as one block, given R, ρ and a shift; all is freed in the end."""
    made = []

    def create(K, kind):
        rows = np.arange(len(K), dtype=np.int32)
        if kind == "dense":
            S = PackedMatrix(pack(K), len(K), np.empty(len(K) ** 2))
            return lambda R=None, rho=1.0, shift=None: DenseFactor(S, R, rho, shift)
        M = PETSc.Mat().createAIJ(K.shape, nnz=len(K), comm=PETSc.COMM_SELF)
        M.setValues(rows, rows, K)
        M.assemble()
        made.append(M)

        def factor(R=None, rho=1.0, shift=None):
            if kind == "fronts" and shift is None:
                R = K[:, :0] if R is None else R
                with rows_of(M) as of_M:
                    graph = block_graph(of_M, 1)
                    fronts = create_fronts(load_fronts(COMM), graph, rows, rows, 1, rows[:0])
                    by_fronts = factor_by_fronts(fronts, of_M, np.empty(fronts.work), R, rho)
                if by_fronts is not None:
                    return by_fronts
            made.append(PivotedFactor(M, rows, Choice("null_", True, 8), R, rho, shift))
            return made[-1]

        return factor

    yield create
    for owned in made:
        owned.destroy()


def refactored(factor):
    return lambda known, shift: factor(known, 1.0, shift)


@every_size
@every_kind
@pytest.mark.parametrize("spread", [0.0, 3.0])
@pytest.mark.parametrize(("known", "unknown"), [(0, 0), (3, 0), (0, 2), (3, 3), (1, 14)])
def test_null_vectors_are_found(dense, kind, spread, known, unknown, factor_of, monkeypatch):
    """All of them but those that are known, whatever the scales."""
    monkeypatch.setattr(nullspace, "ALL_VECTORS", dense)
    K, null, d = singular(50, known + unknown, spread)
    R = np.linalg.qr(null[:, :known])[0]
    factor = factor_of(K, kind)
    agree(factor_tells_singular(factor(R, float(d.mean())), d) == (unknown > 0))
    Y = null_space(lambda X: K @ X, refactored(factor), d, R)
    agree(Y.shape == (50, unknown), Y.shape)
    root = np.sqrt(d)[:, None]
    both = np.linalg.qr(root * np.hstack([R, Y]))[0]
    expected = np.linalg.qr(root * null)[0]
    small(np.linalg.norm(expected - both @ (both.T @ expected)), 1e-6)


@every_kind
@pytest.mark.parametrize("softest", [1e-9, -1e-9])
def test_soft_and_buckling_modes_are_no_null_vectors(kind, softest, factor_of):
    K, _, d = singular(40, 0, 2.0, softest=abs(softest))
    if softest < 0.0:
        values, Q = np.linalg.eigh(K)
        K = K - 2.0 * values[0] * np.outer(Q[:, 0], Q[:, 0])
    factor = factor_of(K, kind)
    agree(not factor_tells_singular(factor(), d))
    agree(null_space(lambda X: K @ X, refactored(factor), d).shape[1] == 0)


def test_right_null_vectors_of_an_unsymmetric_matrix(factor_of):
    rng = np.random.default_rng(SEED)
    K = rng.standard_normal((30, 28)) @ rng.standard_normal((28, 30))
    Y = null_space(lambda X: K @ X, refactored(factor_of(K, "pivots")), np.abs(K.diagonal()))
    agree(Y.shape == (30, 2))
    small(np.abs(K @ Y).max(), 1e-10 * np.abs(K).max() * np.abs(Y).max())


def test_an_empty_block_is_regular():
    factor = DenseFactor(PackedMatrix(np.zeros(0), 0, np.zeros(0)))
    agree(not factor_tells_singular(factor, np.zeros(0)))


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
    torn, modes = system.torn, modes_of(system)
    expected = []
    for rows in torn.subdomains:
        K = sparse_block(torn.K, rows, rows).toarray()
        root = np.sqrt(K.diagonal())
        scaled = K / root[:, None] / root
        expected.append(scipy.linalg.null_space(scaled, rcond=1e-11).shape[1])
    equal(np.array(modes.kernel, dtype=np.int64), expected)
    agree(len(whole(np.array(expected))) >= subdomains and COMM.allreduce(sum(expected)) > 0)
    agree(subdomains < CELLS or set(expected) <= {9}, expected)
    agree(all(modes.exact))
    small(max((np.abs(D).max(initial=0.0) for D in modes.D), default=0.0), 0.0)
    error = 0.0
    for i, (E, rho) in enumerate(zip(modes.E, modes.rho, strict=True)):
        image = system.operator.local_product(i, E)
        error = max(error, np.abs(image).max(initial=0.0) / rho)
    small(error, 1e-11)


@pytest.mark.parametrize("interior", ["keep", "eliminate"])
@pytest.mark.parametrize("kind", ["all_floating", "classical"])
def test_few_cells_agree_with_a_direct_solver(kind, interior):
    """Every linear solve of a load step, with null vectors at rest and without them under load."""
    body, problem = quarter_tube(64, feti_type=kind, feti_interior=interior, ksp_rtol=1e-10)
    errors = []

    def compare(ksp, b, x):
        expected = solve_assembled(ksp.getOperators()[0], b)
        errors.append(norm(x.array_r - expected) / norm(expected))

    problem.solver.getKSP().setPostSolve(compare)
    steps = body.inflate(problem, [5.0])
    agree(len(steps) == len(errors) >= 3)
    small(max(errors), 1e-8)
    small(max(step.linear_residual for step in steps), 1e-10)
