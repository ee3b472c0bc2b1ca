# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The stopping test of Krylov methods on the interface, by residual and estimated error.

.. math:: \|r\| ≤ τ_r \quad\text{and}\quad η ≤ τ_η, \qquad r = b - A x, \quad z = Π M r

η compares the norms of z with those of x, component by component; its formula is in ``accuracy``.
After a residual has met its tolerance, η is measured with the z that the next iteration needs: a
measurement costs an application of the preconditioner only if the method ends there.
"""

from __future__ import annotations

from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np

from dolfinx_feti.feti.accuracy import ComponentNorms
from dolfinx_feti.feti.interface.copies import Copies
from dolfinx_feti.runtime.arrays import Array, Integers
from dolfinx_feti.runtime.collective import total_of

Reason = PETSc.KSP.ConvergedReason


@dataclass(frozen=True, slots=True)
class InterfaceErrorTest:
    """Test of the estimated error η of an iterate; interface vectors are stored by copies, (n_Γ,).

    Attributes:
        norms: Norms of components.
        copies: Copies of the interface dofs.
        components: Component of each copy, (n_Γ,); None if the copies form full blocks of dofs.
        solution: Solution of earlier starts, to which the iterate is added, (n_Γ,).
        reference_squares: This process's parts of ‖y_c‖², (bs,), of a second reference y of η
            (``accuracy``), which are added to ‖x_c‖².
        error_tolerance: Largest η that is accepted.
    """

    norms: ComponentNorms
    copies: Copies
    components: Integers | None
    solution: Array
    reference_squares: Array
    error_tolerance: float

    def squares(self, z: Array, x: Array) -> Array:
        """Return this process's parts of ‖z_c‖² and ‖x_c‖², (2 bs,), of z and an iterate x."""
        weights = self.copies.delta
        z_squares = self.norms.weighted_squares(z, weights, self.components)
        x_squares = self.norms.weighted_squares(self.solution + x, weights, self.components)
        return np.concatenate([z_squares, x_squares + self.reference_squares])

    def estimate_from(self, squares: Array) -> float:
        """Return η from the sums of ``squares`` over all processes, (2 bs,)."""
        z_squares, x_squares = np.split(squares, 2)
        return self.norms.largest_ratio(z_squares, x_squares)

    def measure(self, z: Array, x: Array) -> float:
        """Return η of an iterate x with the preconditioned residual z. Collective."""
        return self.estimate_from(total_of(self.squares(z, x), self.copies.comm))


@dataclass(frozen=True, slots=True)
class StoppingTest:
    """Tolerances of residual and error, and a limit of iterations, for a Krylov method.

    ``krylov.iteration`` calls :meth:`reason_of_residual` with ‖r‖, at the start and after each
    iteration. The next iteration computes z of the same residual. If ‖r‖ has met its target, η is
    then tested: :meth:`needs_error_estimate`, :meth:`estimate_error` and :meth:`reason_of_error`.

    Attributes:
        target: Largest ‖r‖ that is accepted.
        max_it: Largest number of iterations.
        error_test: Test of η; None if the residual alone decides.
    """

    target: float
    max_it: int
    error_test: InterfaceErrorTest | None = None

    def reason_of_residual(self, norm: float, its: int, error_estimate: float = np.nan) -> int:
        """Return the converged reason by ‖r‖ after ``its`` iterations.

        Args:
            norm: ‖r‖.
            its: Number of iterations.
            error_estimate: η, or nan if it is unknown.

        Returns:
            The reason. If ‖r‖ has reached its target but η is unknown or too large, it is
            ``ITERATING``, even after the last iteration: the next one tests η.
        """
        if not np.isfinite(norm):
            return Reason.DIVERGED_NANORINF
        if norm <= self.target:
            has_converged = norm == 0.0 or self._accepts_error(error_estimate)
            return Reason.CONVERGED_RTOL if has_converged else Reason.ITERATING
        return Reason.DIVERGED_MAX_IT if its == self.max_it else Reason.ITERATING

    def needs_error_estimate(self, norm: float) -> bool:
        """Return True if ‖r‖ has reached its target, so that η decides."""
        return self.error_test is not None and norm <= self.target

    def estimate_error(self, z: Array, x: Array) -> float:
        """Return η of an iterate x with the preconditioned residual z, (n_Γ,) each. Collective."""
        assert self.error_test is not None  # needs_error_estimate has returned True
        return self.error_test.measure(z, x)

    def reason_of_error(self, error_estimate: float, its: int) -> int:
        """Return the converged reason by η after ``its`` iterations, if ‖r‖ has met its target."""
        if self._accepts_error(error_estimate):
            return Reason.CONVERGED_RTOL
        return Reason.DIVERGED_MAX_IT if its == self.max_it else Reason.ITERATING

    def _accepts_error(self, error_estimate: float) -> bool:
        """Return True if η is within its tolerance or not tested; nan is above any tolerance."""
        return self.error_test is None or error_estimate <= self.error_test.error_tolerance
