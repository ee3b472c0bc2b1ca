# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Surfaces inside of a mesh, integrated from one side.

.. math:: \int_Γ k\, u\, v\, ds, \qquad Γ ⊂ Ω,

couples the dofs of Γ alone, as long as it takes values of a continuous u and v, and no gradients.
UFL's dS couples all dofs of the cells on both sides, whatever stands in it.
"""

from __future__ import annotations

import numpy as np

import dolfinx

from dolfinx_feti.runtime.arrays import Indices, Integers


def one_side(mesh: dolfinx.mesh.Mesh, facets: Integers) -> Indices:
    """Return a cell next to each facet, for integrals over surfaces inside of the mesh.

    Example::

        membrane = dolfinx.mesh.locate_entities(mesh, 2, lambda x: np.isclose(x[0], 0.5))
        ds = ufl.Measure("ds", mesh, subdomain_data=[(1, one_side(mesh, membrane))])
        a += k * ufl.inner(u, v) * ds(1)

    A surface needs a number, and so does each of several, boundary included, in one list: to UFL a
    ds without a number is everywhere, also on those with one. Normals point out of the cell.

    Args:
        mesh: The mesh.
        facets: Facets that this process owns or has a copy of, inside or on the boundary.

    Returns:
        Pairs of an owned cell, that of lower number, and the number of the facet in it, one after
        the other, which ``ufl.Measure`` takes; each facet once over all processes.
    """
    tdim = mesh.topology.dim
    mesh.topology.create_connectivity(tdim - 1, tdim)
    mesh.topology.create_connectivity(tdim, tdim - 1)
    cells = mesh.topology.connectivity(tdim - 1, tdim)
    of_cell = mesh.topology.connectivity(tdim, tdim - 1)
    owned = np.unique(facets[facets < mesh.topology.index_map(tdim - 1).size_local])
    ends = cells.offsets[owned], cells.offsets[owned + 1] - 1  # one cell, or two
    cell = np.minimum(*(cells.array[end] for end in ends))  # ghosts have the higher numbers
    table = of_cell.array.reshape(-1, of_cell.offsets[1]) if len(owned) else np.zeros((0, 1))
    local = np.argmax(table[cell] == owned[:, None], axis=1)
    return np.column_stack([cell, local]).astype(np.int32).ravel()
