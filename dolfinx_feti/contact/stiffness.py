# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The stiffness of a body at its surface, per area.

A spring of stiffness s per area on a facet f, spread over the nodes i of the facet, adds about
s A_f to their diagonal entries k_i. The stiffness of the body in the same unit is

.. math:: s_f = \frac{1}{A_f} \sum_{i ∈ f} \frac{k_i}{m_i},

where a node that m_i facets of the surface share contributes to each of them by 1/m_i. Springs of
stiffness s_f per area therefore double the diagonal on average.
"""

from __future__ import annotations

import numpy as np

import dolfinx

from dolfinx_feti.contact.nodes import sum_contributions, with_ghosts
from dolfinx_feti.contact.surface import ContactSurface
from dolfinx_feti.runtime.arrays import Array, Indices

__all__ = ["stiffness_quantile"]


def stiffness_quantile(
    surface: ContactSurface, V: dolfinx.fem.FunctionSpace, diagonal: Array, quantile: float
) -> float:
    """Return a quantile of the stiffness per area, s_f, over all facets. Collective.

    Args:
        surface: The surface.
        V: The space of the displacement.
        diagonal: Diagonal of the assembled tangent, (owned dofs,) of V.
        quantile: The quantile, from 0 (softest facet) to 1 (stiffest).

    Returns:
        The quantile of s_f, in stress per length.
    """
    d = V.dofmap.index_map_bs
    k = with_ghosts(V, np.abs(diagonal).reshape(-1, d).mean(axis=1))
    nodes = _nodes_of_facets(surface, V)
    contributions = np.bincount(nodes.ravel(), minlength=len(k)).astype(np.float64)
    m = with_ghosts(V, sum_contributions(V, contributions))
    share = k / np.maximum(m, 1.0)  # nodes inside the body are on no facet
    stiffness = share[nodes].sum(axis=1) / surface.facet_areas()
    of_all = np.sort(np.concatenate(surface.mesh.comm.allgather(stiffness)))
    return float(of_all[int(quantile * (len(of_all) - 1))])


def _nodes_of_facets(surface: ContactSurface, V: dolfinx.fem.FunctionSpace) -> Indices:
    """Return the local nodes of V on each facet of the surface, (facets, nodes of a facet).

    Nodes on the edges and vertices of a facet are included.
    """
    layout = V.dofmap.dof_layout
    dimension = surface.mesh.topology.dim - 1
    count = len(surface.element.rules)
    closures = np.array([layout.entity_closure_dofs(dimension, f) for f in range(count)])
    cells = surface.facets[:, 0]
    numbers_in_cell = surface.facets[:, 1]
    nodes = np.take_along_axis(V.dofmap.list[cells], closures[numbers_in_cell], axis=1)
    return np.asarray(nodes, dtype=np.int32)
