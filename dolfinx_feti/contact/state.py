# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Updates of a contact's multiplier and penalty, and how far it is from convergence."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from mpi4py import MPI

import numpy as np

from dolfinx_feti.contact.evaluation import ContactEvaluation
from dolfinx_feti.contact.stiffness import stiffness_quantile
from dolfinx_feti.contact.traces import Traces
from dolfinx_feti.runtime.arrays import Array

__all__ = ["ContactState"]

#: ε over the stiffness per area of the body at its surface. At half of this value, updates converge
#: half as fast. At twice, the condition number of the assembled tangent doubles.
PENALTY = 10.0

#: Quantile of the stiffness over the facets that determines ε. One ε for the whole surface
#: reproduces a uniform pressure exactly. The quantile ignores a few slivers. In a graded mesh most
#: facets are the small ones at the contact. At 0.45 updates are slow in the stiffer half of a body
#: of two materials. At 1 a single sliver determines ε.
QUANTILE = 0.9

#: A multiplier, in the unit of λ, with which no point is in contact: λ − ε g is negative at any
#: penetration. The energy Π_c is meaningless with it.
RELEASED_MULTIPLIER = -1e100


class ContactState:
    """λ and ε of a contact, which a problem updates from solve to solve."""

    def __init__(self, evaluation: ContactEvaluation, traces: Traces) -> None:
        """Store the parts of the contact; the law's λ and ε are changed in place.

        Args:
            evaluation: Values at the points of the surface.
            traces: Basis functions of the displacement there.
        """
        self._evaluation = evaluation
        self._traces = traces
        self._surface = evaluation.surface
        self._comm: MPI.Comm = evaluation.surface.mesh.comm
        self._λ = evaluation.law.multiplier.x
        self._ε = evaluation.law.penalty.x

    # -- the penalty ------------------------------------------------------------------------------

    def has_penalty(self) -> bool:
        """Return True if ε has been set. Collective."""
        return bool(self._comm.allreduce(bool(self._ε.array.any()), op=MPI.LOR))

    def set_penalty(self, diagonal: Array) -> None:
        """Compute ε from the stiffness at the surface; a larger ε is not changed. Collective.

        Args:
            diagonal: Diagonal of the assembled tangent without contact, (owned dofs,) of u.
        """
        V = self._evaluation.law.u.function_space
        stiffness = stiffness_quantile(self._surface, V, diagonal, QUANTILE)
        np.maximum(self._ε.array, PENALTY * stiffness, out=self._ε.array)

    def grow_penalty(self, factor: float) -> None:
        """Multiply ε by a factor. Not collective."""
        self._ε.array[:] *= factor

    @contextmanager
    def without_tool(self) -> Iterator[None]:
        """Context in which no point is in contact; assemble no energy in it. Not collective."""
        before = self._λ.array.copy()
        self._λ.array[:] = RELEASED_MULTIPLIER
        try:
            yield
        finally:
            self._λ.array[:] = before

    # -- the multiplier ---------------------------------------------------------------------------

    def violation(self) -> float:
        """Return the largest abs(⟨λ − ε g⟩₊ − λ)/(ε h), with the size h of a cell. Collective.

        This is abs(g)/h for a point in contact, and λ/(ε h) for a point without contact whose
        multiplier still pushes.
        """
        values = self._evaluation
        lengths = np.abs(values.pressure() - values.multiplier()) / values.penalty()
        return max(self._surface.maximum(lengths / self._surface.cell_sizes), 0.0)

    def force_change(self) -> float:
        """Return the relative change of the forces on nodes by the next update. Collective.

        It is the norm of the nodes' forces of p − λ over that of p.
        """
        p = self._evaluation.pressure()
        forces = self._traces.nodal_forces(p)
        changes = self._traces.nodal_forces(p - self._evaluation.multiplier())
        change, size = self._comm.allreduce(np.array([changes @ changes, forces @ forces]))
        return float(np.sqrt(change / size)) if size > 0.0 else 0.0

    def update_multiplier(self) -> None:
        """Set λ to ⟨λ − ε g⟩₊. Collective."""
        self._set_multiplier(self._evaluation.pressure())

    def fit_multiplier(self) -> None:
        """Replace λ by its fit by traces of u, and negative values by zero. Collective.

        The fit leaves the forces on nodes as they are. The part of λ without forces would grow from
        step to step as a contact spreads; negative values come from extrapolation.
        """
        self._set_multiplier(self._traces.fit(self._evaluation.multiplier()))

    def _set_multiplier(self, values: Array) -> None:
        """Set λ to values at the points, (points,). Collective."""
        self._λ.array[self._surface.dofs] = values
        self._λ.scatter_forward()
