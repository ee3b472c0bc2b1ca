# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The state of a problem: the values of its unknowns, which the user's Functions store."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from mpi4py import MPI

import numpy as np

import dolfinx

from dolfinx_feti.fem.condensation.condensation import Condensation
from dolfinx_feti.problems.unknowns.mixed_of_one import MixedOfOne
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.scalars.system import ScalarSystem


class StateValues(NamedTuple):
    """Values of all unknowns, or increments of them."""

    u: Array  # (owned,)
    p: Array  # dofs of all condensed fields with ghosts, one field after the other
    s: Array  # scalars, (scalars,), the same on all processes

    def moved(self, alpha: float, step: StateValues) -> StateValues:
        """Return U + α ΔU."""
        u, p, s = (a + alpha * b for a, b in zip(self, step, strict=True))
        return StateValues(u, p, s)


class State:
    """The unknowns u, p and s, and what ``before_assembly`` derives from them.

    Attributes:
        u: The unknown that is torn.
        condensation: Condensed fields; None without any.
        scalars: Scalar unknowns.
        mixed: The user's unknown with a mixed element of one, if u is its only part.
    """

    def __init__(
        self,
        u: dolfinx.fem.Function,
        condensation: Condensation | None,
        scalars: ScalarSystem,
        *,
        mixed: MixedOfOne | None,
        before_assembly: Callable[[], object] | None,
    ) -> None:
        """Collect the unknowns; their values stay as they are.

        Args:
            u: The unknown that is torn.
            condensation: Condensed fields; None without any.
            scalars: Scalar unknowns.
            mixed: The user's unknown with a mixed element of one, if u is its only part.
            before_assembly: Updates the coefficients of the forms from the present values; None if
                they do not depend on them.
        """
        dofmap = u.function_space.dofmap
        self.u = u
        self.condensation = condensation
        self.scalars = scalars
        self.mixed = mixed
        self._comm: MPI.Comm = u.function_space.mesh.comm
        self._owned = dofmap.index_map.size_local * dofmap.index_map_bs
        self._before_assembly = before_assembly
        self._is_before_assembly_called = False  # at this state

    @property
    def owned_u(self) -> Array:
        """View of the owned entries of u, (owned,)."""
        return self.u.x.array[: self._owned]

    def values(self) -> StateValues:
        """Return a copy of the values.

        For a mixed element of one, u is first set to the values of the user's Function.
        """
        self._copy_from_mixed()
        p = self.condensation.values() if self.condensation else np.zeros(0)
        return StateValues(self.owned_u.copy(), p, self.scalars.values())

    def set(self, values: StateValues) -> None:
        """Set the values, ghosts included. Collective."""
        self._is_before_assembly_called = False
        self.owned_u[:] = values.u
        self.u.x.scatter_forward()
        if self.mixed is not None:
            self.mixed.write()
        if self.condensation:
            self.condensation.set_values(values.p)
            for field in self.condensation.fields:
                field.x.scatter_forward()
        self.scalars.set_values(values.s)

    def call_before_assembly(self) -> None:
        """Call ``before_assembly`` at the present state. Collective.

        Use it where the user may have changed the Functions since the last call.
        """
        self._copy_from_mixed()
        if self._before_assembly is not None:
            on_all(self._before_assembly, self._comm)
        self._is_before_assembly_called = True

    def call_before_assembly_once(self) -> None:
        """Call ``before_assembly`` unless it was called since the last :meth:`set`. Collective.

        Use it within a Newton step, where only :meth:`set` changes the state.
        """
        if not self._is_before_assembly_called:
            self.call_before_assembly()

    def _copy_from_mixed(self) -> None:
        """Copy the user's unknown with a mixed element of one into u."""
        if self.mixed is not None:
            self.mixed.read()
