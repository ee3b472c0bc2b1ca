# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The columns X = A⁻¹ B of a bordered system, each as accurate as the scalars require.

A column contributes :math:`(B_k - A X_k)\, s_k` to the residual of :math:`x = y - X s`. How
accurate it has to be thus depends on s, which in turn follows from X. Both are computed in turn:
each pass corrects the columns whose residual is above the allowed one, and then computes s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.scalars.border import BlockElimination
from dolfinx_feti.scalars.bordered_system import BorderedSystem, norms_of_columns
from dolfinx_feti.scalars.matrix_solver import MatrixSolver

__all__ = ["Columns", "solve_for_columns"]

#: Largest number of passes. One is often enough; this guards against endless loops.
MAX_PASSES = 4


@dataclass(frozen=True, slots=True)
class Columns:
    """Columns X ≈ A⁻¹ B, and the block elimination with them.

    Attributes:
        elimination: Block elimination with X.
        relative_residual: Bound of ‖(B − A X) s‖/(‖b‖ + Σ ‖B_k‖ |s_k|).
    """

    elimination: BlockElimination
    relative_residual: float


def solve_for_columns(
    solver: MatrixSolver, system: BorderedSystem, y: Array, first_X: Array, *, first_rtol: float
) -> Columns:
    """Solve A X = B. Collective.

    Args:
        solver: Solves with A.
        system: The bordered system.
        y: A⁻¹ b, (N,).
        first_X: First iterate of X, (N, m).
        first_rtol: Relative residual ‖B_k − A X_k‖/‖B_k‖ that the first pass allows, before there
            is an s.

    Returns:
        The columns. Once S is singular, there is no s by which to correct them further.

    Raises:
        MatrixSolveError: A solve with A has failed.
    """
    B = system.border.B
    X = first_X.copy()
    R = B - system.product(X)  # B − A X
    allowed = first_rtol * system.B_norms
    for _ in range(MAX_PASSES):
        for k in np.flatnonzero(norms_of_columns(R, system.comm) > allowed):
            X[:, k] += solver.solve_to(R[:, k], rtol=0.0, atol=allowed[k])
            R[:, k : k + 1] = B[:, k : k + 1] - system.product(X[:, k : k + 1])
        elimination = BlockElimination(system.border, X, system.comm)
        s = elimination.solve_for_scalars(y, system.d)
        residuals = norms_of_columns(R, system.comm)
        allowed = system.allowed_residuals(s, rtol=solver.rtol, atol=solver.atol)
        if elimination.is_singular or np.all(residuals <= allowed):
            break
    relative_residual = float(np.abs(s) @ residuals) / (system.scale(s) or 1.0)
    return Columns(elimination, relative_residual)
