# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What outlives its matrix, for how long, and when it is made anew: decided here alone.

- The *pattern* lasts until the pattern of the matrix changes, or its symmetry.
- The *preconditioner* of the primal form serves up to ``feti_lag`` later matrices of Newton's
  method, unless a solve takes far more iterations for a digit than the first one with it.
- The *Ritz vectors* of each solve serve the next matrices of Newton's method.

All end with :meth:`Lasting.renew`. Parts with objects of PETSc belong to one of three owners, of
the pattern, of the preconditioner, or of the matrix. Nothing else ends them.
"""

from __future__ import annotations

from dataclasses import replace

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.errors import SetUpError, SingularError
from dolfinx_feti.feti.dual.form import DualForm, create_dual_form
from dolfinx_feti.feti.options import FETIOptions, asks_for_dual
from dolfinx_feti.feti.pattern import Pattern, create_pattern
from dolfinx_feti.feti.primal.form import (
    PrimalForm,
    PrimalPreconditioner,
    create_preconditioner,
    create_preconditioner_of_part,
    create_primal_form,
)
from dolfinx_feti.feti.setup import Inertia, Setup, refined, set_up, set_up_operator
from dolfinx_feti.feti.solution import RitzVectors, Solution
from dolfinx_feti.feti.subdomain.operator import Operator
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.torn.matrix import State, state_of

Reason = PETSc.KSP.ConvergedReason

#: The method, set up for one matrix.
Form = DualForm | PrimalForm

#: Growth of the iterations for a digit that ends a solve with an old preconditioner.
HOPELESS = 3.0

#: Digits beyond which no residual falls.
MOST_DIGITS = 13.0


class Lasting:
    """The owner of the pattern, the form and the Ritz vectors of a solver.

    Attributes:
        form: The method set up for the last matrix; None before the first one, and after a failure.
        age: Matrices since the one that the preconditioner belongs to.
    """

    def __init__(self, options: FETIOptions, prefix: str, *, newton: bool) -> None:
        """Begin with nothing; see ``FETI`` for ``newton``."""
        self._options, self._prefix = options, prefix
        self._newton = newton
        self._of_pattern, self._of_preconditioner, self._of_matrix = (Lifetime() for _ in range(3))
        self._pattern: Pattern | None = None
        self._state: State | None = None  # of the matrix that pattern and form belong to
        self.form: Form | None = None
        self._vectors: RitzVectors | None = None
        self._outdated = False
        self.age = 0
        self._seen = False  # is the pattern in a table that the user has?
        self._rate = np.nan  # iterations for a digit in the first solve with the preconditioner

    def first_look(self) -> bool:
        """Tell whether this is the first look at a form of the present pattern."""
        first = self.form is not None and not self._seen
        self._seen = self._seen or first
        return first

    def renew(self) -> None:
        """Let the next matrix have a preconditioner of its own, and no Ritz vectors."""
        self._outdated, self._vectors = True, None

    def take(self, A: PETSc.Mat) -> None:
        """Bring the form up to the state of a torn matrix. Collective.

        Raises:
            SetUpError: It cannot be set up; there is no form then.
        """
        state, known = state_of(A), self._state
        has_pattern = known is not None and known.pattern == state.pattern
        has_form = has_pattern and self.form is not None and known == state
        comm = A.comm.tompi4py()
        if comm.allreduce(has_form, op=MPI.LAND):
            state.destroy()
            return
        self._state = state
        if known is not None:
            known.destroy()
        known_pattern = self._pattern if comm.allreduce(has_pattern, op=MPI.LAND) else None
        if known_pattern is None or known_pattern.torn.is_symmetric() != known_pattern.symmetric:
            self._end_pattern()
            self._pattern = create_pattern(A, self._options, self._prefix, self._of_pattern)
        assert self._pattern is not None
        try:
            self._take_into_form(self._pattern)
        except Exception:
            self._end_form()
            raise

    def record(self, solution: Solution) -> None:
        """Note how a solve went."""
        self._vectors, residual = solution.ritz_vectors, solution.residual
        digits = -np.log10(residual) if 0.0 < residual < 1.0 else np.nan
        if solution.reason > 0 and solution.iterations and np.isnan(self._rate):
            self._rate = solution.iterations / digits

    def most_iterations(self, max_it: int, rtol: float) -> int:
        """Return the most iterations of a solve: with an old preconditioner it may end early."""
        if not self.age or np.isnan(self._rate * rtol):
            return max_it
        digits = np.clip(-np.log10(max(rtol, 10.0**-MOST_DIGITS)), 1.0, None)
        return min(max_it, int(np.ceil(HOPELESS * digits * self._rate)))

    def try_again(self, reason: int, *, saddles: bool) -> bool:
        """Prepare another solve after one has failed; tell whether there is one. Collective.

        ``saddles`` tells whether a solution is wanted where the matrix is indefinite. After a
        SetUpError there is no form.
        """
        pattern, form = self._pattern, self.form
        if pattern is None or form is None:
            return False
        try:
            if reason == Reason.DIVERGED_INDEFINITE_MAT and not form.solves_indefinite:
                if not (self._options.formulation == "auto" and saddles):
                    return False  # no preconditioner changes the curvature
                if isinstance(form, PrimalForm) and not self.age:
                    self.form = None
                    form.coarse.destroy()
                    own = form.preconditioner
                    parts = Setup(form.operator, own.delta, own.inverse, own.inertia)
                    self.form = self._dual_form(pattern, parts)
                    return True
            if not self.age:
                return False
            self.renew()
            self._take_into_form(pattern)
        except Exception:
            self._end_form()
            raise
        return True

    def _take_into_form(self, pattern: Pattern) -> None:
        """Set up the form of the present matrix, with the last preconditioner if it lasts."""
        preconditioner = self._lasting_preconditioner()
        self.form = None
        self._of_matrix.close()
        if preconditioner is not None:
            try:
                self.form = self._primal_form(pattern, preconditioner)
                self.age += 1
                return
            except SingularError:
                raise
            except SetUpError:
                pass  # the present matrix may still be set up on its own
        self._end_form()
        self._outdated, self.age, self._rate = False, 0, np.nan
        self.form = self._new_form(pattern)

    def _new_form(self, pattern: Pattern) -> Form:
        """Set up the form of the present matrix with a preconditioner of its own."""
        if not pattern.symmetric:
            part = create_preconditioner_of_part(pattern, self._of_preconditioner)
            return self._primal_form(pattern, part)
        rough = _prefers_primal(pattern)
        setup = set_up(pattern, self._of_matrix, self._of_preconditioner, rough=rough)
        if not _takes_primal(pattern, setup.inertia):
            return self._dual_form(pattern, setup)
        preconditioner = create_preconditioner(pattern, setup, self._of_preconditioner)
        return self._primal_form(pattern, preconditioner, setup.operator)

    def _primal_form(
        self, pattern: Pattern, own: PrimalPreconditioner, S: Operator | None = None
    ) -> PrimalForm:
        """Set up the primal form of the present matrix, or of its S, with a preconditioner."""
        S = S or set_up_operator(pattern, self._of_matrix)
        most = self._options.deflation if self._newton else 0
        return create_primal_form(pattern, S, own, self._of_matrix, self._vectors, most=most)

    def _dual_form(self, pattern: Pattern, setup: Setup) -> DualForm:
        """Set up the dual form of the present matrix."""
        setup = refined(pattern, setup, self._of_preconditioner)
        return create_dual_form(pattern, setup, self._of_matrix)

    def _lasting_preconditioner(self) -> PrimalPreconditioner | None:
        """Return the preconditioner of the last matrix if it serves another one."""
        form = self.form
        young = self._newton and not self._outdated and self.age < self._options.lag
        if not isinstance(form, PrimalForm) or not young:
            return None
        return replace(form.preconditioner, combinations=form.coarse.combinations)

    def destroy(self) -> None:
        """Free everything."""
        self._end_pattern()
        if self._state is not None:
            self._state.destroy()
            self._state = None

    def _end_form(self) -> None:
        """Free what belongs to a matrix or to its preconditioner."""
        self.form = None
        self._of_matrix.close()
        self._of_preconditioner.close()

    def _end_pattern(self) -> None:
        """Free what belongs to the pattern, too."""
        self._end_form()
        self._of_pattern.close()
        self._pattern = self._vectors = None
        self._seen = False


def _prefers_primal(pattern: Pattern) -> bool:
    """Tell whether a symmetric matrix takes the primal form unless a K_ρ is indefinite.

    That is so where a pressure is condensed, as adaptive columns halve the iterations there.
    """
    condensed = pattern.torn.pressures is not None
    allowed = not asks_for_dual(pattern.options, pattern.prefix)
    return allowed and (condensed or pattern.options.formulation == "primal")


def _takes_primal(pattern: Pattern, inertia: Inertia) -> bool:
    """Tell whether a symmetric matrix is solved in the primal form.

    ``auto`` does so, too, where a subdomain would buckle alone: the dual system is indefinite then.
    """
    if pattern.options.formulation != "auto":
        return pattern.options.formulation == "primal"
    safe = inertia.local == 0 and not asks_for_dual(pattern.options, pattern.prefix)
    return safe and (not inertia.definite or _prefers_primal(pattern))
