# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The interface of a problem whose equilibria a path follows."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from petsc4py import PETSc

import dolfinx

from dolfinx_feti.fem.internal_variables import Updated
from dolfinx_feti.fem.user_forms.form_content import FormContent
from dolfinx_feti.problems.equations.tangent import TangentId
from dolfinx_feti.problems.history import NewtonStep

__all__ = ["Problem"]


@runtime_checkable
class Problem(Protocol):
    """A :class:`NonlinearProblem` or a fixed point of one.

    Members that are not described here have the meaning of those of :class:`NonlinearProblem`.
    """

    @property
    def unknown(self) -> dolfinx.fem.Function:
        """The unknown that is torn, such as the displacement."""

    @property
    def content(self) -> FormContent:
        """The unknowns, coefficients and constants of the forms."""

    @property
    def solver(self) -> PETSc.SNES:
        """The Newton solver."""

    @property
    def history(self) -> list[NewtonStep]:
        """The Newton steps of the last solve."""

    @property
    def internal_variables(self) -> tuple[dolfinx.fem.Function, ...]:
        """The Functions with the memory of material, scalars and contacts."""

    @property
    def n_updates(self) -> int:
        """Number of updates of multipliers of the volume in the last solve.

        Each update costs about one Newton step.
        """

    def solve(
        self,
        *,
        reference: float | None = None,
        first_tangent: TangentId | None = None,
        renew: bool = True,
        give_up_early: bool = False,
        check_cells: bool = True,
    ) -> object:
        """Solve from the present state, see :meth:`NonlinearProblem.solve`. Collective.

        Raises:
            InadmissibleStartError: The state is not admissible, but another one may be.
            ConvergenceError: The solve failed; any state may be left behind.
        """

    def residual_norm(self) -> float:
        """Return ‖r‖ in the present state. Collective."""

    def linearise(self) -> TangentId:
        """Assemble the tangent of the present state. Collective."""

    def begin_step(self, length: float) -> None:
        """Prepare scalars and contacts for a step of this length, in the unit of the path."""

    def update_internal_variables(self, which: Updated = "all") -> None:
        """Update the internal variables from the present state. Collective."""

    def warn_of_cells(self) -> None:
        """Warn of cells of the present state that are distorted. Collective."""

    def renew(self) -> None:
        """Discard the preconditioner; the next solve makes a new one."""
