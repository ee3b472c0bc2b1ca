# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What the parts of Newton's method pass to each other: start, iterate, direction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_feti.problems.equations.system import Residual, System
from dolfinx_feti.problems.equations.tangent import TangentId
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.norms import max_norm, norm

#: Share of the largest displacement up to which u − g of a Dirichlet dof is rounding. An update
#: u ← u + α Δu leaves some 2e-16 of it; a linear solve with a tolerance of 1e-8 leaves up to 1e-8,
#: which another step has to correct. Any value in between separates the two.
PRESCRIBED_RTOL = 1e-12


@dataclass(frozen=True, slots=True)
class Start:
    """How a solve begins, apart from the state, and when it may end."""

    #: Upper bound of the ‖r⁰‖ that the relative tolerance refers to, such as ‖r‖ of the last
    #: equilibrium under the new load.
    reference_norm: float = np.inf
    follows_equilibrium: bool = False  # the caller comes from an equilibrium, and gave reference=
    tangent: TangentId | None = None  # of the first step, already in the matrix; None: assemble it
    is_intermediate: bool = False  # ends at a tenth of ‖r⁰‖, as multipliers change afterwards
    allows_early_end: bool = False  # the caller can try another start or a smaller load step


@dataclass(frozen=True, slots=True)
class Iterate:
    """A state U^k of Newton's method, which the System stores, and norms of its forces."""

    residual: Residual  # r(U^k)
    norm: float  # ‖r‖ over the free dofs
    reaction_norm: float  # the largest norm of the forces of supports, of scalars, of a contact
    violates_constraints: bool  # a Dirichlet value or a scalar equation is not satisfied
    potential: float = np.nan  # Π(U^k); NaN if it was not evaluated


def evaluate(system: System, residual: Residual, potential: float = np.nan) -> Iterate:
    """Return the iterate at the present state, from its residual and potential. Collective."""
    return Iterate(
        residual,
        norm(system.comm, residual.condensed),
        _reaction_norm(system, residual),
        _violates_constraints(system, residual),
        potential,
    )


def _reaction_norm(system: System, residual: Residual) -> float:
    """Return the largest of the norms of the forces on Dirichlet dofs, of scalars, of contacts."""
    free = system.conditions.free
    supports = norm(system.comm, residual.force - free(residual.force))
    scalars = norm(system.comm, free(system.scalars.force()))
    contacts = [norm(system.comm, free(forces)) for forces in system.contact_forces()]
    return max(supports, scalars, *contacts)


def _violates_constraints(system: System, residual: Residual) -> bool:
    """Return True if a Dirichlet value or a scalar equation is not satisfied.

    The answer is the same on all processes. Collective.
    """
    gap = max_norm(system.comm, residual.gap)
    size = max_norm(system.comm, system.state.owned_u)
    if gap > PRESCRIBED_RTOL * size:
        return True
    # the largest size h/c on this process serves for all its dofs; the scale of an equation, a sum
    # over all processes, is the same on all
    h = np.max(system.lengths, initial=0.0)
    return not system.scalars.are_satisfied(residual.of_scalars, system.state.owned_u, h)


@dataclass(frozen=True, slots=True)
class Direction:
    """The direction of a Newton step, and what its linear solves cost."""

    du: Array  # Δu, (owned,); condensed fields follow from it
    ds: Array  # Δs, (scalars,)
    shift: float  # σ of its tangent
    iterations: tuple[int, ...]  # Krylov iterations of each linear solve
    indefinite: int | None  # proved number of negative eigenvalues of the tangent without a shift
    #: Whether ΔU·r < 0 was required. If not, ΔU may lead uphill, and the potential is not used to
    #: accept the step.
    is_descent: bool

    @property
    def is_shifted(self) -> bool:
        """Whether σ > 0."""
        return self.shift > 0.0
