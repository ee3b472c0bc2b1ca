# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Interior dofs eliminated: the same method, written for Schur complements."""

from __future__ import annotations

from types import SimpleNamespace

from petsc4py import PETSc

import numpy as np
import pytest
from collective import COMM, agree, dense, equal, matrix_of_map, raises, small, whole

from dolfinx_feti.errors import FactorError
from dolfinx_feti.feti.subdomain import elimination
from dolfinx_feti.feti.subdomain.dense import DenseFactors, pack
from dolfinx_feti.feti.subdomain.direct import Choice
from dolfinx_feti.feti.subdomain.matrices import worth_condensing
from dolfinx_feti.feti.subdomain.sparse.schur import (
    partial_factorisation_is_there,
    schur_complement,
)

SEED = 31
every_type = pytest.mark.parametrize("kind", ["all_floating", "classical"])
CHANGES = {
    "no prestress": None,
    "prestress": lambda K, dofs: [np.fill_diagonal(k, 1.01 * k.diagonal()) for k in K],
    "compression": lambda K, dofs: [np.fill_diagonal(k, 0.99 * k.diagonal()) for k in K],
}
every_change = pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)


def random_symmetric(n, shift, seed=SEED):
    A = np.random.default_rng(seed).standard_normal((n, n))
    return A + A.T + shift * np.eye(n)


def local_matrix(K):
    M = PETSc.Mat().createAIJ(K.shape, nnz=len(K), comm=PETSc.COMM_SELF)
    M.setValues(range(len(K)), range(len(K)), K)
    M.assemble()
    M.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    return M


def complement(K, Γ):
    I = np.setdiff1d(np.arange(len(K)), Γ)  # noqa: E741
    return K[np.ix_(Γ, Γ)] - K[np.ix_(Γ, I)] @ np.linalg.solve(K[np.ix_(I, I)], K[np.ix_(I, Γ)])


@pytest.mark.parametrize("shift", [30.0, 0.0], ids=["definite", "indefinite"])
def test_partial_factorisation(shift):
    """S = K_ΓΓ − K_ΓI K_II⁻¹ K_IΓ, packed, Γ in any order."""
    K, Γ = random_symmetric(17, shift), np.array([3, 16, 4, 0, 9], dtype=np.int32)
    matrix = local_matrix(K)
    choice = Choice("partial_", symmetric=True, right_hand_sides=8)
    agree(partial_factorisation_is_there(choice), "petsc4py's library lacks MatFactorSetSchurIS")
    S = schur_complement(matrix, Γ, choice)
    matrix.destroy()
    expected = complement(K, Γ)
    equal(S, pack(expected), 1e-12 * np.linalg.cond(K))


def test_partial_factorisation_leaves_other_solvers_alone():
    agree(not partial_factorisation_is_there(Choice("partial_", False, 8)))
    options = PETSc.Options("partial_")
    options["pc_factor_mat_solver_type"] = "petsc"
    agree(not partial_factorisation_is_there(Choice("partial_", True, 8)))
    options.delValue("pc_factor_mat_solver_type")


@pytest.mark.parametrize("shift", [40.0, 3.0], ids=["definite", "indefinite"])
def test_dense_factors(shift):
    """S and the factor of S_ρ, the inertia, and E and D of the border's solution."""
    n, k, rho = 23, 3, 2.5
    S = random_symmetric(n, shift)
    R = np.linalg.qr(np.random.default_rng(1).standard_normal((n, k)))[0]
    rows = np.arange(5, 5 + n, dtype=np.int32)
    factors = DenseFactors([rows, np.zeros(0, dtype=np.int32)])
    factors.set_block(0, pack(np.tril(S)))
    factors.update_block(0, R, rho)
    factors.update_block(1)
    regularised = S + rho * R @ R.T
    t = np.random.default_rng(2).standard_normal(40)
    y, x = np.full(40, 7.0), np.full(40, 7.0)
    factors.multiply(t, y)
    factors.solve(t, x)
    equal(y[rows], S @ t[rows], 1e-13)
    equal(regularised @ x[rows], t[rows], 1e-11)
    agree(np.all(y[:5] == 7.0) and np.all(x[28:] == 7.0))
    many = np.random.default_rng(3).standard_normal((n, 4))
    equal(factors.multiply_many(0, many), S @ many, 1e-13)
    equal(regularised @ factors.solve_many(0, many), many, 1e-11)
    negative = np.count_nonzero(np.linalg.eigvalsh(regularised) < 0)
    agree((negative > 0) == (shift < 10.0))
    agree(factors.pivots(0) == (negative, 0) and factors.pivots(1) == (0, 0))
    scaled_E, scaled_D = factors.solve_border(0)
    E = rho * np.linalg.solve(regularised, R)
    equal(rho * scaled_E, E, 1e-11)
    equal(-(rho**2) * scaled_D, rho * (np.eye(k) - R.T @ E), 1e-10)
    packed = n * (n + 1) / 2
    entries = packed + (n * n if negative else packed)
    small(factors.memory() - entries * 8 / 2**20, 1e-12)


def test_new_columns_after_the_first_inversion():
    """The block S survives its own inversion."""
    S = random_symmetric(12, 20.0)
    R = np.linalg.qr(np.random.default_rng(1).standard_normal((12, 2)))[0]
    factors = DenseFactors([np.arange(12, dtype=np.int32)])
    factors.set_block(0, pack(S))
    for columns in (R[:, :1], R, R[:, :0]):
        factors.update_block(0, columns, 3.0)
        inverse = factors.solve_many(0, np.eye(12))
        equal(inverse @ (S + 3.0 * columns @ columns.T), np.eye(12), 1e-12)
        equal(factors.multiply_many(0, np.eye(12)), S, 1e-14)


def test_zero_eigenvalues_are_counted():
    S = np.diag([1.0, 2.0, 0.0, 3.0, 0.0])
    factors = DenseFactors([np.arange(5, dtype=np.int32)])
    factors.set_block(0, pack(S))
    factors.update_block(0, np.zeros((5, 0)), 1.0)
    agree(factors.pivots(0) == (0, 2))


def test_nan_is_no_inverse():
    factors = DenseFactors([np.arange(2, dtype=np.int32)])
    with raises(FactorError, "NaN or Inf"):
        factors.set_block(0, np.full(3, np.nan))


@every_type
@every_change
@pytest.mark.parametrize("way", ["dense", "front", "partial", "columns"])
def test_elimination_is_exact(kind, change, way, torn_grid, parts, monkeypatch):
    """S by all ways, S u_Γ = f̂ with K u = f inside, and the inertia of K_II."""
    if way != "dense":
        monkeypatch.setattr(elimination, "SMALL", -1)
    if way in ("partial", "columns"):
        monkeypatch.setattr(elimination, "load_fronts_for", lambda *_: None)
    if way == "columns":
        monkeypatch.setattr(elimination, "partial_factorisation_is_there", lambda choice: False)
    problem = torn_grid((2, 2), (4, 3), components=2, change=change)
    system = parts(problem.A, type=kind, interior="eliminate")
    torn, matrices, fixed = system.torn, system.matrices, system.inverse.fixed
    agree(type(matrices._elimination).__name__.startswith(way.title().rstrip("s")))
    K = problem.K_torn[torn.start : torn.start + torn.n, torn.start : torn.start + torn.n]
    f = np.where(fixed, 0.0, np.random.default_rng(SEED).standard_normal(torn.n))
    condensed = matrices.condense(f)
    equal(matrices.condense(np.column_stack([f, -2.0 * f]))[:, 1], -2.0 * condensed, 1e-12)
    errors = [0.0]
    for rows, Γ in zip(torn.subdomains, matrices.dofs, strict=True):
        free = rows[~fixed[rows]]
        S = complement(K[np.ix_(free, free)], np.searchsorted(free, Γ))
        t = np.zeros(torn.n)
        t[Γ] = np.random.default_rng(SEED + 1).standard_normal(len(Γ))
        errors.append(np.abs(matrices.multiply(t)[Γ] - S @ t[Γ]).max() / np.abs(S).max())
        u = matrices.extend(t, f)
        errors.append(np.abs(u[Γ] - t[Γ]).max())
        inside = np.setdiff1d(free, Γ)
        errors.append(np.abs(torn.multiply(u)[inside] - f[inside]).max(initial=0.0))
        reaction = torn.multiply(u)[Γ] - f[Γ]
        errors.append(np.abs(S @ t[Γ] - condensed[Γ] - reaction).max() / np.abs(S).max())
    small(max(errors), 1e-11)
    agree(np.all(condensed[np.setdiff1d(np.arange(torn.n), np.concatenate(matrices.dofs))] == 0.0))


@every_type
@every_change
def test_dual_system_is_that_of_the_kept_interior(kind, change, torn_grid, parts):
    """M without props is the same matrix, and F on balanced multipliers where K R = 0."""
    problem = torn_grid((2, 2), (4, 3), components=2, change=change)
    kept, eliminated = (
        parts(problem.A, type=kind, interior=choice) for choice in ("keep", "eliminate")
    )
    for system in (kept, eliminated):
        pc = system.preconditioner
        pc._prop([np.zeros((len(Γ), 0)) for Γ in pc.interface])
    M, S = (
        matrix_of_map(lambda r, M=s.preconditioner: M.apply(r)[0], s.dual.m)
        for s in (kept, eliminated)
    )
    equal(S, M, 1e-11)
    agree(eliminated.coarse.total == kept.coarse.total or change is not None)
    if change is None:
        F, F_eliminated = (matrix_of_map(s.dual.flexibility, s.dual.m) for s in (kept, eliminated))
        G = dense(kept.coarse.G)
        P = np.eye(len(F)) - G @ np.linalg.solve(G.T @ G, G.T)
        equal(P @ F_eliminated @ P, P @ F @ P, 1e-10)
        agree(all(eliminated.modes.exact))


@every_type
@every_change
@pytest.mark.parametrize("pc_type", ["dirichlet", "lumped", "identity", "none"])
@pytest.mark.parametrize("most", [-1, elimination.SMALL], ids=["sparse", "dense"])
def test_solutions_agree(kind, change, pc_type, most, torn_grid, feti, monkeypatch):
    """Both ways to the same solution, and equally fast.

    The residuals are the same in exact arithmetic. In floating point, directions lose their
    orthogonality sooner or later, and with them the last digits their iteration: what is compared
    is when six digits were reached.
    """
    monkeypatch.setattr(elimination, "SMALL", most)
    problem = torn_grid((2, 2), (4, 3), components=2, change=change)
    found, iterations = [], []
    for choice in ("keep", "eliminate"):
        ksp = feti(
            problem.A,
            feti_type=kind,
            feti_pc_type=pc_type,
            feti_interior=choice,
            ksp_rtol=1e-11,
        )
        ksp.setConvergenceHistory()
        b, x = problem.A.createVecs()
        first, last = b.getOwnershipRange()
        b.array[:] = np.random.default_rng(SEED).standard_normal(b.getSize())[first:last]
        ksp.solve(b, x)
        agree(ksp.getConvergedReason() > 0, ksp.getPythonContext().message)
        agree(ksp.getPythonContext().report().interior in (choice + "d", "kept"))
        found.append(whole(x.array_r))
        norms = ksp.getConvergenceHistory()
        iterations.append(int(np.argmax(norms <= 1e-6 * norms[0])))
        b.destroy()
        x.destroy()
    equal(found[1], found[0], 1e-8)
    agree(change is not None or abs(iterations[0] - iterations[1]) <= 2, iterations)


def test_unsymmetric_matrices_are_kept(torn_grid, feti):
    """`auto` keeps; `eliminate` is refused by a reason with a message."""
    rng = np.random.default_rng(SEED)

    def skew(K, dofs):
        for k in K:
            k += 0.01 * np.triu(rng.standard_normal(k.shape), 1) * (k != 0.0)

    problem = torn_grid((2, 2), (3, 3), change=skew)
    b, x = problem.A.createVecs()
    b.set(1.0)
    ksp = feti(problem.A)
    ksp.solve(b, x)
    agree(ksp.getPythonContext().report().interior == "kept")
    ksp = feti(problem.A, feti_interior="eliminate")
    ksp.solve(b, x)
    agree(ksp.getConvergedReason() == PETSc.KSP.ConvergedReason.DIVERGED_PCSETUP_FAILED)
    agree("interior is eliminate" in ksp.getPythonContext().message)
    b.destroy()
    x.destroy()


def test_part_without_an_interface_is_singular(torn_grid, feti):
    """A subdomain that nothing glues or holds has its kernel inside."""
    problem = torn_grid((1, 1), (3, 3), components=2, fixed=lambda x: x[:, 0] < -1.0)
    b, x = problem.A.createVecs()
    b.set(1.0)
    ksp = feti(problem.A, feti_interior="eliminate")
    ksp.solve(b, x)
    agree(ksp.getConvergedReason() == PETSc.KSP.ConvergedReason.DIVERGED_PCSETUP_FAILED)
    agree("kernel of dimension 3" in ksp.getPythonContext().message)
    b.destroy()
    x.destroy()


@pytest.mark.parametrize(
    ("n", "on_interface", "worth"),
    [(45, 42, True), (3300, 950, True), (8900, 2300, False), (1300, 700, False)],
    ids=["small", "part of a thin wall", "large cube", "compact"],
)
def test_choice(n, on_interface, worth):
    """Dense blocks for thin walls and small subdomains, sparse factors for compact large ones."""
    glued = np.arange(n) < on_interface
    torn = SimpleNamespace(comm=COMM)
    agree(worth_condensing(torn, [np.arange(n, dtype=np.int32)] * 2, glued) == worth)
