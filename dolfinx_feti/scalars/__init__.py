# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Scalar unknowns coupled to u: equations, cavities with a volume, Windkessels, mean values.

In this room m is the number of scalars, and N the number of dofs that a process owns. A *coupling*
is a kind of scalars: its unknowns, their equations, and what a step of a path changes in them. A
problem has its couplings in ``scalars=``.
``equations`` to ``system`` are the machinery, the other files are kinds of scalars.

In one step of Newton's method, ``system`` assembles the border by ``border_forms``, and
``bordered`` solves with it; ``springs`` support a body that is free to move.

In the order of the data: equations, derivatives, real_spaces, border, border_forms, independence,
springs, bordered, system, constraints, arc_length, cavity, windkessel, couplings.
"""

from dolfinx_feti.scalars.arc_length import ArcLength
from dolfinx_feti.scalars.cavity import Cavity
from dolfinx_feti.scalars.constraints import mean_value, rigid_motions
from dolfinx_feti.scalars.couplings import create_cavities
from dolfinx_feti.scalars.equations import ScalarEquation
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
