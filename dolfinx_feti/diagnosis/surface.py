# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What a picture of the subdomains shows: cells of a line or plane, boundary facets in space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

import dolfinx

from dolfinx_feti.fem.decomposition import Decomposition
from dolfinx_feti.runtime.collective import join

__all__ = ["Surface", "visible_surface"]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Surface:
    """Polygons, or segments of a line, each of one subdomain. The same on all processes.

    Attributes:
        corners: Points of the corners, in cyclic order, (polygons, corners, dimension of space); a
            line lies in the plane.
        subdomain: Number over all processes, (polygons,).
    """

    corners: Array
    subdomain: npt.NDArray[np.int64]


def visible_surface(decomposition: Decomposition) -> Surface:
    """Gather the polygons of all processes.

    Args:
        decomposition: Subdomain of each owned cell.

    Note:
        Collective.
    """
    mesh = decomposition.mesh
    tdim = mesh.topology.dim
    n_cells = len(decomposition.subdomain)
    polygons: npt.NDArray[np.int32]
    cells: npt.NDArray[np.int32]
    if tdim <= 2:
        polygons = cells = np.arange(n_cells, dtype=np.int32)
    else:
        mesh.topology.create_connectivity(tdim - 1, tdim)
        mesh.topology.create_connectivity(tdim, tdim - 1)
        polygons = dolfinx.mesh.exterior_facet_indices(mesh.topology)
        around = mesh.topology.connectivity(tdim - 1, tdim)
        cells = around.array[around.offsets[polygons]]
        polygons, cells = polygons[cells < n_cells], cells[cells < n_cells]
    nodes = dolfinx.mesh.entities_to_geometry(mesh, min(tdim, 2), polygons)
    nodes = nodes.reshape(len(polygons), -1)
    if nodes.shape[1] == 4:
        nodes = nodes[:, [0, 1, 3, 2]]  # the corners of a quadrilateral, one after the other
    comm = mesh.comm
    corners = mesh.geometry.x[nodes][..., : max(mesh.geometry.dim, 2)]
    subdomain = decomposition.first + decomposition.subdomain[cells].astype(np.int64)
    return Surface(join(corners, comm), join(subdomain, comm))
