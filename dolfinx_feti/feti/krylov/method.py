# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The Krylov method for the dual system, stopped by the residual of the assembled system.

Conjugate gradients are safe as long as the dual system is positive definite on the balanced pairs
(λ, s), that is if neither a regularised subdomain nor the defect D has a negative eigenvalue
(``definite``); otherwise GMRES takes over. Every application of the constraint preconditioner to a
jump also tells the force :math:`\|T^⊤ t\|` which that jump leaves out of balance: this is the
residual of the assembled system, and CG stops on it, with D ≠ 0 after a look at the true jump (the
best motion s of the kernels is at hand for D = 0 only). GMRES knows the norm of the jump only; it
falls in a proportion to the force that changes slowly: it measures the force when the proportion
last seen promises convergence, and every few iterations. Where subdomains are nearly singular
the residual that GMRES updates parts from the true one; it then ends, for a fresh start on what is
left (``feti_refine``).

The coefficients of CG are those of Lanczos' method. Rounding makes its vectors lose their
orthogonality to the eigenvectors that have converged: copies of these appear (ghosts), and
iterations are spent on them. ``feti_dual_reorthogonalize`` takes PETSc's flexible CG instead, which
makes each direction F-orthogonal to all earlier ones, and so needs two vectors an iteration.
"""

from __future__ import annotations

from collections.abc import Callable

from petsc4py import PETSc

import numpy as np

from dolfinx_feti.events import event
from dolfinx_feti.feti.krylov.dual import ConstraintPreconditioner, DualVector
from dolfinx_feti.feti.krylov.recycling import Recycling
from dolfinx_feti.petsc_options import inserted

__all__ = ["Krylov"]

Reason = PETSc.KSP.ConvergedReason
Monitor = Callable[[int, float], None]

#: By how much the proportion of force to jump may have fallen before GMRES measures it.
OPTIMISM = 0.1

#: Iterations between two measurements in GMRES.
INTERVAL = 10

#: Quotient of true and updated residual at which GMRES has lost its way.
PARTED = 2.0

#: Iterations for which there is room: PETSc allocates Lanczos' coefficients once, at set-up.
ROOM = 100_000


class Krylov:
    """An inner KSP on (λ, s).

    Attributes:
        ksp: The PETSc solver, with prefix ``…feti_dual_``.
        recycling: What earlier solves have left.
        users_test: Whether the user's own ``ksp_rtol`` or ``ksp_atol`` decides, not the residual of
            the assembled system.
        eigenvalues: Extreme Ritz values of the last CG solve, (λ_min, λ_max).
    """

    def __init__(
        self,
        recycling: Recycling,
        preconditioner: ConstraintPreconditioner,
        vector: DualVector,
        *,
        definite: bool,
        prefix: str,
        stagnation: int,
        reorthogonalize: bool,
    ) -> None:
        """Create the solver; nothing is solved yet.

        Args:
            recycling: The dual system and its preconditioner, with what earlier solves have left.
            preconditioner: The constraint preconditioner in it.
            vector: Splits and joins (λ, s).
            definite: Whether CG is safe.
            prefix: Options prefix.
            stagnation: Iterations without a new least residual that end the solve.
            reorthogonalize: Keep CG's directions orthogonal to all earlier ones.
        """
        self._preconditioner = preconditioner
        self.recycling = recycling
        self.x = vector.create()
        self.b = self.x.duplicate()
        sizes = (self.x.getSizes(), self.x.getSizes())
        self._mat = PETSc.Mat().createPython(sizes, recycling, comm=self.x.comm)
        self._mat.setUp()
        self.ksp = PETSc.KSP().create(self.x.comm)
        self.ksp.setOptionsPrefix(prefix)
        self.ksp.setOperators(self._mat)
        self.ksp.setType(PETSc.KSP.Type.CG if definite else PETSc.KSP.Type.GMRES)
        self.ksp.setGMRESRestart(200)
        own = PETSc.Options(prefix)
        full = reorthogonalize and own.getString("ksp_type", self.ksp.getType()) == "cg"
        pc = self.ksp.getPC()
        pc.setType(PETSc.PC.Type.PYTHON)
        pc.setPythonContext(recycling)
        self.ksp.setComputeSingularValues(True)
        with inserted(prefix, {"ksp_type": "fcg", "ksp_fcg_mmax": ROOM} if full else {}):
            self.ksp.setFromOptions()
        if self.ksp.getType() in ("gmres", "fgmres"):
            self.ksp.setPCSide(PETSc.PC.Side.RIGHT)  # its residual then is the jump
        preconditioner.frozen = preconditioner.exact and self.is_cg
        self.users_test = any(own.hasName(f"ksp_{key}") for key in ("rtol", "atol"))
        if not self.users_test:
            self.ksp.setTolerances(max_it=ROOM)
        self._stagnation = stagnation
        self.eigenvalues = (np.nan, np.nan)

    @property
    def is_cg(self) -> bool:
        """Whether the preconditioner is only applied to residuals."""
        return self.ksp.getType() in ("cg", "fcg", "pipecg")

    def solve(self, *, target: float, max_it: int, monitor: Monitor) -> int:
        """Solve for the pair in ``x`` with the jump in ``b`` as right-hand side.

        Args:
            target: Wanted norm of the residual of the assembled system.
            max_it: Most iterations.
            monitor: Called with (iteration, norm of the residual of the assembled system).

        Returns:
            The converged reason.
        """
        first = self.recycling.start(self.b)
        jump = self.b.norm()
        test = _Test(
            self._preconditioner,
            self.recycling,
            target,
            self._stagnation,
            max_it,
            cg=self.is_cg,
            first=self._preconditioner.force(self.b) / jump if jump and not self.is_cg else 0.0,
            monitor=monitor,
        )
        if self.users_test:
            self.ksp.setMonitor(lambda ksp, its, rnorm: test.measure(its, rnorm))
        else:
            self.ksp.setConvergenceTest(test)
        with event("FETIIterations"):
            self.ksp.solve(self.b, self.x)
        self.x.array[:] += first
        if self.users_test:
            self.ksp.monitorCancel()
        else:
            self.ksp.setConvergenceTest(None)  # it refers to the outer solver, which owns this one
        if self.is_cg and self.ksp.getIterationNumber() > 0:
            self.eigenvalues = self._ritz_values()
        return self.ksp.getConvergedReason()

    def _ritz_values(self) -> tuple[float, float]:
        """Return the extreme Ritz values; nan if CG has met a NaN."""
        try:
            high, low = self.ksp.computeExtremeSingularValues()
        except PETSc.Error:  # LAPACK does not accept the coefficients
            return np.nan, np.nan
        return low, high

    def destroy(self) -> None:
        """Free solver and vectors."""
        for owned in (self.ksp, self._mat, self.x, self.b):
            owned.destroy()


class _Test:
    """Convergence test: the residual of the assembled system, its stagnation, and NaN."""

    def __init__(
        self,
        preconditioner: ConstraintPreconditioner,
        recycling: Recycling,
        target: float,
        stagnation: int,
        max_it: int,
        *,
        cg: bool,
        first: float,
        monitor: Monitor,
    ) -> None:
        self._preconditioner = preconditioner
        self._recycling = recycling
        self._target = target
        self._stagnation = stagnation
        self._max_it = max_it
        self._cg = cg
        self._monitor = monitor
        self._proportion = 1.0 if cg else first
        self._best = (np.inf, 0)
        self._next = np.inf if cg else INTERVAL

    def measure(self, its: int, rnorm: float) -> float:
        """Return the norm of the residual of the assembled system, in GMRES an estimate."""
        if not self._cg and its == 1:
            # right preconditioning: what was applied last is the first jump, scaled to one
            self._proportion = OPTIMISM * self._preconditioner.imbalance
        norm = self._indicator(rnorm) * self._proportion
        self._monitor(its, norm)
        return norm

    def __call__(self, ksp: PETSc.KSP, its: int, rnorm: float) -> int:
        norm = self.measure(its, rnorm)
        if not np.isfinite(rnorm) or np.isinf(norm):
            return Reason.DIVERGED_NANORINF
        sure = self._cg and self._preconditioner.exact
        if not sure and (norm <= self._target or its >= self._next):
            norm, jump = self._measure_again(ksp, rnorm)
            self._next = its + INTERVAL
            if not self._cg and norm > self._target and jump > PARTED * rnorm:
                return Reason.CONVERGED_ITS
        if norm <= self._target or rnorm == 0.0:
            return Reason.CONVERGED_RTOL
        if norm < self._best[0]:
            self._best = (norm, its)
        if self._stagnation and its - self._best[1] >= self._stagnation:
            return Reason.DIVERGED_BREAKDOWN
        if its >= self._max_it:
            return Reason.DIVERGED_MAX_IT
        return Reason.ITERATING

    def _measure_again(self, ksp: PETSc.KSP, rnorm: float) -> tuple[float, float]:
        """Form the jump of the present iterate; return the norms of its force and of itself."""
        with self._recycling.paused():  # no product of the Krylov method's own
            r = ksp.buildResidual()
        indicator = self._indicator(rnorm)  # before force() measures anew
        norm, jump = self._preconditioner.force(r), r.norm()
        r.destroy()
        self._proportion = norm / indicator if indicator > 0.0 else 0.0
        return norm, jump

    def _indicator(self, rnorm: float) -> float:
        """Return what is known of the residual without a further product with F."""
        return self._preconditioner.imbalance if self._cg else rnorm
