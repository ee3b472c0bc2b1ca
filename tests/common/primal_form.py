# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The primal form built from the parts of a FETI system, and its dense counterparts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.linalg
from collective import COMM, whole
from hand_torn import HandTorn
from modes import modes_of

from dolfinx_feti.feti.coarse.space import AveragedColumns, AveragedSpace
from dolfinx_feti.feti.dual.form import DualForm
from dolfinx_feti.feti.gluing.copies import Copies
from dolfinx_feti.feti.primal.deflation import DeflatedSpace
from dolfinx_feti.feti.primal.krylov import PrimalSystem, conjugate_gradients
from dolfinx_feti.feti.solution import Solution

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PrimalForm:
    """A primal system and the parts that it is made of."""

    parts: DualForm
    space: AveragedSpace
    system: PrimalSystem

    @property
    def copies(self) -> Copies:
        return self.system.copies

    def solve(self, b: Array, u_D: Array, **how: object) -> tuple[Array, Solution]:
        """Solve for an assembled right-hand side and prescribed values, both torn, (n,).

        Returns:
            The torn solution, (n,), and how conjugate gradients ended.
        """
        torn, Γ, S = self.parts.torn, self.copies.dofs, self.parts.operator
        u_D = np.where(torn.dirichlet, u_D, 0.0)
        f = np.where(torn.dirichlet, 0.0, self.parts.delta * b - torn.multiply(u_D))
        x, solution = cg(self.system, S.condense(f)[Γ], **how)
        u = np.zeros(torn.n)
        u[Γ] = x
        u = S.extend(u, f)
        return u + u_D, solution

    def destroy(self) -> None:
        """Free what the form owns."""
        for owned in (self.space, self.space.V, self.copies):
            owned.destroy()


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
    parts: DualForm, more: Callable[[DualForm, Copies], list[Array]] | None = None
) -> PrimalForm:
    """Build the primal form of a FETI system, with E and further columns in the coarse space."""
    S = parts.operator
    copies = Copies(parts.torn, S.interface, parts.delta)

    def torn(t: Array) -> Array:
        u = np.zeros(parts.torn.n)
        u[copies.dofs] = t
        return u

    pairs = zip(modes_of(parts).E, parts.operator.dofs, S.interface, strict=True)
    U = [E[np.isin(dofs, Γ)] for E, dofs, Γ in pairs]
    if more is not None:
        U = [np.hstack(pair) for pair in zip(U, more(parts, copies), strict=True)]
    space = AveragedSpace(AveragedColumns(copies, U), S, prefix="test_feti_coarse_")
    system = PrimalSystem(
        copies,
        DeflatedSpace(space, copies, S.multiply_many, None),
        multiply=lambda t: S.multiply(torn(t))[copies.dofs],
        solve=lambda t: parts.inverse.solve(torn(t))[copies.dofs],
    )
    return PrimalForm(parts, space, system)


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
    parts, Γ = form.parts, form.copies.dofs
    start = parts.torn.start
    rows = whole(Γ + start)
    held = whole(parts.pattern.dofs.fixed)
    inside = np.setdiff1d(np.flatnonzero(~held), rows)
    K, interior = problem.K_torn, np.ix_(inside, inside)
    free = np.concatenate([rows, inside])

    def condensed(K: Array) -> Array:
        X = np.linalg.solve(K[interior], K[np.ix_(inside, rows)])
        return K[np.ix_(rows, rows)] - K[np.ix_(rows, inside)] @ X

    ρ_R = np.zeros((parts.torn.n, 0))
    R_all = ρ_R
    for R, ρ, dofs in zip(modes_of(parts).R, modes_of(parts).rho, parts.operator.dofs, strict=True):
        columns = np.zeros((parts.torn.n, R.shape[1]))
        columns[dofs] = R
        R_all, ρ_R = np.hstack([R_all, columns]), np.hstack([ρ_R, ρ * columns])
    R_all, ρ_R = (scipy.linalg.block_diag(*COMM.allgather(part)) for part in (R_all, ρ_R))
    if not parts.operator.eliminated:
        K_ρ = K + ρ_R @ R_all.T
        S_ρ = condensed(K_ρ)
        E = np.zeros_like(R_all)
        E[free] = np.linalg.solve(K_ρ[np.ix_(free, free)], ρ_R[free])
        E = E[rows]
    else:
        S_ρ = condensed(K) + ρ_R[rows] @ R_all[rows].T
        E = np.linalg.solve(S_ρ, ρ_R[rows])
    T = problem.T[rows][:, ~problem.dirichlet]
    return Dense(
        T=T[:, T.any(axis=0)], S=condensed(K), delta=whole(form.copies.delta), S_ρ=S_ρ, E=E
    )
