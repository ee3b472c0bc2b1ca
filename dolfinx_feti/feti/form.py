# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The protocol that both forms of the method keep, and the choice between them.

The system of the dual form is indefinite as soon as a subdomain would buckle alone. ``auto`` takes
the primal form then, and where a pressure is condensed, if all K_ρ are positive definite; and with
an unsymmetric matrix. The preconditioner has to be Dirichlet's, and no dual Krylov method asked
for.
"""

from __future__ import annotations

from typing import Protocol

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx_feti.feti.coarse.space import AveragedSpace
from dolfinx_feti.feti.dual.coarse import Coarse
from dolfinx_feti.feti.inertia import Inertia
from dolfinx_feti.feti.pattern import Pattern
from dolfinx_feti.feti.solution import Monitor, Solution
from dolfinx_feti.feti.subdomain.modes import SubdomainModes
from dolfinx_feti.feti.subdomain.operator import Operator

__all__ = ["Form", "may_take_primal", "prefers_primal", "takes_primal"]

Array = npt.NDArray[np.float64]

#: Options of the dual form's Krylov method that ask for the dual form.
ASKED = ("type", "rtol", "atol")


class Form(Protocol):
    """The method, set up for one matrix."""

    formulation: str  # dual or primal

    @property
    def pattern(self) -> Pattern:
        """What depends on the pattern."""

    @property
    def operator(self) -> Operator:
        """S, and K_II⁻¹, of the matrix."""

    @property
    def modes(self) -> tuple[SubdomainModes, ...]:
        """R, E and D of each subdomain, of the matrix that the preconditioner belongs to."""

    @property
    def delta(self) -> Array:
        """Weight δ of every torn dof, (n,)."""

    @property
    def coarse(self) -> Coarse | AveragedSpace:
        """The coarse problem."""

    @property
    def inertia(self) -> Inertia:
        """Negative eigenvalues."""

    @property
    def solves_indefinite(self) -> bool:
        """Whether it solves with an indefinite matrix."""

    @property
    def method(self) -> str:
        """PETSc's name of the Krylov method."""

    @property
    def users_test(self) -> bool:
        """Whether the user's own tolerance of the Krylov method decides."""

    def solve(
        self,
        r: PETSc.Vec,
        u_D: Array,
        *,
        target: float,
        max_it: int,
        monitor: Monitor,
        saddles: bool = True,
    ) -> tuple[Array, Solution]:
        """Solve for an assembled right-hand side, (N,), and prescribed values, (n,). Collective.

        Without ``saddles`` a solve with a matrix that is proved to be indefinite is in vain.
        """

    def memory(self) -> float:
        """Return the memory of all factors of this process in MiB."""

    def destroy(self) -> None:
        """Free everything but the pattern."""


def may_take_primal(pattern: Pattern) -> bool:
    """Tell whether the options allow the primal form."""
    choice = pattern.options.formulation
    if choice != "auto":
        return choice == "primal"
    asked = any(PETSc.Options(pattern.prefix + "dual_").hasName(f"ksp_{key}") for key in ASKED)
    return pattern.options.pc_type == "dirichlet" and not asked


def prefers_primal(pattern: Pattern) -> bool:
    """Tell whether a symmetric matrix takes the primal form unless a K_ρ is indefinite."""
    condensed = pattern.torn.pressures is not None
    return may_take_primal(pattern) and (condensed or pattern.options.formulation == "primal")


def takes_primal(pattern: Pattern, inertia: Inertia) -> bool:
    """Tell whether a symmetric matrix is solved in the primal form."""
    if pattern.options.formulation != "auto":
        return may_take_primal(pattern)
    safe = inertia.local == 0 and may_take_primal(pattern)
    return safe and (not inertia.definite or prefers_primal(pattern))
