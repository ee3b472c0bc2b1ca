# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""All exceptions of the package."""

from __future__ import annotations

__all__ = ["ConvergenceError", "FactorError", "SetUpError", "SingularBlockError", "SingularError"]


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
