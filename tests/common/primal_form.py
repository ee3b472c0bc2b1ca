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

from dolfinx_feti.feti.coarse.averaged import AveragedBasis
from dolfinx_feti.feti.interface.copies import Copies
from dolfinx_feti.feti.pattern import Pattern
from dolfinx_feti.feti.primal.formulation import PrimalFormulation, create_primal_formulation
from dolfinx_feti.feti.primal.krylov.conjugate_gradients import conjugate_gradients
from dolfinx_feti.feti.primal.preconditioner import PrimalPreconditioner
from dolfinx_feti.feti.primal.stopping import StoppingTest
from dolfinx_feti.feti.primal.system import PrimalSystem
from dolfinx_feti.feti.setup import Setup, set_up
from dolfinx_feti.feti.solve_info import KrylovInfo
from dolfinx_feti.runtime.lifetime import Lifetime

Array = npt.NDArray[np.float64]


def cg(
    system: PrimalSystem, f: Array, *, rtol: float = 1e-10, max_it: int = 200
) -> tuple[Array, KrylovInfo]:
    """Solve by conjugate gradients until ‖r‖ ≤ rtol ‖b‖; return the solution and how it ended."""
    target = rtol * system.norm(system.copies.sum(f))
    x, info, _ = conjugate_gradients(
        system,
        f,
        StoppingTest(target, max_it),
        monitor=lambda its, norm: None,
        stored_iterations=0,
        allow_indefinite=False,
    )
    return x, info


def create(
    pattern: Pattern,
    within: Lifetime,
    further_columns: Callable[[Setup, Copies], list[Array]] | None = None,
) -> PrimalFormulation:
    """Build the primal form of a matrix.

    Args:
        pattern: Pattern of the torn matrix.
        within: Owner of PETSc's objects.
        further_columns: Returns further columns of the coarse space for each subdomain,
            (n_{Γ,i}, k) each; it has E alone if not given.
    """
    setup = set_up(pattern, matrix_objects=within, preconditioner_objects=within)
    S = setup.operator
    copies = within.own(Copies(pattern.torn, S.interfaces, setup.delta, pattern.errors))
    U = [K_i.E_on_interface for K_i in setup.inverse.by_subdomain]
    if further_columns is not None:
        U = [np.hstack(pair) for pair in zip(U, further_columns(setup, copies), strict=True)]
    V = within.own(AveragedBasis(copies, U))
    preconditioner = PrimalPreconditioner(setup.delta, setup.inverse, setup.inertia, V)
    return create_primal_formulation(pattern, S, preconditioner, within)


@dataclass(frozen=True, slots=True)
class Dense:
    """The operators of the primal form as dense matrices, whole on each process.

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


def reference(problem: HandTorn, form: PrimalFormulation) -> Dense:
    """Compute the dense operators from the local matrices, and from R and ρ of the primal form."""
    torn = form.pattern.torn
    operator = form.operator
    copies = form.system.copies
    rows = whole(copies.dofs + torn.first_torn_dof)
    is_fixed = whole(form.pattern.is_fixed)
    interior_dofs = np.setdiff1d(np.flatnonzero(~is_fixed), rows)
    K = problem.K_torn
    interior = np.ix_(interior_dofs, interior_dofs)
    free = np.concatenate([rows, interior_dofs])

    def condensed(K: Array) -> Array:
        X = np.linalg.solve(K[interior], K[np.ix_(interior_dofs, rows)])
        return K[np.ix_(rows, rows)] - K[np.ix_(rows, interior_dofs)] @ X

    R_all = on_torn_dofs(form, [modes.R for modes in form.modes])
    ρ_R = on_torn_dofs(form, [modes.rho * modes.R for modes in form.modes])
    if not operator.is_interior_eliminated:
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
