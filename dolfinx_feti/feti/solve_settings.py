# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""When a solve may end: tolerances and limits of the KSP, and what Newton's method allows.

These change from solve to solve. Options of the solver, which do not, are in ``options``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_feti.runtime.arrays import Array

#: Largest number of digits by which a residual can fall. A double has 16; the bound only limits
#: iterations if the user's tolerance is tighter. A choice: with 15 such a solve may take 15 % more
#: iterations before a reused preconditioner is given up.
MAX_DIGITS = 13.0


@dataclass(frozen=True, slots=True)
class Tolerances:
    """Tolerances and limits of one solve.

    Attributes:
        rtol: Relative tolerance of the KSP, for residual and estimated error.
        atol: Absolute tolerance of the KSP, in the units of b.
        max_it: Number of iterations that the KSP still allows.
        max_iterations_per_digit: Largest number of iterations for each digit by which the residual
            has to fall; infinite for a new preconditioner (``cache``).
    """

    rtol: float
    atol: float
    max_it: int
    max_iterations_per_digit: float = np.inf

    def iteration_limit(self, rtol: float) -> int:
        """Return the largest number of iterations for a relative tolerance.

        Args:
            rtol: Largest ‖b − A x‖/‖b − A x_D‖, by both tolerances; nan if the load is zero.
        """
        if np.isinf(self.max_iterations_per_digit) or np.isnan(rtol):
            return self.max_it
        digits = max(1.0, -np.log10(max(rtol, 10.0**-MAX_DIGITS)))
        return min(self.max_it, int(np.ceil(digits * self.max_iterations_per_digit)))


@dataclass(frozen=True, slots=True)
class ErrorAllowance:
    """An estimated error that is small enough, although the tolerances of the KSP may be tighter.

    Attributes:
        error_tolerance: Largest η. A tighter tolerance of the KSP is raised to it.
        allowed_error: An error of the size of this vector is small enough for any x, even if x is
            tiny, (N,).
    """

    error_tolerance: float
    allowed_error: Array


@dataclass(frozen=True, slots=True)
class SolveSettings:
    """What the caller of a solve allows beyond the tolerances of the KSP.

    Newton's method sets all three; a linear problem has the defaults.

    Attributes:
        error_allowance: Estimated error that is small enough although the tolerances are tighter,
            because the next step of Newton's method corrects it.
        load_rounding: Size of the rounding errors of b, in its units. The part of b in a null space
            of A may be as large: the last residuals of Newton's method consist of rounding.
        allow_indefinite: Whether to solve if A is indefinite; otherwise the solve ends with the
            reason ``DIVERGED_INDEFINITE_MAT``.
    """

    error_allowance: ErrorAllowance | None = None
    load_rounding: float = 0.0
    allow_indefinite: bool = True

    def loosen(self, error_tolerance: float, N: int) -> tuple[float, Array]:
        r"""Return the tolerance of η with the allowance, and a second reference for η.

        With the second reference y = allowed_error/τ, η is ‖z‖ / (‖x‖² + ‖y‖²)^½. Hence η ≤ τ for
        any x if ‖z‖ ≤ ‖allowed_error‖.

        Args:
            error_tolerance: Tolerance of η by the KSP.
            N: Number of dofs of the assembled problem on this process.

        Returns:
            The tolerance τ, and the reference y, (N,); zeros without an allowance.
        """
        if self.error_allowance is None:
            return error_tolerance, np.zeros(N)
        error_tolerance = max(error_tolerance, self.error_allowance.error_tolerance)
        return error_tolerance, np.asarray(self.error_allowance.allowed_error / error_tolerance)
