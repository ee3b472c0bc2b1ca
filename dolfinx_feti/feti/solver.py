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

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.errors import SetUpError, SingularError
from dolfinx_feti.events import event
from dolfinx_feti.feti.dual_form import create_dual_form
from dolfinx_feti.feti.formulation import Form, set_up, set_up_lagged
from dolfinx_feti.feti.inertia import Inertia
from dolfinx_feti.feti.krylov.deflation import RitzVectors
from dolfinx_feti.feti.krylov.recycling import Directions
from dolfinx_feti.feti.monitor import outer_monitor
from dolfinx_feti.feti.options import FETIOptions, check_outer_options, read_options
from dolfinx_feti.feti.primal_form import PrimalForm
from dolfinx_feti.feti.report import Report, collect, table
from dolfinx_feti.feti.setup import Factored, Pattern

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

#: Growth of the iterations for a digit that ends the life of a preconditioner, and the one that
#: ends a solve with it.
GROWN, HOPELESS = 4.0 / 3.0, 3.0

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
        rtol: Its largest value that the tolerances of the last solve allowed.
        method: Krylov method of the dual system.
        inertia: Negative eigenvalues of the last matrix; None if its set-up failed.
        singular: Whether the set-up failed because the matrix is singular.
        refuse_indefinite: Whether a solve ends before its first iteration, with the reason
            ``DIVERGED_INDEFINITE_MAT``, if the assembled matrix is proved to be indefinite.
        lasting: Whether the matrices are those of Newton's method: then the preconditioner of the
            primal form serves later ones, too, up to ``-feti_lag`` of them, until :meth:`renew`,
            and so do up to ``-feti_deflation`` Ritz vectors of each solve.
        eigenvalues: (λ_min, λ_max) of the preconditioned dual operator, by Lanczos from the CG
            coefficients; nan before a CG solve.
    """

    def __init__(self) -> None:
        self.message = ""
        self.iterations = 0
        self.residual = self.rtol = np.nan
        self.method = ""
        self.inertia: Inertia | None = None
        self.singular = self.refuse_indefinite = self.lasting = False
        self.eigenvalues = (np.nan, np.nan)
        self._options: FETIOptions | None = None
        self._pattern: Pattern | None = None
        self._form: Form | None = None
        self._state: tuple[int, int] | None = None
        self._directions: Directions | None = None
        self._ritz_vectors: RitzVectors | None = None
        self._recycled = 0
        self._outdated = False
        self._in_double = False  # whether single precision has failed
        self._rate = np.nan  # iterations for a digit of the first solve with the preconditioner
        self._prefix = ""

    @property
    def condition_number(self) -> float:
        """λ_max/λ_min of the preconditioned dual operator."""
        low, high = self.eigenvalues
        return high / low if low > 0.0 else np.nan

    @property
    def age(self) -> int:
        """Matrices since the one that the preconditioner belongs to."""
        return self._form.age if isinstance(self._form, PrimalForm) else 0

    @property
    def single(self) -> bool:
        """Whether the preconditioner has factors in single precision (``-feti_precision``)."""
        return isinstance(self._form, PrimalForm) and self._form.singles > 0

    def renew(self) -> None:
        """Let the next matrix have a preconditioner of its own, and no Ritz vectors."""
        self._outdated, self._ritz_vectors = True, None

    # -- PETSc's calls ----------------------------------------------------------------------------

    def create(self, ksp: PETSc.KSP) -> None:
        """Set defaults: no preconditioner of PETSc's own, and rtol 1e-8 where it was PETSc's 1e-5.

        PETSc does not tell its default from the same number set by hand: a relative tolerance of
        1e-5 counts if it is set after the type of the KSP.
        """
        check_outer_options(ksp.getOptionsPrefix() or "")  # before PETSc reads them
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
            self._state, self.inertia = None, None
            self.message, self.singular = str(error), isinstance(error, SingularError)

    def solve(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """Solve A x = b; a failure is a negative converged reason with a message."""
        self.setUp(ksp)
        reason, spent = self._attempt(ksp, b, x), 0
        while reason < 0 and (self.age or self.single) and not self._curvature_ends(reason):
            spent += self.iterations
            self._in_double |= not self.age
            self.renew()
            self._state = None
            self.setUp(ksp)
            reason = self._attempt(ksp, b, x)
        if np.isnan(self._rate) and reason > 0:
            self._rate = per_digit(self.iterations, self.residual)
        self.iterations += spent
        ksp.setIterationNumber(self.iterations)
        ksp.setConvergedReason(reason)
        if reason < 0 and not self._refused() and ksp.comm.rank == 0:
            # Newton's method takes some failures in its stride, and says what others mean.
            level = logging.DEBUG if self.lasting else logging.WARNING
            logger.log(level, "FETI did not converge: %s", self.message)

    def _attempt(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> int:
        """Solve A x = b with what is set up; return the reason."""
        if self._form is None or self._state is None or self._refused():
            x.set(0.0)
            self.iterations, self.residual = 0, np.nan
            failed = self._form is None or self._state is None
            return Reason.DIVERGED_PCSETUP_FAILED if failed else Reason.DIVERGED_INDEFINITE_MAT
        with event("FETISolve"):
            return self._solve_in_form(ksp, self._form, b, x)

    def _refused(self) -> bool:
        """Tell whether the matrix is proved to be indefinite, and nobody wants its solution."""
        return self.refuse_indefinite and self.inertia is not None and self.inertia.indefinite

    def _curvature_ends(self, reason: int) -> bool:
        """Tell whether negative curvature, which no preconditioner changes, ends the solve."""
        form = self._form
        indefinite = reason == Reason.DIVERGED_INDEFINITE_MAT
        return indefinite and isinstance(form, PrimalForm) and not self._may_change(form)

    def solveTranspose(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """Refuse: there is no transposed solve.

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
        for owned in (self._form, self._pattern):
            if owned is not None:
                owned.destroy()
        self._form = self._pattern = None

    @property
    def form(self) -> Form | None:
        """What is set up for the last matrix; None before the first one, and after a failure."""
        return None if self._state is None else self._form

    # -- the method -------------------------------------------------------------------------------

    def report(self) -> Report | None:
        """Collect the figures of ``-ksp_view``; None before the first solve.

        Note:
            Collective.
        """
        if self._form is None or self._state is None:
            return None
        return collect(self._form, recycled=self._recycled, eigenvalues=self.eigenvalues)

    def _refresh(self, A: PETSc.Mat) -> None:
        """Bring all parts up to the state of the matrix; keep what depends on its pattern."""
        assert self._options is not None
        if self._pattern is None or self._pattern.torn.A.handle != A.handle:
            self._renew(A, self._options)
        assert self._pattern is not None
        state = (A.stateGet(), A.getISLocalMat().stateGet())
        if self._pattern.torn.comm.allreduce(state != self._state, op=MPI.LOR):
            seen = self._state is not None  # a new pattern has just been tested
            if seen and self._pattern.torn.is_symmetric() != self._pattern.symmetric:
                self._renew(A, self._options)
            self._form = self._next_form(self._pattern)
            self.method, self.inertia = self._form.method.type, self._form.inertia
        self._state = state

    def _next_form(self, pattern: Pattern) -> Form:
        """Take the present matrix into a form, which follows the one of the last matrix."""
        form, self._form = self._form, None
        if isinstance(form, PrimalForm) and self._lasts(form):
            return set_up_lagged(pattern, form, self._ritz_vectors)
        if form is not None:
            form.destroy()
        self._outdated, self._rate = False, np.nan
        most = pattern.options.deflation if self.lasting else 0
        single = pattern.options.precision == "single" and not self._in_double
        vectors = self._ritz_vectors if most else None
        return set_up(pattern, vectors, most=most, single=single)

    def _lasts(self, form: PrimalForm) -> bool:
        """Tell whether the preconditioner serves another matrix."""
        young = self.lasting and not self._outdated and form.age < form.options.lag
        rate = per_digit(self.iterations, self.residual)
        return young and (self._refused() or rate <= GROWN * self._rate)

    def _renew(self, A: PETSc.Mat, options: FETIOptions) -> None:
        """Begin anew with the pattern of another matrix."""
        self.destroy()
        self._state = self._directions = self._ritz_vectors = None
        self._in_double = False
        self._pattern = Pattern(A, options, self._prefix)

    def _solve_in_form(self, ksp: PETSc.KSP, form: Form, b: PETSc.Vec, x: PETSc.Vec) -> int:
        """Solve with directions of earlier solves; go over to GMRES if A is indefinite."""
        if isinstance(form, PrimalForm) and self._may_change(form):
            if not form.inertia.indefinite:
                reason = self._solve(ksp, form, b, x)
                if reason != Reason.DIVERGED_INDEFINITE_MAT or form.age:
                    return reason
            elif form.age:
                return Reason.DIVERGED_INDEFINITE_MAT
            assert self._pattern is not None
            self._form = create_dual_form(
                self._pattern, Factored(form.near_kernel, form.modes, form.inertia)
            )
            form.destroy()
            form, self.message, self.method = self._form, "", self._form.method.type
        deflated = form.deflated(self._directions)
        reason = self._solve(ksp, deflated, b, x)
        self._directions = deflated.directions()
        return reason

    def _may_change(self, form: PrimalForm) -> bool:
        """Tell whether another form may take the place of the primal one."""
        return form.options.formulation == "auto" and not self.refuse_indefinite

    def _solve(self, ksp: PETSc.KSP, form: Form, b: PETSc.Vec, x: PETSc.Vec) -> int:
        """Solve with a form of the method, and repeat on the residual until it is small."""
        torn, delta = form.torn, form.gluing.delta
        self._recycled = form.recycled
        rtol, atol, _, max_it = ksp.getTolerances()
        self.iterations, self.residual = 0, np.nan
        if not np.isfinite(b.norm()):
            return self._judge(Reason.DIVERGED_NANORINF, np.nan, 0.0, form)
        u_D = np.where(torn.dirichlet, torn.tear(b), 0.0)
        x.array[:] = torn.assemble(delta * u_D)
        r = torn.residual(b, x)
        scale = r.norm()
        target = max(rtol * scale, atol)
        self.rtol = target / scale if scale > 0.0 else np.nan
        max_it = self._most_iterations(max_it)
        b.copy(r)
        x.set(0.0)
        norm = np.inf
        reason = Reason.CONVERGED_RTOL
        for attempt in range(1 + form.options.refine):
            u, solution = form.solve(
                r,
                u_D,
                target=MARGIN * target,
                max_it=max_it - self.iterations,
                monitor=outer_monitor(ksp, self.iterations, first=attempt == 0),
            )
            reason = solution.reason
            self.iterations += solution.iterations
            if attempt == 0:
                self.eigenvalues = solution.eigenvalues
                self._ritz_vectors = solution.ritz_vectors
            ksp.setIterationNumber(self.iterations)
            before = x.array_r.copy()
            x.array[:] += torn.assemble(delta * u)
            r.destroy()
            r = torn.residual(b, x)
            last, norm = norm, r.norm()
            if not norm <= last:  # what was there before is better
                x.array[:], norm = before, last
                break
            if reason < 0 or form.users_test or norm <= target or norm > GAIN * last:
                break
            u_D = np.zeros_like(u_D)
        r.destroy()
        ksp.setResidualNorm(norm if np.isfinite(norm) else np.inf)
        self.residual = norm / scale if scale > 0 else norm
        return self._judge(reason, norm, target, form)

    def _most_iterations(self, max_it: int) -> int:
        """Return the most iterations: with an old preconditioner a solve may end early."""
        if not self.age or np.isnan(self._rate * self.rtol):
            return max_it
        digits = max(-np.log10(max(self.rtol, ROUNDING)), 1.0)
        return min(max_it, int(np.ceil(HOPELESS * digits * self._rate)))

    def _judge(self, reason: int, norm: float, target: float, form: Form) -> int:
        """Turn the outcome into a reason, and a failure into a message with its remedy."""
        if not np.isfinite(norm):
            reason = Reason.DIVERGED_NANORINF
        elif reason in CURVATURE and self.residual <= ROUNDING:
            reason = Reason.DIVERGED_BREAKDOWN
        elif reason > 0 and norm > target and not form.users_test:
            reason = Reason.DIVERGED_BREAKDOWN
        if reason < 0:
            remedy = REMEDIES.get(reason, f"the dual Krylov method ended with reason {reason}")
            remedy = remedy.format(self._prefix)
            if form.inertia.assembled:
                remedy += INDEFINITE.format(form.inertia.assembled)
            self.message = f"{remedy} (‖b − A x‖/‖b‖ = {self.residual:.2e})."
        return reason


def per_digit(iterations: int, residual: float) -> float:
    """Return the iterations that took a digit off the residual; nan if there was none."""
    digits = -np.log10(residual) if 0.0 < residual < 1.0 else np.nan
    return float(iterations / digits)
