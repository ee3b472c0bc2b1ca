# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Arterial walls: named layers and surfaces, conditions on these, and directions of fibres.

In the order of the data: wall, checks, xdmf, wallfile, conditions, casefile, fibres, opening.
"""

from dolfinx_feti.mechanics.values import type_exports
from dolfinx_feti.wall.casefile import Case, Filling, Tissue, read_case
from dolfinx_feti.wall.conditions import (
    Boundary,
    Clamp,
    Dashpot,
    Pressure,
    Slide,
    Spring,
    apply_conditions,
)
from dolfinx_feti.wall.wall import (
    Wall,
    area,
    by_layer,
    create_wall,
    facets,
    openings,
    surface_measure,
)
from dolfinx_feti.wall.wallfile import read_wall
from dolfinx_feti.wall.xdmf import write_wall

__all__ = [
    "Boundary",
    "Case",
    "Clamp",
    "Dashpot",
    "Filling",
    "Pressure",
    "Slide",
    "Spring",
    "Tissue",
    "Wall",
    "apply_conditions",
    "area",
    "by_layer",
    "create_wall",
    "facets",
    "openings",
    "read_case",
    "read_wall",
    "surface_measure",
    "write_wall",
]

type_exports(globals())
