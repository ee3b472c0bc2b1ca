# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Interior dofs eliminated: the same method, written for Schur complements."""

from types import SimpleNamespace

from petsc4py import PETSc

import numpy as np
import pytest
from cases import each, every_type
from collective import COMM, agree, small
from hand_torn import scaled_diagonal

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
