# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The cavities and Windkessels of a case file."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

import dolfinx

from dolfinx_feti.scalars.cavity import Cavity
from dolfinx_feti.scalars.windkessel import Windkessel
from dolfinx_feti.wall.case import Filling
from dolfinx_feti.wall.wall import AXES, Wall, surface_measure

__all__ = ["create_cavities"]


def create_cavities(
    wall: Wall, u: dolfinx.fem.Function, cavities: Mapping[str, Filling]
) -> list[Cavity | Windkessel]:
    """Return the cavities and Windkessels of a case, in its order, for ``scalars=``. Collective.

    Args:
        wall: The wall.
        u: Its displacement [mm].
        cavities: What fills them, by the name of their surface.

    Raises:
        ValueError: The surface of one encloses no volume.
    """
    ds = surface_measure(wall)
    couplings: list[Cavity | Windkessel] = []
    for name, filling in cavities.items():
        axis = None
        if filling.axis is not None:
            axis = np.eye(3)[AXES.index(filling.axis)]
        cavity = Cavity(u, ds(wall.surfaces[name]), filling.volume, axis=axis)
        if filling.windkessel:
            couplings.append(Windkessel(cavity, **filling.windkessel))
        else:
            couplings.append(cavity)
    return couplings
