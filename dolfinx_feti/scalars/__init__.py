# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Scalar unknowns beside u: their equations, cavities with a volume, Windkessels, mean values.

In the order of the data: equations, border, arc_length, cavity, windkessel, couplings.
"""

from dolfinx_feti.scalars.arc_length import ArcLength
from dolfinx_feti.scalars.cavity import Cavity
from dolfinx_feti.scalars.couplings import create_cavities
from dolfinx_feti.scalars.equations import ScalarEquation, mean_value, rigid_motions
from dolfinx_feti.scalars.windkessel import Windkessel

__all__ = [
    "ArcLength",
    "Cavity",
    "ScalarEquation",
    "Windkessel",
    "create_cavities",
    "mean_value",
    "rigid_motions",
]
