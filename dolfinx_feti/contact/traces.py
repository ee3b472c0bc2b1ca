# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Traces of a displacement's basis functions on a surface: forces on nodes, and fits of pressures.

There are more points than nodes, so part of a pressure p has no force on any node. It is removed by
a fit of p by the traces φ_i of the basis functions of u, over the points A where p > 0:

.. math:: \min_w \sum_{q ∈ A} A_q \Bigl(p_q - \sum_i w_i\, φ_i(ξ_q)\Bigr)^2,

with the weighted area A_q of a point, solved by conjugate gradients with Jacobi's preconditioner.
The forces of p on the nodes do not change.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse

import dolfinx

from dolfinx_feti.contact.nodes import sum_contributions, with_ghosts
from dolfinx_feti.contact.surface import ContactSurface
from dolfinx_feti.runtime.arrays import Array

__all__ = ["Traces"]

#: Relative residual of the fit's normal equations: below the tolerances of Newton's method. Each
#: further digit takes about four products with a small matrix.
FIT_RTOL = 1e-10

#: Absolute value of a basis function up to which it counts as zero on a facet. Those of nodes off
#: the facet have rounding errors there. All others exceed 1e-3 at a point.
TRACE_ATOL = 1e-12

#: Largest number of iterations of the fit. Mass matrices take some thirty. Points at the rim of a
#: contact, where the basis functions are small, can take more; the remaining error is there.
MAX_FIT_ITERATIONS = 100


class Traces:
    """The basis functions of a displacement at the points of a surface, Φ."""

    def __init__(self, V: dolfinx.fem.FunctionSpace, surface: ContactSurface) -> None:
        """Tabulate the basis functions.

        Args:
            V: The space of the displacement.
            surface: The surface.
        """
        self._V = V
        self._areas = surface.weighted_areas
        self._Φ = _tabulate(V, surface)

    def nodal_forces(self, values: Array) -> Array:
        """Return ∫ values φ_i dA of the nodes i of u, (owned nodes,). Collective.

        Args:
            values: Values at the points, (points,).
        """
        return self._to_nodes(self._areas * values)

    def fit(self, values: Array) -> Array:
        """Return the fit of positive values by traces of u, zero at other points. Collective.

        Args:
            values: Values at the points, (points,).

        Returns:
            Values of the fit at the points, not negative, (points,).
        """
        active_areas = np.where(values > 0.0, self._areas, 0.0)
        w = self._solve_normal_equations(active_areas, values)
        return np.where(values > 0.0, np.maximum(self._to_points(w), 0.0), 0.0)

    def _solve_normal_equations(self, areas: Array, values: Array) -> Array:
        """Return the w that minimises Σ A_q (p_q − (Φ w)_q)², by conjugate gradients. Collective.

        Args:
            areas: A_q, positive, or zero at points without part in the fit, (points,).
            values: p_q, (points,).

        Returns:
            w, (owned nodes,).
        """
        comm = self._V.mesh.comm
        diagonal = sum_contributions(self._V, self._Φ.power(2).T @ areas)
        inverse = np.divide(1.0, diagonal, out=np.zeros(len(diagonal)), where=diagonal > 0.0)
        r = self._to_nodes(areas * values)
        w = np.zeros(len(r))
        z = inverse * r
        d = z.copy()
        rz = comm.allreduce(float(r @ z))
        first_rz = rz
        for _ in range(MAX_FIT_ITERATIONS):
            if not rz > FIT_RTOL**2 * first_rz:
                break
            Ad = self._to_nodes(areas * self._to_points(d))
            α = rz / comm.allreduce(float(d @ Ad))
            w += α * d
            r -= α * Ad
            z = inverse * r
            rz_before = rz
            rz = comm.allreduce(float(r @ z))
            d = z + rz / rz_before * d
        return w

    def _to_nodes(self, values: Array) -> Array:
        """Return Φᵀ times values at the points, (owned nodes,). Collective."""
        return sum_contributions(self._V, self._Φ.T @ values)

    def _to_points(self, w: Array) -> Array:
        """Return Φ w at the points, (points,), of w at the owned nodes. Collective."""
        return np.asarray(self._Φ @ with_ghosts(self._V, w))


def _tabulate(V: dolfinx.fem.FunctionSpace, surface: ContactSurface) -> scipy.sparse.csr_array:
    """Return the basis functions of the nodes at the points, Φ, (points, local nodes)."""
    scalar, *_ = V.ufl_element().sub_elements
    table = np.concatenate([scalar.tabulate(0, rule)[0] for rule in surface.element.rules])
    table[np.abs(table) < TRACE_ATOL] = 0.0
    values = table[surface.dofs_in_cell]
    nodes = V.dofmap.list[surface.cells]
    rows = np.repeat(np.arange(len(surface.dofs)), nodes.shape[1])
    index_map = V.dofmap.index_map
    shape = (len(surface.dofs), index_map.size_local + index_map.num_ghosts)
    return scipy.sparse.csr_array((values.ravel(), (rows, nodes.ravel())), shape=shape)
