# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""FETI as a PETSc Krylov solver: ``-ksp_type python -ksp_python_type dolfinx_feti.FETI``.

.. math:: A = T^⊤ K T, \qquad A x = b, \qquad K u + B^⊤ λ = f, \qquad B u = c

(eq. 36; eq. 38) in the dual or the primal form. This file has PETSc's callbacks. A solve continues
in ``outer_loop``, which tests convergence on the *assembled* system with the prescribed values
:math:`x_D` moved to the right-hand side: :math:`\|b - A x\| ≤ \text{rtol} \|b - A x_D\|`, and
:math:`\|z\| ≤ \text{rtol} \|x\|` for the preconditioned residual z (``accuracy``).
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from copy import copy
from dataclasses import replace

from petsc4py import PETSc

import numpy as np

from dolfinx_feti.errors import SetUpError, SingularError
from dolfinx_feti.feti.accuracy import ComponentNorms
from dolfinx_feti.feti.cache import SolverCache
from dolfinx_feti.feti.converged_reason import ERROR_FLOOR_WARNING, LOGGED_ROUNDING_SHARE
from dolfinx_feti.feti.formulation import Formulation
from dolfinx_feti.feti.lifting import RightHandSides
from dolfinx_feti.feti.option_checks import check_petsc_options
from dolfinx_feti.feti.options import FETIOptions, read_options
from dolfinx_feti.feti.outer_loop import precondition, solve_assembled
from dolfinx_feti.feti.report import Report, create_report, format_report
from dolfinx_feti.feti.setup import Inertia
from dolfinx_feti.feti.solve_info import SolveInfo
from dolfinx_feti.feti.solve_settings import SolveSettings, Tolerances
from dolfinx_feti.feti.subsolver_options import SubsolverOptions, read_subsolver_options
from dolfinx_feti.feti.unread_options import warn_of_unread
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.events import event
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.runtime.petsc_errors import garbage_collection_resumed
from dolfinx_feti.runtime.petsc_options import unread_options
from dolfinx_feti.torn.symmetry import is_symmetric

Reason = PETSc.KSP.ConvergedReason
logger = logging.getLogger("dolfinx_feti")

#: Default relative tolerance, for the residual of the assembled system and for η. A choice;
#: docs/theory.md has the errors that it leaves (When a solve has converged).
RTOL = 1e-8

#: PETSc's default relative tolerance.
PETSC_RTOL = 1e-5


class FETI:
    """Context of a KSP that solves with a classical or all-floating FETI method.

    The operator is the torn matrix of :func:`dolfinx_feti.create_torn_matrix`. The options are
    listed in ``docs/options.md``; the KSP's own tolerances are those of the assembled system.

    All properties but ``settings`` are results of the last set-up or solve.

    Example::

        problem = LinearProblem(a, L, bcs=bcs, subdomains=4)
        A, b = problem.linear_system()  # they belong to the problem
        ksp = PETSc.KSP().create(mesh.comm)
        ksp.setType("python")
        ksp.setPythonContext(FETI())
        ksp.setOperators(A)
        ksp.setFromOptions()
        x = A.createVecRight()
        ksp.solve(b, x)
        print(ksp.getPythonContext().report().subdomains)

    Attributes:
        message: Why the last set-up or solve failed and what helps. It is empty after a success,
            and if a solve was refused because the matrix is indefinite (``SolveSettings``).
        singular: Whether the last set-up failed because the matrix is singular.
        info: Outcome of the last solve.
    """

    def __init__(
        self, *, newton: bool = False, refuse_indefinite: bool = False, lifted: bool = False
    ) -> None:
        """Create a context without options; they are read with those of the KSP.

        Args:
            newton: Whether the matrices are those of Newton's method: then preconditioner and Ritz
                vectors are reused for later matrices (``cache``).
            refuse_indefinite: Whether a solve ends before its first iteration, with the reason
                ``DIVERGED_INDEFINITE_MAT``, if the assembled matrix is proved to be indefinite.
            lifted: Whether right-hand sides are lifted already, like dolfinx's (``lifting``); the
                option ``feti_right_side lifted`` has the same effect.
        """
        self.message = ""
        self.singular = False
        self.info = SolveInfo(Reason.ITERATING)
        self._settings = SolveSettings(allow_indefinite=not refuse_indefinite)
        self._newton = newton
        self._lifted = lifted  # the option may add it later (setFromOptions)
        # Newton's method assembles its own right-hand sides: their convention needs no check.
        self._right_hand_sides = RightHandSides(are_lifted=lifted, needs_check=not newton)
        self._prefix: str | None = None  # until the options are read
        self._logs_unread_options = True
        self._has_checked_options = False
        self._prints_table = False
        self._viewed_pattern = 0  # number of the pattern whose table has been printed
        self._cache = SolverCache(FETIOptions(), SubsolverOptions(), newton=newton)

    # -- figures of the last solve ----------------------------------------------------------------

    @property
    def iterations(self) -> int:
        """Krylov iterations of the last solve, including those of failed attempts."""
        return self.info.iterations

    @property
    def residual(self) -> float:
        """‖b − A x‖/‖b − A x_D‖; nan before the first solve."""
        return self.info.accuracy.residual

    @property
    def rtol(self) -> float:
        """Largest :attr:`residual` that meets the tolerances; nan if the load is zero."""
        return self.info.accuracy.rtol

    @property
    def floor(self) -> float:
        """:attr:`residual` that rounding leaves, if rounding has ended the solve; else nan."""
        return self.info.accuracy.residual_floor

    @property
    def error_estimate(self) -> float:
        """Estimated error η = ‖z‖/‖x‖ with z = M (b − A x), the largest over the components.

        It is nan if it was not measured.
        """
        return self.info.accuracy.error_estimate

    @property
    def error_floor(self) -> float:
        """η that rounding leaves, if rounding has ended the solve; else nan."""
        return self.info.accuracy.error_floor

    @property
    def eigenvalues(self) -> tuple[float, float]:
        """(λ_min, λ_max) of the preconditioned operator: Ritz values of CG; nan for GMRES."""
        return self.info.ritz_values

    @property
    def condition_number(self) -> float:
        """λ_max/λ_min of the preconditioned operator; nan if :attr:`eigenvalues` are."""
        low, high = self.eigenvalues
        return high / low if low > 0.0 else np.nan

    # -- what is set up, and how solves proceed ---------------------------------------------------

    @property
    def formulation(self) -> Formulation | None:
        """The method set up for the last matrix; None before the first one, and after a failure."""
        return self._cache.formulation

    @property
    def age(self) -> int:
        """Number of matrices since the one that the preconditioner was built for."""
        return self._cache.age

    @property
    def method(self) -> str:
        """Krylov method; empty if nothing is set up."""
        return "" if self.formulation is None else self.formulation.method

    @property
    def inertia(self) -> Inertia | None:
        """Negative eigenvalues of the last matrix; None if nothing is set up."""
        return None if self.formulation is None else self.formulation.inertia

    def renew(self) -> None:
        """Discard the Ritz vectors now, and the preconditioner when the next matrix is set up."""
        self._cache.invalidate()

    @property
    def settings(self) -> SolveSettings:
        """What solves are allowed beyond the tolerances of the KSP; see :meth:`solving_with`."""
        return self._settings

    @contextmanager
    def solving_with(self, settings: SolveSettings) -> Iterator[None]:
        """Return a context in which solves have other settings.

        Args:
            settings: The settings in the context. ``replace(feti.settings, …)`` returns the present
                ones with some of them changed.
        """
        before = self._settings
        self._settings = settings
        try:
            yield
        finally:
            self._settings = before

    def serve_problem(self, *, prints_table: bool) -> None:
        """Adapt the output to a problem that owns this solver, and logs unread options itself.

        Args:
            prints_table: Whether the table of ``-ksp_view`` is printed here, once for each pattern.
                The problem then withholds the option from PETSc, which would print the table after
                each solve.
        """
        self._logs_unread_options = False
        self._prints_table = prints_table

    # -- PETSc's callbacks ------------------------------------------------------------------------

    def create(self, ksp: PETSc.KSP) -> None:
        """Set defaults: no preconditioner of PETSc's, and :data:`RTOL` in place of PETSc's rtol.

        PETSc does not distinguish its default, 1e-5, from the same number set by a user. To use it,
        set it after the type of the KSP.
        """
        check_petsc_options(ksp.getOptionsPrefix() or "")  # before PETSc reads them
        ksp.getPC().setType(PETSc.PC.Type.NONE)
        rtol, *_ = ksp.getTolerances()
        if rtol == PETSC_RTOL:
            ksp.setTolerances(rtol=RTOL)

    def setFromOptions(self, ksp: PETSc.KSP) -> None:
        """Read the options under the prefix of the KSP, and free what has been set up."""
        prefix = ksp.getOptionsPrefix() or ""
        options = read_options(prefix)
        subsolvers = read_subsolver_options(prefix)
        self.destroy()
        self._prefix = prefix
        self._cache = SolverCache(options, subsolvers, newton=self._newton)
        self._right_hand_sides = RightHandSides(
            are_lifted=self._lifted or options.right_side == "lifted",
            needs_check=self._right_hand_sides.needs_check,  # the warning is logged once
        )
        self._has_checked_options = False
        self._viewed_pattern = 0

    def setUp(self, ksp: PETSc.KSP) -> None:
        """Build or update everything that depends on the matrix; a failure leaves a message."""
        if self._prefix is None:
            self.setFromOptions(ksp)
        self.message = ""
        self.singular = False
        try:
            with garbage_collection_resumed(ksp):
                self._cache.update(ksp.getOperators()[0])
        except SetUpError as error:
            self._store_failure(error)

    def solve(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """Solve A x = b; a failure is a negative converged reason with a message.

        Raises:
            ValueError: The KSP has a convergence test of the user's. On all processes.
        """
        with garbage_collection_resumed(ksp):
            self.setUp(ksp)  # PETSc has not called it if the entries changed without setOperators
            with Lifetime() as owned:
                unlifted = owned.own(self._unlifted(ksp, b))
                info = self._solve_with_retries(ksp, unlifted, x)
            self._store(ksp, info)
            ksp.setIterationNumber(info.iterations)  # also if there is no formulation
            self._warn_of_unread_options(ksp)
            self._print_table_once(ksp)
            self._log(ksp)

    def solveTranspose(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """Solve A x = b for a symmetric A, where Aᵀ x = b is the same system.

        Prescribed values in b count as in :meth:`solve`.

        Raises:
            NotImplementedError: The matrix is not symmetric. On all processes.
        """
        self.setUp(ksp)  # ``solve`` finds the matrix unchanged, and sets nothing up again
        if not is_symmetric(ksp.getOperators()[0]):
            raise NotImplementedError(
                "FETI has no transposed solve, and the matrix is not symmetric: tear the adjoint "
                "form in another problem, LinearProblem(ufl.adjoint(a), L, bcs=bcs), where a "
                "is the bilinear form or the tangent J."
            )
        self.solve(ksp, b, x)

    def view(self, ksp: PETSc.KSP, viewer: PETSc.Viewer) -> None:
        """Print the table of subdomains, kernels, multipliers, coarse problem and factors."""
        report = self.report()
        if report is not None:
            for row in format_report(report).splitlines(keepends=True):
                viewer.printfASCII(row)  # the viewer indents each call

    def destroy(self, ksp: PETSc.KSP | None = None) -> None:
        """Free everything."""
        self._cache.destroy()

    # -- parts of a solve -------------------------------------------------------------------------

    def _unlifted(self, ksp: PETSc.KSP, b: PETSc.Vec) -> PETSc.Vec:
        """Return the right-hand side without lifting, (N,); the caller destroys it. Collective.

        Args:
            ksp: The solver of this context.
            b: Right-hand side in the user's convention, (N,). If nothing is set up, another
                reference to it is returned.
        """
        if self.formulation is None:
            return copy(b)  # another reference
        torn = self.formulation.pattern.torn
        return self._right_hand_sides.unlifted(torn, b, ksp.getOptionsPrefix() or "")

    def _solve_with_retries(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> SolveInfo:
        """Solve A x = b; after a failure, try again if the cache sets up another way. Collective.

        Args:
            ksp: The solver of this context.
            b: Right-hand side without lifting, (N,).
            x: The solution, (N,), overwritten; zero if there is no formulation.

        Returns:
            Outcome of the last attempt, with the iterations of all attempts.
        """
        iterations = 0
        while True:
            info = self._attempt(ksp, b, x, iterations)
            iterations += info.iterations
            if info.reason >= 0:
                return replace(info, iterations=iterations)
            try:
                is_retry_prepared = self._cache.prepare_retry(
                    info, allow_indefinite=self._settings.allow_indefinite
                )
            except SetUpError as error:
                return replace(self._failed_set_up(error, x), iterations=iterations)
            if not is_retry_prepared:
                return replace(info, iterations=iterations)

    def _attempt(
        self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec, iterations_before: int
    ) -> SolveInfo:
        """Solve A x = b once with the present formulation. Collective.

        Args:
            ksp: The solver of this context.
            b: Right-hand side without lifting, (N,).
            x: The solution, (N,), overwritten; zero if there is no formulation, or A is refused.
            iterations_before: Number of iterations of earlier attempts, which count for max_it.
        """
        formulation = self.formulation
        if formulation is None:
            x.set(0.0)
            return SolveInfo(Reason.DIVERGED_PCSETUP_FAILED, message=self.message)
        if self._is_refused():
            x.set(0.0)
            return SolveInfo(Reason.DIVERGED_INDEFINITE_MAT)
        rtol, atol, _, max_it = ksp.getTolerances()
        tolerances = Tolerances(
            rtol, atol, max_it - iterations_before, self._cache.max_iterations_per_digit
        )
        try:
            with event("FETISolve"):
                info = solve_assembled(
                    ksp,
                    formulation,
                    b,
                    x,
                    tolerances=tolerances,
                    iterations_before=iterations_before,
                    settings=self._settings,
                )
        except SetUpError as error:  # local work failed in an iteration
            return self._failed_set_up(error, x)
        self._cache.record(info)
        return info

    def _is_refused(self) -> bool:
        """Return True if the matrix is proved to be indefinite, and such matrices are refused."""
        is_indefinite = self.inertia is not None and bool(self.inertia.assembled)
        return is_indefinite and not self._settings.allow_indefinite

    def _failed_set_up(self, error: SetUpError, x: PETSc.Vec) -> SolveInfo:
        """Store why a set-up has failed, set x to zero, and return the outcome."""
        self._store_failure(error)
        x.set(0.0)
        return SolveInfo(Reason.DIVERGED_PCSETUP_FAILED, message=self.message)

    def _store_failure(self, error: SetUpError) -> None:
        """Store why a set-up has failed."""
        self.message = str(error)
        self.singular = isinstance(error, SingularError)

    def _store(self, ksp: PETSc.KSP, info: SolveInfo) -> None:
        """Store the outcome of a solve, here and in the KSP."""
        self.info = info
        self.message = info.message
        ksp.setConvergedReason(info.reason)

    # -- solutions composed of several solves -----------------------------------------------------

    def correction(self, ksp: PETSc.KSP, r: Array) -> Array | None:
        """Return z = M r ≈ A⁻¹ r, (N,), by one application of the preconditioner. Collective.

        It costs about as much as one or two iterations, and a set-up if the matrix has changed.

        Args:
            ksp: The solver of this context.
            r: Residual of the assembled system, zero on Dirichlet dofs, (N,).

        Returns:
            z, (N,); None if nothing can be set up for the matrix.

        Raises:
            SetUpError: Local work failed, such as a solve with a factor. On all processes.
        """
        self.setUp(ksp)
        formulation = self.formulation
        if formulation is None:
            return None
        with Lifetime() as owned:
            residual = owned.own(formulation.pattern.torn.A.createVecLeft())
            residual.array[:] = r
            return precondition(formulation, residual)

    def errors_of_correction(self, z: Array, references: Sequence[Array]) -> tuple[float, float]:
        """Return the estimated error η by which a correction z changes a solution. Collective.

        Args:
            z: The correction, (N,).
            references: Vectors that it is relative to, (N,) each; their squares are added.

        Returns:
            η, the largest over the components (``accuracy``), and η of all components together; nan
            if nothing is set up.
        """
        formulation = self.formulation
        if formulation is None:
            return np.nan, np.nan
        # A component counts as zero only if it is tiny in all references.
        state = np.abs(references).sum(axis=0)
        norms = ComponentNorms(formulation.pattern.torn).for_state(state)
        return norms.ratios_of_correction(z, references)

    def store_outcome(self, ksp: PETSc.KSP, info: SolveInfo, error_tolerance: float) -> None:
        """Store and log the outcome of a solution that was composed of several solves.

        Args:
            ksp: The solver of this context.
            info: How the composed solve has ended (``converged_reason.composed_outcome``).
            error_tolerance: Tolerance of η, for the log.
        """
        self._store(ksp, info)
        self._log_error(ksp, error_tolerance)

    # -- output for the user ----------------------------------------------------------------------

    def report(self) -> Report | None:
        """Return the figures of ``-ksp_view``; None if nothing is set up. Collective."""
        if self.formulation is None:
            return None
        return create_report(self.formulation, self.info, age=self.age)

    def _print_table_once(self, ksp: PETSc.KSP) -> None:
        """Print the KSP's tolerances and the table, once for each pattern. Collective."""
        if self.formulation is None or not self._prints_table:
            return
        if self._cache.pattern_number == self._viewed_pattern:
            return
        self._viewed_pattern = self._cache.pattern_number
        screen = PETSc.Viewer.STDOUT(ksp.comm)
        rtol, atol, _, max_it = ksp.getTolerances()
        processes = "MPI process" if ksp.comm.size == 1 else "MPI processes"
        screen.printfASCII(f"KSP Object: ({self._prefix}) {ksp.comm.size} {processes}\n")
        screen.printfASCII(
            f"  tolerances            rtol {rtol:g}, atol {atol:g}, max_it {max_it}\n"
        )
        self.view(ksp, screen)

    def _warn_of_unread_options(self, ksp: PETSc.KSP) -> None:
        """Log the options that nothing has read, once, unless a problem logs them. Collective."""
        if self._has_checked_options or not self._logs_unread_options:
            return
        self._has_checked_options = True
        prefix = self._prefix or ""
        unread = {
            name: value
            for name, value in unread_options(prefix).items()
            if name.startswith(("ksp_", "feti_"))
        }
        warn_of_unread(prefix, unread, ksp.comm.tompi4py())

    def _log(self, ksp: PETSc.KSP) -> None:
        """Log a failure, or an error that rounding leaves, on the first process.

        A refused matrix is not logged: the caller has asked for the refusal.
        """
        if self.info.reason > 0:
            self._log_error(ksp, self.rtol)
        elif not self._is_refused() and ksp.comm.rank == 0:
            logger.log(self._log_level(), "FETI did not converge: %s", self.message)

    def _log_error(self, ksp: PETSc.KSP, error_tolerance: float) -> None:
        """Log an estimated error that rounding leaves, if it is large enough to be noticed."""
        if self.error_floor > LOGGED_ROUNDING_SHARE and ksp.comm.rank == 0:
            logger.log(self._log_level(), ERROR_FLOOR_WARNING, self.error_floor, error_tolerance)

    def _log_level(self) -> int:
        """Return DEBUG for Newton's method, which recovers from failures and corrects errors."""
        return logging.DEBUG if self._newton else logging.WARNING
