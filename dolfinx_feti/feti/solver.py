# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""FETI as a PETSc Krylov solver: ``-ksp_type python -ksp_python_type dolfinx_feti.FETI``.

For a torn matrix :math:`A = T^⊤ K T` and an assembled right-hand side b it solves

.. math:: K u + B^⊤ λ = f, \qquad B u = c

(eq. 36, Augustin_eq:classicalFetiLGS, eq. 38, Augustin_eq:AFFETI) by the dual system of ``dual``
and returns the assembled x with T x = u. The right-hand side is shared among the copies, :math:`f =
δ\, T b`, so that it vanishes with b. Convergence is judged on the *assembled* system,
:math:`\|b - A x\| ≤ rtol \|b\|`.
"""

from __future__ import annotations

import logging
from collections.abc import Callable

from petsc4py import PETSc

import numpy as np

from dolfinx_feti.errors import SetUpError, SingularError
from dolfinx_feti.events import event
from dolfinx_feti.feti.options import FETIOptions, read_options
from dolfinx_feti.feti.recovery import load, recover, residual, start
from dolfinx_feti.feti.report import Report, collect, table
from dolfinx_feti.feti.setup import Parts

__all__ = ["FETI"]

Reason = PETSc.KSP.ConvergedReason
logger = logging.getLogger("dolfinx_feti")

#: Default relative tolerance on the residual of the assembled system.
RTOL = 1e-8

#: By what factor a fresh start has to lower the residual for another one to follow.
GAIN = 0.5

#: What the Krylov method aims at below the tolerance: it sees the residual up to rounding.
MARGIN = 0.7

#: Below this relative residual CG's curvature is that of rounding.
ROUNDING = 1e-13

REMEDIES = {
    Reason.DIVERGED_NANORINF: "a NaN or Inf met the Krylov method; look at the matrix and the load",
    Reason.DIVERGED_BREAKDOWN: (
        "the residual stagnates; use -{0}feti_pc_type dirichlet, or raise -{0}feti_stagnation"
    ),
    Reason.DIVERGED_INDEFINITE_MAT: (
        "negative curvature in CG: the assembled matrix is indefinite, or CG was asked for "
        "although subdomains are; use -{0}feti_dual_ksp_type gmres"
    ),
    Reason.DIVERGED_INDEFINITE_PC: (
        "the preconditioner is indefinite in CG; use -{0}feti_dual_ksp_type gmres"
    ),
    Reason.DIVERGED_MAX_IT: "no convergence within -{0}ksp_max_it iterations; raise it",
}

#: Reasons for which CG ends when a quadratic form is negative.
CURVATURE = (Reason.DIVERGED_INDEFINITE_MAT, Reason.DIVERGED_INDEFINITE_PC)

INDEFINITE = "; the assembled matrix is indefinite, with at least {0} negative eigenvalue(s)"


class FETI:
    """Context of a KSP that solves with a classical or all-floating FETI method.

    The operator is the torn matrix of :func:`dolfinx_feti.create_torn_matrix`. The options are
    listed in ``docs/options.md``; the KSP's own tolerances are those of the assembled system.

    Attributes:
        message: What went wrong and what helps, or an empty string.
        iterations: Krylov iterations of the last solve.
        residual: ‖b − A x‖/‖b‖ of the last solve.
        method: Krylov method of the dual system.
        negative: Negative eigenvalues of the regularised subdomains and of the defect D.
        negative_assembled: Negative eigenvalues that the assembled matrix has at least, see
            ``stability``; −1 if not known.
        singular: Whether the set-up failed because the matrix is singular.
        refuse_indefinite: Whether a solve ends before its first iteration, with the reason
            ``DIVERGED_INDEFINITE_MAT``, if ``negative_assembled`` is not zero.
        eigenvalues: (λ_min, λ_max) of the preconditioned dual operator, by Lanczos from the CG
            coefficients; nan before a CG solve.
    """

    def __init__(self) -> None:
        self.message = ""
        self.iterations = 0
        self.residual = np.nan
        self.method = ""
        self.negative = self.negative_assembled = 0
        self.singular = self.refuse_indefinite = False
        self.eigenvalues = (np.nan, np.nan)
        self._options: FETIOptions | None = None
        self._parts: Parts | None = None
        self._state: tuple[int, int] | None = None
        self._prefix = ""

    @property
    def condition_number(self) -> float:
        """λ_max/λ_min of the preconditioned dual operator."""
        low, high = self.eigenvalues
        return high / low if low > 0.0 else np.nan

    # -- PETSc's calls ----------------------------------------------------------------------------

    def create(self, ksp: PETSc.KSP) -> None:
        """Set defaults: no preconditioner of PETSc's own, rtol 1e-8."""
        ksp.getPC().setType(PETSc.PC.Type.NONE)
        if ksp.getTolerances()[0] == 1e-5:  # PETSc's default
            ksp.setTolerances(rtol=RTOL)

    def setFromOptions(self, ksp: PETSc.KSP) -> None:
        """Read the options under the prefix of the KSP."""
        self._prefix = ksp.getOptionsPrefix() or ""
        self._options = read_options(self._prefix)

    def setUp(self, ksp: PETSc.KSP) -> None:
        """Build or refresh everything that depends on the matrix."""
        if self._options is None:
            self.setFromOptions(ksp)
        self.message, self.singular = "", False
        try:
            self._refresh(ksp.getOperators()[0])
        except SetUpError as error:
            self._state, self.negative_assembled = None, -1
            self.message, self.singular = str(error), isinstance(error, SingularError)

    def solve(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """Solve A x = b; a failure is a negative converged reason with a message."""
        self.setUp(ksp)
        refused = self.refuse_indefinite and self.negative_assembled > 0
        if self.message or refused:
            x.set(0.0)
            self.iterations, self.residual = 0, np.nan
            reason = Reason.DIVERGED_INDEFINITE_MAT if refused else Reason.DIVERGED_PCSETUP_FAILED
        else:
            with event("FETISolve"):
                reason = self._solve(ksp, b, x)
        ksp.setConvergedReason(reason)
        if reason < 0 and not refused and ksp.comm.rank == 0:
            logger.warning("FETI did not converge: %s", self.message)

    def solveTranspose(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """Refuse: a transposed solve is not there.

        Raises:
            NotImplementedError: Always.
        """
        raise NotImplementedError("FETI has no transposed solve; pass the transposed matrix.")

    def view(self, ksp: PETSc.KSP, viewer: PETSc.Viewer) -> None:
        """Print the table of subdomains, kernels, multipliers, coarse problem and factors."""
        report = self.report()
        if report is not None:
            for row in table(report).splitlines(keepends=True):
                viewer.printfASCII(row)  # the viewer indents each call

    def destroy(self, ksp: PETSc.KSP | None = None) -> None:
        """Free everything."""
        if self._parts is not None:
            self._parts.destroy()
        self._parts = None

    # -- the method -------------------------------------------------------------------------------

    def report(self) -> Report | None:
        """Collect the figures of ``-ksp_view``; None before the first solve.

        Note:
            Collective.
        """
        if self._parts is None or self._state is None:
            return None
        return collect(self._parts)

    def _refresh(self, A: PETSc.Mat) -> None:
        """Bring all parts up to the state of the matrix; keep what depends on its pattern."""
        assert self._options is not None
        if self._parts is None or self._parts.torn.A.handle != A.handle:
            self.destroy()
            self._state = None
            self._parts = Parts(A, self._options, self._prefix)
        state = (A.stateGet(), A.getISLocalMat().stateGet())
        if state != self._state:
            if self._parts.torn.is_symmetric() != self._parts.symmetric:
                self.destroy()
                self._parts = Parts(A, self._options, self._prefix)
            self._parts.update()
            self.method = self._parts.krylov.ksp.getType()
            self.negative = self._parts.negative
            self.negative_assembled = self._parts.negative_assembled
        self._state = state

    def _solve(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> int:
        """Solve the dual system, recover u, and repeat on the residual until it is small."""
        p = self._parts
        assert p is not None
        torn, delta, krylov = p.torn, p.gluing.delta, p.krylov
        rtol, atol, _, max_it = ksp.getTolerances()
        self.iterations, self.residual = 0, np.nan
        if not np.isfinite(b.norm()):
            return self._judge(Reason.DIVERGED_NANORINF, np.nan, 0.0)
        krylov.recycling.renew()
        u_D = np.where(torn.dirichlet, torn.tear(b), 0.0)
        x.array[:] = torn.assemble(delta * u_D)
        r = residual(torn, b, x)
        scale = r.norm()
        target = max(rtol * scale, atol)
        b.copy(r)
        x.set(0.0)
        norm = np.inf
        reason = Reason.CONVERGED_RTOL
        for attempt in range(1 + p.options.refine):
            f = load(p, r, u_D)
            c = p.gluing.gap(u_D)
            pair = start(p, p.matrices.condense(f), c)
            c.destroy()
            reason = krylov.solve(
                target=MARGIN * target,
                max_it=max_it - self.iterations,
                monitor=outer_monitor(ksp, self.iterations, first=attempt == 0),
            )
            self.iterations += krylov.ksp.getIterationNumber()
            ksp.setIterationNumber(self.iterations)
            self.eigenvalues = krylov.eigenvalues if attempt == 0 else self.eigenvalues
            u = recover(p, pair, f, u_D)
            x.array[:] += torn.assemble(delta * u)
            r.destroy()
            r = residual(torn, b, x)
            last, norm = norm, r.norm()
            if reason < 0 or krylov.users_test or not norm > target or norm > GAIN * last:
                break
            u_D = np.zeros_like(u_D)
        r.destroy()
        ksp.setResidualNorm(norm if np.isfinite(norm) else np.inf)
        self.residual = norm / scale if scale > 0 else norm
        return self._judge(reason, norm, target)

    def _judge(self, reason: int, norm: float, target: float) -> int:
        """Turn the outcome into a reason, and a failure into a message with its remedy."""
        assert self._parts is not None
        if not np.isfinite(norm):
            reason = Reason.DIVERGED_NANORINF
        elif reason in CURVATURE and self.residual <= ROUNDING:
            reason = Reason.DIVERGED_BREAKDOWN
        elif reason > 0 and norm > target and not self._parts.krylov.users_test:
            reason = Reason.DIVERGED_BREAKDOWN
        if reason < 0:
            remedy = REMEDIES.get(reason, f"the dual Krylov method ended with reason {reason}")
            remedy = remedy.format(self._prefix)
            if self.negative_assembled > 0:
                remedy += INDEFINITE.format(self.negative_assembled)
            self.message = f"{remedy} (‖b − A x‖/‖b‖ = {self.residual:.2e})."
        return reason


def outer_monitor(ksp: PETSc.KSP, done: int, *, first: bool) -> Callable[[int, float], None]:
    """Hand the inner iterations on to the monitors and the history of the outer KSP.

    Args:
        ksp: The outer KSP.
        done: Iterations before this inner solve.
        first: Whether the start is still to be shown.
    """

    def monitor(its: int, norm: float) -> None:
        if its > 0 or first:
            ksp.logConvergenceHistory(norm)
            ksp.monitor(done + its, norm)

    return monitor
