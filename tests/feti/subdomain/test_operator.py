# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Interior dofs eliminated: the same method, written for Schur complements."""

from types import SimpleNamespace

from petsc4py import PETSc

import numpy as np
import pytest
from cases import each, every_type
from collective import COMM, agree, dense, equal, matrix_of_map, small
from hand_torn import random_values, scaled_diagonal, solve, unsymmetric
from modes import modes_of

from dolfinx_feti.feti.dual.preconditioner import Dirichlet
from dolfinx_feti.feti.subdomain import analysis
from dolfinx_feti.feti.subdomain.analysis import worth_eliminating
from dolfinx_feti.feti.subdomain.factors.multifrontal import FrontFactor

SEED = 31
Reason = PETSc.KSP.ConvergedReason
CHANGES = {
    "no prestress": None,
    "prestress": scaled_diagonal(1.01),
    "compression": scaled_diagonal(0.99),
}
every_change = each("change", CHANGES)
INDEFINITE = scaled_diagonal(0.5)


def complement(K, Γ):
    I = np.setdiff1d(np.arange(len(K)), Γ)  # noqa: E741
    return K[np.ix_(Γ, Γ)] - K[np.ix_(Γ, I)] @ np.linalg.solve(K[np.ix_(I, I)], K[np.ix_(I, Γ)])


@every_type
@each("change", CHANGES | {"indefinite": INDEFINITE})
@pytest.mark.parametrize("way", ["fronts", "pivots"])
def test_elimination_is_exact(kind, change, way, torn_grid, parts, monkeypatch):
    """S by all ways, S u_Γ = f̂ with K u = f inside, and the inertia of K_II."""
    if way == "pivots":
        monkeypatch.setattr(analysis, "load_fronts_for", lambda *_: None)
    problem = torn_grid((2, 2), (6, 5), components=2, change=change)
    system = parts(problem.A, type=kind, interior="eliminate")
    torn, operator, fixed = system.torn, system.operator, system.pattern.dofs.fixed
    fronts = [isinstance(factor, FrontFactor) for factor in operator.interior_factors]
    agree(not any(fronts) if way == "pivots" or change is INDEFINITE else all(fronts))
    K = problem.K_torn[torn.start : torn.start + torn.n, torn.start : torn.start + torn.n]
    f = np.where(fixed, 0.0, np.random.default_rng(SEED).standard_normal(torn.n))
    condensed = operator.condense(f)
    errors, negative = [0.0], 0
    for rows, Γ in zip(torn.subdomains, operator.dofs, strict=True):
        free = rows[~fixed[rows]]
        inside = np.setdiff1d(free, Γ)
        negative += np.count_nonzero(np.linalg.eigvalsh(K[np.ix_(inside, inside)]) < 0.0)
        S = complement(K[np.ix_(free, free)], np.searchsorted(free, Γ))
        t = np.zeros(torn.n)
        t[Γ] = np.random.default_rng(SEED + 1).standard_normal(len(Γ))
        errors.append(np.abs(operator.multiply(t)[Γ] - S @ t[Γ]).max() / np.abs(S).max())
        u = operator.extend(t, f)
        errors.append(np.abs(u[Γ] - t[Γ]).max())
        errors.append(np.abs(torn.multiply(u)[inside] - f[inside]).max(initial=0.0))
        reaction = torn.multiply(u)[Γ] - f[Γ]
        errors.append(np.abs(S @ t[Γ] - condensed[Γ] - reaction).max() / np.abs(S).max())
    small(max(errors), 1e-10 if change is INDEFINITE else 1e-11)
    agree(operator.negative_interior() == negative and (negative > 0) == (change is INDEFINITE))
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
