# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Detection of a surface that has passed through a tool from one state to another."""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI

import numpy as np

import ufl

from dolfinx_feti.contact.evaluation import ContactEvaluation
from dolfinx_feti.runtime.arrays import Array

__all__ = ["CrossingDetection"]

#: Number of states between the stored and the current one at which the tool is evaluated. A tool
#: thinner than 1/32 of the way of a point can be missed. Twice as many states double the time of a
#: check in which ∇g has reversed at some point.
STATES_BETWEEN = 31


@dataclass(frozen=True, slots=True)
class _Position:
    """A position of body and tool.

    Attributes:
        u: Displacement with ghosts.
        constants: Values of the Constants of the tool.
    """

    u: Array
    constants: list[Array]


class CrossingDetection:
    """Detection of points that have crossed the tool since a stored state.

    A point has crossed the tool if ∇g has reversed, and the straight line between the two states
    leads through the tool. If a point slides along a tool, ∇g changes gradually.
    """

    def __init__(self, evaluation: ContactEvaluation) -> None:
        """Store the current state. Collective.

        Args:
            evaluation: Values at the points of the surface.
        """
        self._u = evaluation.law.u
        self._constants = ufl.algorithms.analysis.extract_constants(evaluation.law.gap)
        self._evaluation = evaluation
        self.store_state()

    def store_state(self) -> None:
        """Store the current state of body and tool. Collective."""
        self._stored = self._position()
        self._stored_normals = self._evaluation.normals()

    def has_crossed(self, tolerance: float) -> bool:
        """Return True if a point has crossed the tool since the stored state. Collective.

        Args:
            tolerance: Depth, over the size of a cell, above which the line between the states leads
                through the tool.
        """
        comm = self._evaluation.surface.mesh.comm
        cosines = np.einsum("pi,pi->p", self._stored_normals, self._evaluation.normals())
        has_turned = cosines < 0.0
        if not comm.allreduce(bool(has_turned.any()), op=MPI.LOR):
            return False
        is_deep = self._greatest_depth() > tolerance * self._evaluation.surface.cell_sizes
        return bool(comm.allreduce(bool((has_turned & is_deep).any()), op=MPI.LOR))

    def _greatest_depth(self) -> Array:
        """Return the greatest depth of each point in the tool between the states, (points,).

        Collective. Displacement and Constants are moved during the call, and restored.
        """
        before = self._stored
        now = self._position()
        depth: Array = np.zeros(len(self._stored_normals))
        try:
            for share in np.arange(1, STATES_BETWEEN + 1) / (STATES_BETWEEN + 1):
                between = [
                    (1.0 - share) * a + share * b
                    for a, b in zip(before.constants, now.constants, strict=True)
                ]
                self._move_to(_Position((1.0 - share) * before.u + share * now.u, between))
                depth = np.maximum(depth, -self._evaluation.gap())
        finally:
            self._move_to(now)
        return depth

    def _position(self) -> _Position:
        """Return the current position."""
        constants = [np.array(constant.value) for constant in self._constants]
        return _Position(self._u.x.array.copy(), constants)

    def _move_to(self, position: _Position) -> None:
        """Move body and tool."""
        self._u.x.array[:] = position.u
        for constant, value in zip(self._constants, position.constants, strict=True):
            constant.value = value
