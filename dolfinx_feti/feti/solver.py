# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""FETI as a PETSc Krylov solver: ``-ksp_type python -ksp_python_type dolfinx_feti.FETI``.

.. math:: A = T^⊤ K T, \qquad A x = b, \qquad K u + B^⊤ λ = f, \qquad B u = c

(eq. 36, Augustin_eq:classicalFetiLGS, eq. 38, Augustin_eq:AFFETI), in the dual or the primal form.
Convergence is judged on the *assembled* system, with the prescribed values :math:`x_D` moved to the
right-hand side: :math:`\|b - A x\| ≤ rtol \|b - A x_D\|`.
"""

from __future__ import annotations

import logging
from contextlib import suppress
from dataclasses import replace

from petsc4py import PETSc

import numpy as np

from dolfinx_feti.errors import SetUpError, SingularError
from dolfinx_feti.feti.lasting import Form, Lasting
from dolfinx_feti.feti.options import FETIOptions, check_outer_options, read_options
from dolfinx_feti.feti.report import Report, collect, table
from dolfinx_feti.feti.setup import Inertia
from dolfinx_feti.feti.solution import CURVATURE, Solution, outer_monitor
from dolfinx_feti.feti.subdomain.blocks import on_subdomains
from dolfinx_feti.runtime.collective import raise_deferred
from dolfinx_feti.runtime.events import event
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.torn.null_space import take_out
from dolfinx_feti.torn.rounding import residual_rounding

Reason = PETSc.KSP.ConvergedReason
logger = logging.getLogger("dolfinx_feti")

#: Attribute of a KSP that prints its table once, in place of PETSc at the end of each solve.
VIEW_ONCE = "feti_view_once"

#: Default relative tolerance on the residual of the assembled system.
RTOL = 1e-8

#: Most fresh starts on the residual of the assembled system, and by what factor one has to lower it
#: for another one to follow.
RESTARTS, GAIN = 10, 0.5

#: What the Krylov method aims at below the tolerance: it sees the residual up to rounding.
AIM = 0.7

#: Multiple of the size of its rounding errors up to which a residual is nothing else, and share of
#: ‖b‖ above which that leaves the solution in doubt.
ROUNDED, DOUBTFUL = 4.0, 1e-3

#: Share of a load in the null space of A that is rounding.
COMPATIBLE = 1e-10

UNBALANCED = """the load is not orthogonal to the null space of A, so that nothing balances it; \
with A.setTransposeNullSpace, too, PETSc takes that part out of each load"""


class FETI:
    """Context of a KSP that solves with a classical or all-floating FETI method.

    The operator is the torn matrix of :func:`dolfinx_feti.create_torn_matrix`. The options are
    listed in ``docs/options.md``; the KSP's own tolerances are those of the assembled system.

    Attributes:
        message: What went wrong and what helps, or an empty string.
        iterations: Krylov iterations of the last solve, those of all attempts.
        residual: ‖b − A x‖/‖b − A x_D‖ of the last solve.
        rtol: Its largest value that the tolerances of the last solve allowed.
        floor: What rounding leaves of it, if that has ended the solve; else nan.
        singular: Whether the set-up failed because the matrix is singular.
        refuse_indefinite: Whether a solve ends before its first iteration, with the reason
            ``DIVERGED_INDEFINITE_MAT``, if the assembled matrix is proved to be indefinite.
        eigenvalues: (λ_min, λ_max) of the preconditioned operator, by Lanczos from the CG
            coefficients; nan before a CG solve.
    """

    def __init__(self, *, newton: bool = False, refuse_indefinite: bool = False) -> None:
        """Begin with nothing set up.

        Args:
            newton: Whether the matrices are those of Newton's method: then preconditioner and Ritz
                vectors serve later ones (``lasting``).
            refuse_indefinite: See the class.
        """
        self.message = ""
        self.iterations = 0
        self.residual = self.rtol = self.floor = np.nan
        self.singular = False
        self.eigenvalues = (np.nan, np.nan)
        self._newton, self.refuse_indefinite = newton, refuse_indefinite
        self._prefix: str | None = None  # until the options are read
        self._lasting = Lasting(FETIOptions(), "", newton=newton)

    @property
    def condition_number(self) -> float:
        """λ_max/λ_min of the preconditioned operator."""
        low, high = self.eigenvalues
        return high / low if low > 0.0 else np.nan

    @property
    def form(self) -> Form | None:
        """What is set up for the last matrix; None before the first one, and after a failure."""
        return self._lasting.form

    @property
    def age(self) -> int:
        """Matrices since the one that the preconditioner belongs to."""
        return self._lasting.age

    @property
    def method(self) -> str:
        """Krylov method; empty without a form."""
        return "" if self.form is None else self.form.method

    @property
    def inertia(self) -> Inertia | None:
        """Negative eigenvalues of the last matrix; None without a form."""
        return None if self.form is None else self.form.inertia

    def renew(self) -> None:
        """Let the next matrix have a preconditioner of its own, and no Ritz vectors."""
        self._lasting.renew()

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
        prefix = ksp.getOptionsPrefix() or ""
        options = read_options(prefix)
        self.destroy()
        self._prefix, self._lasting = prefix, Lasting(options, prefix, newton=self._newton)

    def setUp(self, ksp: PETSc.KSP) -> None:
        """Build or refresh everything that depends on the matrix."""
        if self._prefix is None:
            self.setFromOptions(ksp)
        self.message, self.singular = "", False
        with suppress(Exception):
            raise_deferred()  # of a set-up that has failed in another way
        try:
            self._lasting.take(ksp.getOperators()[0])
            on_subdomains(raise_deferred, ksp.comm.tompi4py())
        except SetUpError as error:
            self._tell(error)

    def solve(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """Solve A x = b; a failure is a negative converged reason with a message."""
        self.setUp(ksp)
        spent = 0
        attempt = self._attempt(ksp, b, x, spent)
        while attempt.reason < 0 and self._try_again(attempt.reason):
            spent += attempt.iterations
            attempt = self._attempt(ksp, b, x, spent)
        self.iterations = spent + attempt.iterations
        self.residual, self.rtol, self.floor = attempt.residual, attempt.rtol, attempt.floor
        ksp.setIterationNumber(self.iterations)
        ksp.setConvergedReason(attempt.reason)
        if ksp.getAttr(VIEW_ONCE) and self._lasting.first_look():
            self._print_table(ksp)
        if attempt.reason < 0 and not self._refused() and ksp.comm.rank == 0:
            # Newton's method takes some failures in its stride, and says what others mean.
            level = logging.DEBUG if self._newton else logging.WARNING
            logger.log(level, "FETI did not converge: %s", self.message)

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

    def _print_table(self, ksp: PETSc.KSP) -> None:
        """Print who solves, how well, and the table. Collective."""
        screen, (rtol, atol, _, max_it) = PETSc.Viewer.STDOUT(ksp.comm), ksp.getTolerances()
        plural = "es" * (ksp.comm.size > 1)
        screen.printfASCII(f"KSP Object: ({self._prefix}) {ksp.comm.size} MPI process{plural}\n")
        screen.printfASCII(
            f"  tolerances            rtol {rtol:g}, atol {atol:g}, max_it {max_it}\n"
        )
        self.view(ksp, screen)

    def destroy(self, ksp: PETSc.KSP | None = None) -> None:
        """Free everything."""
        self._lasting.destroy()

    # -- the method -------------------------------------------------------------------------------

    def report(self) -> Report | None:
        """Collect the figures of ``-ksp_view``; None before the first solve. Collective."""
        if self.form is None:
            return None
        return collect(self.form, lag=self.age, eigenvalues=self.eigenvalues, floor=self.floor)

    def _tell(self, error: SetUpError) -> None:
        """Keep the message of a set-up that has failed."""
        self.message, self.singular = str(error), isinstance(error, SingularError)

    def _refused(self) -> bool:
        """Tell whether the matrix is proved to be indefinite, and nobody wants its solution."""
        proved = self.inertia is not None and bool(self.inertia.assembled)
        return self.refuse_indefinite and proved

    def _try_again(self, reason: int) -> bool:
        """Prepare another attempt after one has failed; tell whether there is one."""
        try:
            again = self._lasting.try_again(reason, saddles=not self.refuse_indefinite)
        except SetUpError as error:
            self._tell(error)
            return True  # which ends with that reason
        if again:
            self.message = ""
        return again

    def _attempt(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec, spent: int) -> Solution:
        """Solve A x = b with what is set up, unless that is known to be in vain."""
        form = self.form
        if form is None:
            x.set(0.0)
            return Solution(Reason.DIVERGED_PCSETUP_FAILED)
        if self._refused():
            x.set(0.0)
            return Solution(Reason.DIVERGED_INDEFINITE_MAT)
        try:
            with event("FETISolve"), Lifetime() as owned:
                attempt = self._solve(ksp, form, b, x, owned.own(b.duplicate()), spent)
        except SetUpError as error:  # a coarse solver that took the place of another one
            self._tell(error)
            x.set(0.0)
            return Solution(Reason.DIVERGED_PCSETUP_FAILED)
        self.eigenvalues = attempt.eigenvalues
        self._lasting.record(attempt)
        return attempt

    def _solve(
        self, ksp: PETSc.KSP, form: Form, b: PETSc.Vec, x: PETSc.Vec, r: PETSc.Vec, spent: int
    ) -> Solution:
        """Solve with a form of the method, and start afresh on the residual r until it is small."""
        torn, delta = form.pattern.torn, form.delta
        rtol, atol, _, max_it = ksp.getTolerances()
        x.set(0.0)
        if not np.isfinite(b.norm()):
            return self._judged(Solution(Reason.DIVERGED_NANORINF), form, enough=False)
        u_D = np.where(torn.dirichlet, torn.tear(b.array_r), 0.0)
        x.array[:] = torn.assemble(delta * u_D)  # x_D
        torn.residual(b, x, r)
        scale = r.norm()
        along = take_out(torn.A, r)
        if along > COMPATIBLE * scale:
            x.set(0.0)
            incompatible = Solution(Reason.DIVERGED_NULL, residual=along / scale)
            return self._judged(incompatible, form, enough=False)
        target = max(rtol * scale, atol)
        rtol = target / scale if scale > 0.0 else np.nan
        most = self._lasting.most_iterations(max_it - spent, rtol)
        monitor_from = outer_monitor(ksp)
        b.copy(r)
        x.set(0.0)
        norm, rounding, iterations = np.inf, 0.0, 0
        solutions: list[Solution] = []
        for start in range(1 + RESTARTS):
            u, solution = form.solve(
                r,
                u_D,
                target=AIM * target,
                max_it=most - iterations,
                monitor=monitor_from(spent + iterations, show_start=spent + start == 0),
                saddles=not self.refuse_indefinite,
            )
            solutions.append(solution)
            iterations += solution.iterations
            ksp.setIterationNumber(spent + iterations)
            before = x.array_r.copy()
            x.array[:] += torn.assemble(delta * u)
            on_subdomains(raise_deferred, torn.comm)
            torn.residual(b, x, r)
            take_out(torn.A, r)
            last, norm = norm, r.norm()
            if not norm <= last:  # what was there before is better
                x.array[:], norm = before, last
                break
            rounding = 0.0 if norm <= target else residual_rounding(torn, b, x)
            enough = norm <= (ROUNDED * rounding if target < rounding else target)
            if solution.reason < 0 or form.users_test or enough or norm > GAIN * last:
                break
            u_D = np.zeros_like(u_D)
        take_out(torn.A, x)
        ksp.setResidualNorm(norm if np.isfinite(norm) else np.inf)
        floor, scale = ROUNDED * rounding, scale or 1.0
        attempt = replace(
            solutions[0],
            reason=solutions[-1].reason,
            iterations=iterations,
            residual=norm / scale,
            rtol=rtol,
            floor=floor / scale if target < norm <= floor else np.nan,
        )
        return self._judged(attempt, form, enough=bool(norm <= target))

    def _judged(self, attempt: Solution, form: Form, *, enough: bool) -> Solution:
        """Return an attempt with the reason that its residual tells; a failure has a message."""
        reason, residual = attempt.reason, attempt.residual
        if not np.isfinite(residual):
            reason = Reason.DIVERGED_NANORINF
        elif enough:
            reason = Reason.CONVERGED_RTOL
        elif attempt.floor <= DOUBTFUL:
            reason = Reason.CONVERGED_HAPPY_BREAKDOWN
        elif attempt.floor > DOUBTFUL or (reason > 0 and not form.users_test):
            reason = Reason.DIVERGED_BREAKDOWN
        if reason < 0:
            text = _remedy(reason, form, floor=attempt.floor).format(self._prefix)
            if form.inertia.assembled:
                text += (
                    "; the assembled matrix is indefinite, with at least "
                    f"{form.inertia.assembled} negative eigenvalue(s)"
                )
            self.message = f"{text} (‖b − A x‖/‖b‖ = {residual:.2e})."
        return replace(attempt, reason=reason)


def _remedy(reason: int, form: Form, *, floor: float) -> str:
    """Say why a solve has failed, and what helps that is not in force."""
    options, default = form.pattern.options, FETIOptions()
    if floor > DOUBTFUL:
        return (
            f"rounding alone leaves a residual of {floor:.0e} ‖b‖, for the entries of A are too "
            "large for b: lower a penalty such as κ (and let an augmented Lagrangian make up for "
            "it), or scale the unknowns alike"
        )
    if reason == Reason.DIVERGED_NANORINF:
        return "a NaN or Inf met the Krylov method; look at the matrix and the load"
    if reason == Reason.DIVERGED_NULL:
        return UNBALANCED
    if reason == Reason.DIVERGED_MAX_IT:
        return "no convergence within -{0}ksp_max_it iterations; raise it"
    if reason == Reason.DIVERGED_BREAKDOWN:
        better = [(name, getattr(default, name)) for name in ("pc_type", "scaling", "coarse_q")]
        missing = [f"-{{0}}feti_{n} {v}" for n, v in better if getattr(options, n) != v]
        less = "ask for less by -{0}ksp_rtol, or look at the scales of A"
        return f"the residual stagnates; {'use ' + ' '.join(missing) if missing else less}"
    if reason not in CURVATURE or form.method == "gmres":
        return f"the Krylov method ended with reason {reason}"
    remedy, asked = "use -{0}feti_formulation dual", ""
    if form.solves_indefinite:
        remedy = "use -{0}feti_dual_ksp_type gmres"
        asked = f", or {form.method} was asked for although subdomains are"
    if reason == Reason.DIVERGED_INDEFINITE_MAT:
        return f"negative curvature: the assembled matrix is indefinite{asked}; {remedy}"
    return f"the preconditioner is indefinite; {remedy}"
