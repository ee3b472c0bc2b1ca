# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Arterial walls: named layers and surfaces, conditions on these, and directions of fibres.

``wall`` is a mesh with ``names``. ``wall_arrays`` is a wall before it is distributed; ``wallfile``
reads one from a file: ``xdmf`` on all processes, ``gmshfile`` and ``meshiofile`` on one, which
share ``reading``. ``checks`` refuses broken meshes. A ``case`` is a wall with materials and
``conditions``; ``casefile`` reads it from one TOML file with the keys of ``casekeys``. ``laplace``
and ``fibres`` compute directions of fibres, and ``opening_angles`` residual stress.

In the order of the data: names, wall, checks, xdmf, wall_arrays, reading, gmshfile, meshiofile,
wallfile, casekeys, conditions, case, casefile, laplace, fibres, opening_angles.
"""

from dolfinx_feti.wall.case import Case, Filling, LayerMaterial
from dolfinx_feti.wall.casefile import read_case
from dolfinx_feti.wall.conditions.boundary import Boundary, apply_conditions
from dolfinx_feti.wall.conditions.condition import Condition, Contribution
from dolfinx_feti.wall.conditions.prescribed import Clamp, Slide
from dolfinx_feti.wall.conditions.pressure import Pressure
from dolfinx_feti.wall.conditions.supports import Dashpot, Spring
from dolfinx_feti.wall.fibres import Frame, fibre_families, fibre_frame
from dolfinx_feti.wall.opening_angles import OpeningAngles
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
    "Condition",
    "Contribution",
    "Dashpot",
    "Filling",
    "Frame",
    "LayerMaterial",
    "OpeningAngles",
    "Pressure",
    "Slide",
    "Spring",
    "Wall",
    "apply_conditions",
    "area",
    "by_layer",
    "create_wall",
    "facets",
    "fibre_families",
    "fibre_frame",
    "openings",
    "read_case",
    "read_wall",
    "surface_measure",
    "write_wall",
]
