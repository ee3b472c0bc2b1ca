# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Numbers of negative eigenvalues over all subdomains; None where a factor does not tell."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Inertia"]


@dataclass(frozen=True, slots=True)
class Inertia:
    """Negative eigenvalues of what a torn matrix is turned into, over all processes.

    Attributes:
        local: Those of all regularised subdomains K_ρ.
        defect: Those of the defects D of all kernels.
        interior: Those of all interior blocks K_II; None where none is factored, too.
        assembled: Those that the assembled matrix is proved to have (``coarse.space``).
    """

    local: int | None
    defect: int
    interior: int | None
    assembled: int | None

    @property
    def dual(self) -> int | None:
        """Those of all K_ρ and D together; without any, CG is safe on the dual system."""
        return None if self.local is None else self.local + self.defect

    @property
    def definite(self) -> bool:
        """Whether the dual system is known to be positive definite on balanced pairs."""
        return self.dual == 0

    @property
    def indefinite(self) -> bool:
        """Whether the assembled matrix is proved to be indefinite."""
        return bool(self.assembled)
