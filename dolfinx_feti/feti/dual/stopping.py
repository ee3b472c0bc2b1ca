# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""When a Krylov method stops: the residual of the assembled system, its stagnation, and NaN.

Every preconditioned residual tells the norm :math:`\|T^⊤ t\|` of that of the *assembled* system. CG
stops on it, and forms the residual once more where it is an estimate (``exact`` is False). GMRES
knows that of the jump: the other one is measured when it promises convergence, and every few
iterations. A fresh start follows stagnation, or a residual that departs from the true one.
"""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np

from dolfinx_feti.feti.dual.system import DualSystem
from dolfinx_feti.feti.solution import STAGNATION, Monitor
from dolfinx_feti.runtime.arrays import Array

__all__ = ["StoppingTest"]

Reason = PETSc.KSP.ConvergedReason

#: By how much the proportion of the two residuals may have fallen before GMRES measures it.
OPTIMISM = 0.1

#: Iterations between two measurements in GMRES.
INTERVAL = 10

#: Quotient of true and updated residual above which GMRES starts afresh.
DEPARTED = 2.0


class StoppingTest:
    """Convergence test of a KSP.

    Attributes:
        best: The iterate with the least residual, where the method has it at hand (CG); else None.
    """

    def __init__(
        self,
        system: DualSystem,
        *,
        target: float,
        max_it: int,
        cg: bool,
        first: float,
        monitor: Monitor,
    ) -> None:
        """Prepare a test for one solve to a target of the residual of the assembled system.

        With ``cg`` the preconditioner is applied to residuals alone; else ``first`` is the
        proportion of that residual to the method's own norm at the start.
        """
        self._system = system
        self._target, self._max_it = target, max_it
        self._cg, self._monitor = cg, monitor
        self._proportion = 1.0 if cg else first
        self._least = (np.inf, 0)
        self._next = np.inf if cg else INTERVAL
        self.best: Array | None = None

    def measure(self, its: int, rnorm: float) -> float:
        """Return the norm of the residual of the assembled system, in GMRES an estimate."""
        if not self._cg and its == 1:
            # right preconditioning: what was applied last is the first jump, scaled to one
            self._proportion = OPTIMISM * self._system.norm
        norm = self._indicator(rnorm) * self._proportion
        self._monitor(its, norm)
        return norm

    def __call__(self, ksp: PETSc.KSP, its: int, rnorm: float) -> int:
        """Return the converged reason after an iteration."""
        norm = self.measure(its, rnorm)
        if not np.isfinite(rnorm) or np.isinf(norm):
            return Reason.DIVERGED_NANORINF
        sure = self._cg and self._system.exact
        if not sure and (norm <= self._target or its >= self._next):
            norm, true = self._measure_again(ksp, rnorm)
            self._next = its + INTERVAL
            if self._departed(ksp, norm, true, rnorm):
                return Reason.CONVERGED_ITS
        if norm <= self._target or rnorm == 0.0:
            return Reason.CONVERGED_RTOL
        if norm < self._least[0]:
            self._least = (norm, its)
            self.best = ksp.getSolution().array_r.copy() if self._cg else None
        if its - self._least[1] >= STAGNATION:
            return Reason.CONVERGED_ITS  # for a fresh start
        if its >= self._max_it:
            return Reason.DIVERGED_MAX_IT
        return Reason.ITERATING

    def _measure_again(self, ksp: PETSc.KSP, rnorm: float) -> tuple[float, float]:
        """Form the residual of the present iterate; return its two norms."""
        indicator = self._indicator(rnorm)  # before another vector is preconditioned
        r = ksp.buildResidual()
        norm, true = self._system.unbalanced(r.array_r), r.norm()
        r.destroy()
        self._proportion = norm / indicator if indicator > 0.0 else 0.0
        return norm, true

    def _departed(self, ksp: PETSc.KSP, norm: float, true: float, rnorm: float) -> bool:
        """Tell whether the method's own residual is not that of its iterate any more."""
        own = not self._cg and ksp.getNormType() == PETSc.KSP.NormType.UNPRECONDITIONED
        return own and norm > self._target and true > DEPARTED * rnorm

    def _indicator(self, rnorm: float) -> float:
        """Return what is known of the residual without a further product."""
        return self._system.norm if self._cg else rnorm
