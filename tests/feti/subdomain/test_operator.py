# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Interior dofs eliminated: the same method, written for Schur complements."""

from __future__ import annotations

from types import SimpleNamespace

from petsc4py import PETSc

import numpy as np
import pytest
from collective import COMM, agree, dense, equal, matrix_of_map, raises, small
from hand_torn import random_values, solve, unsymmetric
from modes import modes_of

from dolfinx_feti.errors import FactorError
from dolfinx_feti.feti.dual.preconditioner import Dirichlet
from dolfinx_feti.feti.subdomain import analysis
from dolfinx_feti.feti.subdomain.analysis import worth_eliminating
from dolfinx_feti.feti.subdomain.factors.dense import DenseFactor, PackedMatrix, pack
from dolfinx_feti.feti.subdomain.factors.multifrontal import FrontFactor
from dolfinx_feti.feti.subdomain.factors.pivoted import PivotedFactor

SEED = 31
Reason = PETSc.KSP.ConvergedReason
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


def complement(K, Γ):
    I = np.setdiff1d(np.arange(len(K)), Γ)  # noqa: E741
    return K[np.ix_(Γ, Γ)] - K[np.ix_(Γ, I)] @ np.linalg.solve(K[np.ix_(I, I)], K[np.ix_(I, Γ)])


def packed(S):
    """The matrix in packed format, with work space of its own."""
    return PackedMatrix(pack(np.asfortranarray(np.tril(S))), len(S), np.empty(len(S) ** 2))


@pytest.mark.parametrize("shift", [40.0, 3.0], ids=["definite", "indefinite"])
def test_dense_factor(shift):
    """S, and the factor of S_ρ with its inertia."""
    n, k, rho = 23, 3, 2.5
    S = random_symmetric(n, shift)
    R = np.linalg.qr(np.random.default_rng(1).standard_normal((n, k)))[0]
    matrix = packed(S)
    factor = DenseFactor(matrix, R, rho)
    regularised = S + rho * R @ R.T
    t = np.random.default_rng(2).standard_normal(n)
    equal(matrix.multiply(t), S @ t, 1e-13)
    equal(regularised @ factor.solve(t), t, 1e-11)
    for columns in (4, 9):
        many = np.random.default_rng(3).standard_normal((n, columns))
        equal(matrix.multiply_many(many), S @ many, 1e-13)
        equal(regularised @ factor.solve(many), many, 1e-11)
    negative = np.count_nonzero(np.linalg.eigvalsh(regularised) < 0)
    agree((negative > 0) == (shift < 10.0))
    agree(factor.pivots == (negative, 0))
    small(matrix.memory() - n * (n + 1) / 2 * 8 / 2**20, 1e-12)
    entries = n * n if negative else n * (n + 1) / 2
    small(factor.memory() - entries * 8 / 2**20, 1e-12)


def test_block_survives_its_factors():
    S = random_symmetric(12, 20.0)
    R = np.linalg.qr(np.random.default_rng(1).standard_normal((12, 2)))[0]
    matrix = packed(S)
    for columns in (R[:, :1], R, R[:, :0]):
        inverse = DenseFactor(matrix, columns, 3.0).solve(np.eye(12))
        equal(inverse @ (S + 3.0 * columns @ columns.T), np.eye(12), 1e-12)
        equal(matrix.multiply_many(np.eye(12)), S, 1e-14)


def test_empty_block():
    factor = DenseFactor(packed(np.zeros((0, 0))))
    agree(factor.pivots == (0, 0) and factor.solve(np.zeros(0)).shape == (0,))
    agree(factor.solve(np.zeros((0, 3))).shape == (0, 3))


def test_zero_pivot_is_an_error():
    with raises(FactorError, "a zero pivot"):
        DenseFactor(packed(np.diag([1.0, 2.0, 0.0, 3.0, 0.0])))


def test_nan_is_no_schur_complement():
    with raises(FactorError, "NaN or Inf"):
        packed(np.full((2, 2), np.nan))


@every_type
@every_change
@pytest.mark.parametrize("way", ["fronts", "pivots"])
def test_elimination_is_exact(kind, change, way, torn_grid, parts, monkeypatch):
    """S by all ways, S u_Γ = f̂ with K u = f inside, and the inertia of K_II."""
    if way == "pivots":
        monkeypatch.setattr(analysis, "load_fronts_for", lambda *_: None)
    problem = torn_grid((2, 2), (4, 3), components=2, change=change)
    system = parts(problem.A, type=kind, interior="eliminate")
    torn, operator, fixed = system.torn, system.operator, system.pattern.dofs.fixed
    kinds = {"dense": DenseFactor, "fronts": FrontFactor, "pivots": PivotedFactor}
    agree(all(isinstance(factor, kinds[way]) for factor in operator.interior_factors))
    K = problem.K_torn[torn.start : torn.start + torn.n, torn.start : torn.start + torn.n]
    f = np.where(fixed, 0.0, np.random.default_rng(SEED).standard_normal(torn.n))
    condensed = operator.condense(f)
    errors = [0.0]
    for rows, Γ in zip(torn.subdomains, operator.dofs, strict=True):
        free = rows[~fixed[rows]]
        S = complement(K[np.ix_(free, free)], np.searchsorted(free, Γ))
        t = np.zeros(torn.n)
        t[Γ] = np.random.default_rng(SEED + 1).standard_normal(len(Γ))
        errors.append(np.abs(operator.multiply(t)[Γ] - S @ t[Γ]).max() / np.abs(S).max())
        u = operator.extend(t, f)
        errors.append(np.abs(u[Γ] - t[Γ]).max())
        inside = np.setdiff1d(free, Γ)
        errors.append(np.abs(torn.multiply(u)[inside] - f[inside]).max(initial=0.0))
        reaction = torn.multiply(u)[Γ] - f[Γ]
        errors.append(np.abs(S @ t[Γ] - condensed[Γ] - reaction).max() / np.abs(S).max())
    small(max(errors), 1e-11)
    agree(np.all(condensed[np.setdiff1d(np.arange(torn.n), np.concatenate(operator.dofs))] == 0.0))


def plain(system):
    """The Dirichlet preconditioner without stabilisation."""
    none = [np.zeros((len(rows), 0)) for rows in system.operator.dofs]
    return Dirichlet(system.operator, system.preconditioner.B_D.matrix, none)


@every_type
@every_change
def test_dual_system_is_that_of_the_kept_interior(kind, change, torn_grid, parts):
    """M without stabilisation is the same matrix, and F on balanced multipliers where K R = 0."""
    problem = torn_grid((2, 2), (4, 3), components=2, change=change)
    kept, eliminated = (
        parts(problem.A, type=kind, interior=choice) for choice in ("keep", "eliminate")
    )
    M, S = (
        matrix_of_map(lambda r, s=s: plain(s).apply(r)[0], s.dual.m) for s in (kept, eliminated)
    )
    equal(S, M, 1e-11)
    agree(eliminated.coarse.total == kept.coarse.total or change is not None)
    if change is None:
        F, F_eliminated = (matrix_of_map(s.dual.flexibility, s.dual.m) for s in (kept, eliminated))
        G = dense(kept.coarse.G)
        P = np.eye(len(F)) - G @ np.linalg.solve(G.T @ G, G.T)
        equal(P @ F_eliminated @ P, P @ F @ P, 1e-10)
        agree(all(modes_of(eliminated).exact))


@every_type
@every_change
@pytest.mark.parametrize("pc_type", ["dirichlet", "lumped", "identity"])
def test_solutions_agree(kind, change, pc_type, torn_grid, feti):
    """Both ways to the same solution, and equally fast.

    The residuals are the same in exact arithmetic. In floating point, directions lose their
    orthogonality sooner or later, and with them the last digits their iteration: what is compared
    is when six digits were reached.
    """
    problem = torn_grid((2, 2), (4, 3), components=2, change=change)
    found, iterations = [], []
    for choice, past in (("keep", "kept"), ("eliminate", "eliminated")):
        options = {"feti_type": kind, "feti_pc_type": pc_type, "feti_interior": choice}
        ksp = feti(problem.A, ksp_rtol=1e-11, **options)
        ksp.setConvergenceHistory()
        reason, x = solve(ksp, problem, random_values(problem, SEED))
        agree(reason > 0, ksp.getPythonContext().message)
        agree(ksp.getPythonContext().report().interior == past)
        found.append(x)
        norms = ksp.getConvergenceHistory()
        iterations.append(int(np.argmax(norms <= 1e-6 * norms[0])))
    equal(found[1], found[0], 1e-8)
    agree(change is not None or abs(iterations[0] - iterations[1]) <= 2, iterations)


def test_unsymmetric_matrices_are_kept(torn_grid, feti):
    """`auto` keeps; `eliminate` is refused by a reason with a message."""
    problem = torn_grid((2, 2), (3, 3), change=unsymmetric(0.01))
    agree(feti(problem.A).getPythonContext().report().interior == "kept")
    ksp = feti(problem.A, feti_interior="eliminate")
    agree(solve(ksp, problem, random_values(problem))[0] == Reason.DIVERGED_PCSETUP_FAILED)
    agree("feti_interior keep" in ksp.getPythonContext().message)


def test_part_without_an_interface_is_singular(torn_grid, feti):
    """A subdomain that nothing glues or holds has its kernel inside."""
    problem = torn_grid((1, 1), (3, 3), components=2, fixed=lambda x: x[:, 0] < -1.0)
    ksp = feti(problem.A, feti_interior="eliminate")
    agree(solve(ksp, problem, random_values(problem))[0] == Reason.DIVERGED_PCSETUP_FAILED)
    agree("kernel of dimension 3" in ksp.getPythonContext().message)


@pytest.mark.parametrize(
    ("n", "on_interface", "condensed", "worth"),
    [
        (45, 42, False, True),
        (3300, 950, False, True),
        (1300, 700, False, False),
        (1300, 700, True, True),
        (8900, 2300, True, False),
    ],
    ids=["small", "part of a thin wall", "compact", "compact, with a pressure", "large"],
)
def test_choice(n, on_interface, condensed, worth):
    """Dense blocks for thin walls, small subdomains, and condensed pressures; not if too large."""
    dofs = SimpleNamespace(free=[np.arange(n)] * 2, interface=[np.arange(on_interface)] * 2)
    torn = SimpleNamespace(comm=COMM, pressures=object() if condensed else None)
    agree(worth_eliminating(torn, dofs) == worth)
