# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Problems that are fixed points U = g(U), where each evaluation of g solves another problem.

A path follows such a problem like the inner one. The wall without load (``unloaded``) and the
prestress of an image (``prestressed``) are fixed points.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

from petsc4py import PETSc

import dolfinx

from dolfinx_feti.fem.internal_variables import Updated
from dolfinx_feti.fem.user_forms.form_content import FormContent
from dolfinx_feti.problems.equations.tangent import TangentId
from dolfinx_feti.problems.history import NewtonStep
from dolfinx_feti.problems.nonlinear_problem import NonlinearProblem
from dolfinx_feti.runtime.anderson import Anderson

__all__ = ["MAX_SOLVES", "FixedPoint"]

#: Largest number of inner solves at a load: a bound on iterations that do not converge.
MAX_SOLVES = 50


class FixedPoint(ABC):
    """A problem, with the interface of a NonlinearProblem, that iterates the solves of another one.

    Attributes:
        u: The unknown of the inner problem.
        history: The Newton steps of all inner solves of the last solve.
        internal_variables: An empty tuple: loads on the way to a shape or a stress are no history.
        n_updates: Number of updates of multipliers in all inner solves of the last solve.
    """

    internal_variables: tuple[dolfinx.fem.Function, ...] = ()

    def __init__(self, problem: NonlinearProblem) -> None:
        """Create a fixed point of a problem's solves.

        Raises:
            ValueError: The problem has contacts.
        """
        if problem.has_contacts:
            raise ValueError(
                "The problem has contacts, whose pressure in an image is not known: any pressure "
                "keeps the body there. State the pressure in the forms, without contacts=, for "
                "prestress and unload."
            )
        self._problem = problem
        self.u = problem.unknown
        self._comm = self.u.function_space.mesh.comm
        self.history: list[NewtonStep] = []
        self.n_updates = 0
        self._first_tangent: TangentId | None = None  # of the next inner solve
        self._renews = True  # whether the next inner solve discards the preconditioner

    # -- the interface of the inner problem --------------------------------------------------------

    @property
    def unknown(self) -> dolfinx.fem.Function:
        """The unknown of the inner problem."""
        return self._problem.unknown

    @property
    def content(self) -> FormContent:
        """The content of the inner problem's forms."""
        return self._problem.content

    @property
    def solver(self) -> PETSc.SNES:
        """The Newton solver of the inner problem."""
        return self._problem.solver

    def residual_norm(self) -> float:
        """Return ‖r‖ of the inner problem. Collective."""
        return self._problem.residual_norm()

    def linearise(self) -> TangentId:
        """Assemble the tangent of the inner problem. Collective."""
        return self._problem.linearise()

    def warn_of_cells(self) -> None:
        """Warn of distorted cells of the inner problem. Collective."""
        self._problem.warn_of_cells()

    def renew(self) -> None:
        """Discard the preconditioner of the inner problem."""
        self._problem.renew()

    def update_internal_variables(self, which: Updated = "all") -> None:
        """Do nothing: internal variables stay as they are."""
        return

    def begin_step(self, length: float) -> None:
        """Do nothing: no step has a duration."""
        return

    # -- the iteration -----------------------------------------------------------------------------

    def solve(
        self,
        *,
        reference: float | None = None,
        first_tangent: TangentId | None = None,
        renew: bool = True,
        give_up_early: bool = False,
        check_cells: bool = True,
    ) -> dolfinx.fem.Function:
        """Iterate to the fixed point; return the unknown. Collective.

        Args:
            reference: Residual norm that the relative tolerance of inner solves refers to, as in
                :meth:`NonlinearProblem.solve`; if not given, that of the first inner solve.
            first_tangent: As there, for the first inner solve.
            renew: As there, for the first inner solve.
            give_up_early: Ignored: inner solves go on until they converge or fail.
            check_cells: Ignored: a path calls :meth:`warn_of_cells` in accepted states.

        Raises:
            ConvergenceError: An inner solve failed, or the iteration did not converge.
        """
        self.history = []
        self.n_updates = 0
        self._first_tangent = first_tangent
        self._renews = renew
        self._iterate(reference)
        return self.u

    @abstractmethod
    def _iterate(self, reference: float | None) -> None:
        """Solve the inner problem until the fixed point is reached. Collective.

        Args:
            reference: Residual norm that the relative tolerance of inner solves refers to; None for
                that of the first one.
        """

    def _solve(self, reference: float | None = None) -> None:
        """Solve the inner problem. Collective.

        The first inner solve has the caller's tangent and preconditioner; later ones reuse the
        preconditioner, as they differ little.
        """
        try:
            self._problem.solve(
                reference=reference,
                first_tangent=self._first_tangent,
                renew=self._renews,
                check_cells=False,
            )
        finally:
            self._first_tangent = None
            self._renews = False
            self.history += self._problem.history
            self.n_updates += self._problem.n_updates

    def _anderson(self, f: dolfinx.fem.Function) -> Anderson:
        """Return Anderson's acceleration of a Function's iterates; only owned dofs count."""
        dofmap = f.function_space.dofmap
        return Anderson(self._comm, dofmap.index_map.size_local * dofmap.index_map_bs)
