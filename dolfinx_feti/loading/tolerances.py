# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A context in which the tolerances of a Newton solver are looser."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from petsc4py import PETSc

__all__ = ["loose_tolerances"]


@contextmanager
def loose_tolerances(
    snes: PETSc.SNES, *, rtol: float = 0.0, atol: float = 0.0, linear_rtol: float = 0.0
) -> Iterator[None]:
    """Return a context in which tolerances are at least as large as given values.

    Args:
        snes: The Newton solver.
        rtol: Smallest relative tolerance of the Newton solver.
        atol: Smallest absolute tolerance of the Newton solver, in the unit of the residual.
        linear_rtol: Smallest relative tolerance of its linear solver.
    """
    ksp = snes.getKSP()
    newton_tolerances = snes.getTolerances()
    linear_tolerances = ksp.getTolerances()
    newton_rtol, newton_atol, *_ = newton_tolerances
    own_linear_rtol, *_ = linear_tolerances
    snes.setTolerances(rtol=max(newton_rtol, rtol), atol=max(newton_atol, atol))
    ksp.setTolerances(rtol=max(own_linear_rtol, linear_rtol))
    try:
        yield
    finally:
        snes.setTolerances(*newton_tolerances)
        ksp.setTolerances(*linear_tolerances)
