# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""How a wall is held: with clamped rims, or as a quarter of a tube that remains one.

The ends of the quarter slide in their planes, u_z = 0, and so do its planes of symmetry, u_x = 0
and u_y = 0.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

import dolfinx

from dolfinx_feti.wall import Wall, facets, openings

__all__ = ["Hold", "clamp_openings", "slide"]

Hold = Callable[[Wall, dolfinx.fem.FunctionSpace], list[dolfinx.fem.DirichletBC]]

#: Surfaces of a quarter, and the component that is held there.
PLANES = {"opening_1": 2, "opening_2": 2, "symmetry_x": 0, "symmetry_y": 1}


def clamp_openings(wall: Wall, V: dolfinx.fem.FunctionSpace) -> list[dolfinx.fem.DirichletBC]:
    """Hold the rims of all openings."""
    rims = np.concatenate([facets(wall, name) for name in openings(wall)])
    dofs = dolfinx.fem.locate_dofs_topological(V, 2, rims)
    return [dolfinx.fem.dirichletbc(np.zeros(3), dofs, V)]


def slide(wall: Wall, V: dolfinx.fem.FunctionSpace) -> list[dolfinx.fem.DirichletBC]:
    """Let the ends of a quarter of a tube slide, and its planes of symmetry."""
    bcs = []
    for name, component in PLANES.items():
        part = V.sub(component)
        dofs = dolfinx.fem.locate_dofs_topological(part, 2, facets(wall, name))
        bcs.append(dolfinx.fem.dirichletbc(0.0, dofs, part))
    return bcs
