# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Arterial walls: meshes with named layers and surfaces, and the directions of their fibres.

In the order of the data: wallfile, wall, laplace, fibres.
"""

from dolfinx_feti.wall.wall import (
    Wall,
    area,
    by_layer,
    facets,
    openings,
    read_wall,
    surface_measure,
)

__all__ = ["Wall", "area", "by_layer", "facets", "openings", "read_wall", "surface_measure"]
