# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The primal form with any columns in its coarse space, and its dense counterparts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from collective import whole
from hand_torn import HandTorn
from modes import on_torn_dofs

from dolfinx_feti.feti.coarse.space import AveragedColumns
from dolfinx_feti.feti.gluing.copies import Copies
from dolfinx_feti.feti.pattern import Pattern
from dolfinx_feti.feti.primal.form import PrimalForm, PrimalPreconditioner, create_primal_form
from dolfinx_feti.feti.primal.krylov import PrimalSystem, conjugate_gradients
from dolfinx_feti.feti.setup import Setup, set_up
from dolfinx_feti.feti.solution import Solution
from dolfinx_feti.runtime.lifetime import Lifetime

Array = npt.NDArray[np.float64]


def cg(
    system: PrimalSystem, f: Array, *, rtol: float = 1e-10, max_it: int = 200
) -> tuple[Array, Solution]:
    """Solve to a share of the norm of the right-hand side."""
    target = rtol * system.norm(system.copies.sum(f))
    x, solution, _ = conjugate_gradients(
        system, f, target=target, max_it=max_it, monitor=lambda its, norm: None
    )
    return x, solution


def create(
    pattern: Pattern, within: Lifetime, more: Callable[[Setup, Copies], list[Array]] | None = None
) -> PrimalForm:
    """Build the primal form of a matrix, with E and these further columns in the coarse space."""
    setup = set_up(pattern, within, within)
    S = setup.operator
    copies = within.own(Copies(pattern.torn, S.interface, setup.delta))
    U = [m.E[on] for m, on in zip(setup.inverse.modes, S.on_interface, strict=True)]
    if more is not None:
        U = [np.hstack(pair) for pair in zip(U, more(setup, copies), strict=True)]
    V = within.own(AveragedColumns(copies, U))
    made = PrimalPreconditioner(setup.delta, setup.inverse, setup.inertia, copies, V)
    return create_primal_form(pattern, S, made, within)


@dataclass(frozen=True, slots=True)
class Dense:
    """The same, dense, with whole matrices on all processes.

    Attributes:
        T: Copies of the free interface dofs, (n, N).
        S: Schur complements, (n, n).
        delta: Weights, (n,).
        S_ρ: Regularised Schur complements, (n, n).
        E: Regularised kernels, (n, k).
    """

    T: Array
    S: Array
    delta: Array
    S_ρ: Array
    E: Array

    @property
    def A(self) -> Array:
        return self.T.T @ self.S @ self.T

    @property
    def average(self) -> Array:
        """Tᵀ δ, (N, n)."""
        return self.T.T * self.delta

    @property
    def V(self) -> Array:
        return self.average @ self.E

    @property
    def coarse(self) -> Array:
        """V A₀⁺ Vᵀ, (N, N)."""
        V = self.V
        return V @ np.linalg.pinv(V.T @ self.A @ V, rcond=1e-10, hermitian=True) @ V.T

    @property
    def preconditioner(self) -> Array:
        """Π Tᵀ δ K_ρ⁻¹ δ T, (N, N)."""
        projection = np.eye(len(self.A)) - self.coarse @ self.A
        return projection @ self.average @ np.linalg.solve(self.S_ρ, self.average.T)


def reference(problem: HandTorn, form: PrimalForm) -> Dense:
    """Compute the dense counterparts from the local matrices, R and ρ."""
    torn, operator, copies = form.pattern.torn, form.operator, form.system.copies
    rows = whole(copies.dofs + torn.start)
    held = whole(form.pattern.dofs.fixed)
    inside = np.setdiff1d(np.flatnonzero(~held), rows)
    K, interior = problem.K_torn, np.ix_(inside, inside)
    free = np.concatenate([rows, inside])

    def condensed(K: Array) -> Array:
        X = np.linalg.solve(K[interior], K[np.ix_(inside, rows)])
        return K[np.ix_(rows, rows)] - K[np.ix_(rows, inside)] @ X

    R_all = on_torn_dofs(form, [modes.R for modes in form.modes])
    ρ_R = on_torn_dofs(form, [modes.rho * modes.R for modes in form.modes])
    if not operator.eliminated:
        K_ρ = K + ρ_R @ R_all.T
        S_ρ = condensed(K_ρ)
        E = np.zeros_like(R_all)
        E[free] = np.linalg.solve(K_ρ[np.ix_(free, free)], ρ_R[free])
        E = E[rows]
    else:
        S_ρ = condensed(K) + ρ_R[rows] @ R_all[rows].T
        E = np.linalg.solve(S_ρ, ρ_R[rows])
    T = problem.T[rows][:, ~problem.dirichlet]
    return Dense(T=T[:, T.any(axis=0)], S=condensed(K), delta=whole(copies.delta), S_ρ=S_ρ, E=E)
