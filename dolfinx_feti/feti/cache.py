# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Reuse of pattern, preconditioner and Ritz vectors for later matrices.

- The *pattern* is reused until the pattern of the matrix changes, or its symmetry.
- The *preconditioner* of the primal form is reused for up to ``max_age`` later matrices of
  Newton's method (option ``feti_lag``), unless a solve takes :data:`MAX_GROWTH` times as many
  iterations per digit of the residual as the first one with it.
- The *Ritz vectors* of each solve deflate the solves with later matrices of Newton's method.

:meth:`SolverCache.invalidate` discards the last two. PETSc's objects have one of three owners,
which destroys them: that of the pattern, of the preconditioner, or of the matrix.
"""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.errors import SetUpError, SingularError
from dolfinx_feti.feti.dual.formulation import create_dual_formulation
from dolfinx_feti.feti.formulation import Formulation
from dolfinx_feti.feti.options import FETIOptions, requests_dual
from dolfinx_feti.feti.pattern import Pattern, create_pattern
from dolfinx_feti.feti.primal.formulation import PrimalFormulation, create_primal_formulation
from dolfinx_feti.feti.primal.preconditioner import (
    PrimalPreconditioner,
    create_preconditioner,
    create_symmetric_part_preconditioner,
)
from dolfinx_feti.feti.setup import (
    Inertia,
    Setup,
    require_valid_matrix,
    set_up,
    set_up_operator,
    to_double_precision,
)
from dolfinx_feti.feti.solve_info import DeflationVectors, SolveInfo
from dolfinx_feti.feti.subdomain.failures import on_subdomains
from dolfinx_feti.feti.subdomain.schur_operator import SchurOperator
from dolfinx_feti.feti.subsolver_options import SubsolverOptions
from dolfinx_feti.runtime.collective import warn
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.torn.matrix import MatrixVersion, version_of

Reason = PETSc.KSP.ConvergedReason

#: Growth of the iterations per digit at which a solve with a reused preconditioner ends and is
#: repeated with a new one (docs/theory.md, what lasts). A choice, not tuned.
MAX_GROWTH = 3.0


class SolverCache:
    """The owner of the pattern, the formulation and the Ritz vectors of a solver.

    Attributes:
        formulation: The method set up for the last matrix; None before the first one, and after a
            failure.
        age: Number of matrices since the one that the preconditioner was built for.
        pattern_number: Number of patterns so far; the present one is the last.
    """

    def __init__(self, options: FETIOptions, subsolvers: SubsolverOptions, *, newton: bool) -> None:
        """Create an empty cache.

        Args:
            options: Options of the solver.
            subsolvers: Options of its sub-solvers.
            newton: Whether the matrices are those of Newton's method; else only the pattern is
                reused.
        """
        self._options = options
        self._subsolvers = subsolvers
        self._newton = newton
        self._pattern_objects = Lifetime()
        self._preconditioner_objects = Lifetime()
        self._matrix_objects = Lifetime()
        self._pattern: Pattern | None = None
        #: Version of the matrix that pattern and formulation belong to.
        self._version: MatrixVersion | None = None
        self.formulation: Formulation | None = None
        self._ritz_vectors: DeflationVectors | None = None
        self._is_invalid = False  # whether the next matrix needs a new preconditioner
        self.age = 0
        self.pattern_number = 0
        self._rate = np.nan  # iterations per digit of the first solve with the preconditioner

    @property
    def max_iterations_per_digit(self) -> float:
        """Largest number of iterations per digit that a solve with the preconditioner may take.

        A solve ends there, and :meth:`prepare_retry` builds a new preconditioner. It is infinite
        for a new one, or if no solve has measured the rate.
        """
        if self.age == 0 or np.isnan(self._rate):
            return np.inf
        return MAX_GROWTH * self._rate

    def invalidate(self) -> None:
        """Discard the Ritz vectors, and the preconditioner when the next matrix is set up."""
        self._is_invalid = True
        self._ritz_vectors = None

    def update(self, A: PETSc.Mat) -> None:
        """Set up the formulation for a torn matrix, if the matrix has changed. Collective.

        Raises:
            SetUpError: It cannot be set up; there is no formulation then.
        """
        version = version_of(A)
        last = self._version
        has_same_pattern = last is not None and last.pattern == version.pattern
        is_unchanged = has_same_pattern and self.formulation is not None and last == version
        comm = A.comm.tompi4py()
        if comm.allreduce(is_unchanged, op=MPI.LAND):
            version.destroy()
            return
        self._version = version
        if last is not None:
            last.destroy()
        pattern = self._pattern if comm.allreduce(has_same_pattern, op=MPI.LAND) else None
        if pattern is None or pattern.torn.is_symmetric() != pattern.is_symmetric:
            self._free_pattern()
            pattern = create_pattern(A, self._options, self._subsolvers, self._pattern_objects)
            self._pattern = pattern
            self.pattern_number += 1
        errors = pattern.errors
        errors.clear()  # those of an earlier set-up that failed for another reason
        try:
            self._set_up(pattern)
            on_subdomains(errors.raise_first, comm)
        except Exception:
            self._free_formulation()
            raise

    def record(self, info: SolveInfo) -> None:
        """Store the Ritz vectors of a solve, and of a first one its rate of convergence.

        Outside Newton's method Ritz vectors are not stored: each matrix is deflated by soft fields
        of its own.

        The rate is the number of iterations per digit, as in ``Tolerances.iteration_limit``. The
        number of digits is −log₁₀ of the relative residual, or of its tolerance if that is larger:
        the residual may be far below its tolerance, because with a penalty η ends the solve.
        """
        accuracy = info.accuracy
        if self._newton:
            self._ritz_vectors = info.ritz_vectors
        is_first = np.isnan(self._rate)
        if not is_first or info.reason <= 0 or info.iterations == 0:
            return
        residual = float(np.fmax(accuracy.residual, accuracy.rtol))
        if 0.0 < residual < 1.0:
            self._rate = info.iterations / -np.log10(residual)

    def prepare_retry(self, failed: SolveInfo, *, allow_indefinite: bool) -> bool:
        """Set up another way to solve after a failure, if there is one. Collective.

        Args:
            failed: Outcome of the solve that failed.
            allow_indefinite: Whether to solve if the matrix is indefinite.

        Returns:
            Whether it has been set up, so that another solve is to follow.

        Raises:
            SetUpError: The other way cannot be set up; there is no formulation then.
        """
        if self._pattern is None or self.formulation is None:
            return False
        try:
            return self._set_up_retry(
                self._pattern, self.formulation, failed, allow_indefinite=allow_indefinite
            )
        except Exception:
            self._free_formulation()
            raise

    def _set_up_retry(
        self,
        pattern: Pattern,
        formulation: Formulation,
        failed: SolveInfo,
        *,
        allow_indefinite: bool,
    ) -> bool:
        """Set up another way to solve, see :meth:`prepare_retry`.

        The first case that applies determines the way:

        1. CG met negative curvature, and there is no dual form (``setup_for_dual``), or the caller
           does not allow an indefinite matrix: none. Another preconditioner would meet the same
           curvature.
        2. CG met negative curvature with a new preconditioner: the dual form.
        3. The preconditioner was reused: a new one.
        4. The coarse solver of the primal form returned NaN: the dual form, which has another one.
        5. Any other failure: none.
        """
        setup = formulation.setup_for_dual()
        is_reused = self.age > 0
        if failed.reason == Reason.DIVERGED_INDEFINITE_MAT and not formulation.solves_indefinite:
            if setup is None or not allow_indefinite:
                return False
            if not is_reused:
                self._replace_by_dual(pattern, formulation, setup)
                return True
        if is_reused:
            self.invalidate()
            self._set_up(pattern)
            return True
        # Matrix, load and residual are finite, so only the coarse solver can have returned NaN.
        is_finite = bool(np.isfinite(failed.accuracy.residual))
        has_coarse_failed = failed.reason == Reason.DIVERGED_NANORINF and is_finite
        if has_coarse_failed and setup is not None:
            self._replace_by_dual(pattern, formulation, setup)
            return True
        return False

    def _replace_by_dual(self, pattern: Pattern, formulation: Formulation, setup: Setup) -> None:
        """Set up the dual formulation in place of one that has failed.

        Args:
            pattern: All that depends on the pattern.
            formulation: The formulation that has failed.
            setup: Its parts that the dual one uses, from ``setup_for_dual``.
        """
        self.formulation = None
        # This frees memory now; its owner destroys it again, without effect.
        formulation.coarse.destroy()
        self.formulation = self._create_dual(pattern, setup)

    def _set_up(self, pattern: Pattern) -> None:
        """Set up the formulation of the present matrix, if possible with the last preconditioner.

        If that fails, a new preconditioner is built. A SingularError is raised at once, because no
        preconditioner helps.
        """
        require_valid_matrix(pattern.torn)
        preconditioner = self._reusable_preconditioner()
        self.formulation = None
        self._matrix_objects.close()
        if preconditioner is not None:
            try:
                self.formulation = self._create_primal(pattern, preconditioner)
            except SingularError:
                raise
            except SetUpError:
                pass  # the formulation is created below, with a new preconditioner
            else:
                self.age += 1
                return
        self._free_formulation()
        self.formulation = self._create_formulation(pattern)

    def _create_formulation(self, pattern: Pattern) -> Formulation:
        """Create the formulation of the present matrix with a new preconditioner."""
        if not pattern.is_symmetric:
            preconditioner = create_symmetric_part_preconditioner(
                pattern, self._preconditioner_objects
            )
            return self._create_primal(pattern, preconditioner)
        setup = set_up(
            pattern,
            self._matrix_objects,
            self._preconditioner_objects,
            is_primal=not requests_dual(pattern.options, pattern.subsolvers),
        )
        if not _uses_primal(pattern, setup.inertia):
            return self._create_dual(pattern, setup)
        try:
            preconditioner = create_preconditioner(pattern, setup, self._preconditioner_objects)
            return self._create_primal(pattern, preconditioner, setup.operator)
        except SingularError:
            raise
        except SetUpError as error:
            if pattern.options.formulation == "primal":
                raise
            warn(
                f"The primal formulation cannot be set up, and the dual one is used ({error}). "
                f"-{pattern.subsolvers.prefix}formulation dual chooses it from the start.",
                pattern.torn.comm,
            )
            return self._create_dual(pattern, setup)

    def _create_primal(
        self,
        pattern: Pattern,
        preconditioner: PrimalPreconditioner,
        operator: SchurOperator | None = None,
    ) -> PrimalFormulation:
        """Create the primal formulation of the present matrix.

        Args:
            pattern: All that depends on the pattern.
            preconditioner: A new or an earlier preconditioner.
            operator: Schur complements S of the present matrix; computed if not passed.
        """
        if operator is None:
            operator = set_up_operator(pattern, self._matrix_objects)
        return create_primal_formulation(
            pattern,
            operator,
            preconditioner,
            self._matrix_objects,
            self._ritz_vectors,
            max_ritz_vectors=self._options.deflation if self._newton else 0,
        )

    def _create_dual(self, pattern: Pattern, setup: Setup) -> Formulation:
        """Create the dual formulation of the present matrix, in double precision."""
        setup = to_double_precision(pattern, setup, self._preconditioner_objects)
        return create_dual_formulation(pattern, setup, self._matrix_objects)

    def _reusable_preconditioner(self) -> PrimalPreconditioner | None:
        """Return the preconditioner of the last matrix if it may serve another one, else None."""
        formulation = self.formulation
        if self._is_invalid or not self._newton or self.age >= self._options.max_age:
            return None
        return None if formulation is None else formulation.preconditioner_for_later_matrix()

    def destroy(self) -> None:
        """Free everything."""
        self._free_pattern()
        if self._version is not None:
            self._version.destroy()
            self._version = None

    def _free_formulation(self) -> None:
        """Free what belongs to the matrix and to its preconditioner, whose age and rate end."""
        self.formulation = None
        self._matrix_objects.close()
        self._preconditioner_objects.close()
        self._is_invalid = False
        self.age = 0
        self._rate = np.nan

    def _free_pattern(self) -> None:
        """Free what belongs to the pattern, the matrix and the preconditioner."""
        self._free_formulation()
        self._pattern_objects.close()
        self._pattern = None
        self._ritz_vectors = None


def _uses_primal(pattern: Pattern, inertia: Inertia) -> bool:
    """Return True if the primal formulation solves with a symmetric matrix.

    With ``auto``, all K_ρ have to be positive definite: CG needs a definite preconditioner.
    """
    if pattern.options.formulation != "auto":
        return pattern.options.formulation == "primal"
    return inertia.local == 0 and not requests_dual(pattern.options, pattern.subsolvers)
