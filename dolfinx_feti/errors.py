# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""All exceptions of the package."""

from __future__ import annotations

__all__ = [
    "ConvergenceError",
    "FactorError",
    "InadmissibleStartError",
    "IndefiniteTangentError",
    "LinearSolverError",
    "SetUpError",
    "SingularBlockError",
    "SingularError",
    "ToolCrossedError",
]


class FactorError(ArithmeticError):
    """A block could not be factored."""


class SingularBlockError(FactorError):
    """A block is singular beyond its null vectors, to rounding."""


class SetUpError(ArithmeticError):
    """The FETI system cannot be set up; raised on all processes, with the remedy."""


class SingularError(SetUpError):
    """The matrix is singular: as a whole, or a subdomain has more kernel modes than candidates."""


class ConvergenceError(RuntimeError):
    """A solver did not converge; the message names the cause and the remedy."""


class InadmissibleStartError(ConvergenceError):
    """A solve cannot begin in this state, but may from another one.

    A cell is inside out, or the tangent of a predicted state is indefinite.
    """


class IndefiniteTangentError(ConvergenceError):
    """The tangent is singular or indefinite, and no shift helps."""


class LinearSolverError(ConvergenceError):
    """The linear solver failed in a step of Newton's method; the message has its own remedy."""


class ToolCrossedError(ConvergenceError):
    """The surface of a body has passed through a rigid tool."""
