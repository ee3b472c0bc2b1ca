# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""PETSc's algebraic multigrid for the assembled matrix, and how far two solutions are apart."""

from __future__ import annotations

from petsc4py import PETSc

__all__ = ["create_gamg", "difference"]


def create_gamg(K: PETSc.Mat, *, rtol: float) -> PETSc.KSP:
    """Return CG with smoothed aggregation and the near kernel of the matrix.

    Args:
        K: Assembled matrix.
        rtol: On the true residual.

    Returns:
        The KSP, with the prefix ``gamg_``; the caller destroys it.
    """
    ksp = PETSc.KSP().create(K.comm)
    ksp.setOptionsPrefix("gamg_")
    ksp.setOperators(K)
    ksp.setType(PETSc.KSP.Type.CG)
    ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
    ksp.setTolerances(rtol=rtol, max_it=2000)
    ksp.getPC().setType(PETSc.PC.Type.GAMG)
    ksp.setFromOptions()
    return ksp


def difference(x: PETSc.Vec, reference: PETSc.Vec | None) -> float | None:
    """Return ‖x − reference‖/‖reference‖, or None without a reference."""
    if reference is None:
        return None
    y = x.copy()
    y.axpy(-1.0, reference)
    norm = y.norm()
    y.destroy()
    return norm / reference.norm()
