# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""What a factor of a block of one subdomain does, however the block is stored and factored.

.. math:: x = (K + ρ\, R R^⊤ + \operatorname{diag} σ)^{-1} y

with orthonormal columns R, a stiffness ρ and a shift σ, each of which may be missing. A factor
belongs to one matrix and does not change.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from dolfinx_feti.runtime.arrays import Array


class Pivots(NamedTuple):
    """What a factor tells of its matrix; None where it does not tell.

    Attributes:
        negative: Number of negative eigenvalues.
        zero: Number of pivots that are exactly zero; a singular matrix may have none.
    """

    negative: int | None
    zero: int | None


class Factor(Protocol):
    """A factored block, (n, n)."""

    @property
    def pivots(self) -> Pivots:
        """Numbers of negative and zero eigenvalues."""

    def solve(self, Y: Array, *, transpose: bool = False) -> Array:
        """Solve for one right-hand side, (n,), or several, (n, r)."""

    def memory(self) -> float:
        """Return the memory of the factor in MiB."""

    def destroy(self) -> None:
        """Free the factor, which solves nothing from then on."""


def require_alive(alive: bool) -> None:
    """Refuse to solve with a destroyed factor, before a library reads memory that is free."""
    if not alive:
        raise RuntimeError("the factor has been destroyed: factor the matrix again")


def sum_known(counts: Sequence[int | None]) -> int | None:
    """Add up numbers; None if one of them is not known."""
    known = [count for count in counts if count is not None]
    return sum(known) if len(known) == len(counts) else None
