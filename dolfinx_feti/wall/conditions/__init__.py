# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Conditions on the surfaces of a wall: a class for each kind, and the forms of all of them.

Conditions belong to the name of a surface; surfaces without any are free (docs/conditions.md)::

    {"lumen": Pressure(), "outer": [Spring(1.0), Dashpot(0.1)], "opening_1": Clamp()}

A new kind is a file with a subclass of ``Condition``, like ``pressure``. ``apply_conditions`` takes
its objects as they are. A line in ``registry`` also makes it a key of a case in TOML; ``case``
has rules for ``Pressure`` and ``Dashpot`` only. Public kinds are exported here and by ``wall``.
Units: mm, kPa, s.

In the order of the data: condition, pressure, supports, prescribed, registry, potential,
boundary.
"""

from dolfinx_feti.wall.conditions.boundary import Boundary, apply_conditions
from dolfinx_feti.wall.conditions.condition import Condition, Contribution, SlidingPlane, Surface
from dolfinx_feti.wall.conditions.prescribed import Clamp, Slide
from dolfinx_feti.wall.conditions.pressure import Pressure
from dolfinx_feti.wall.conditions.registry import Conditions, checked_conditions
from dolfinx_feti.wall.conditions.supports import Dashpot, Spring

__all__ = [
    "Boundary",
    "Clamp",
    "Condition",
    "Conditions",
    "Contribution",
    "Dashpot",
    "Pressure",
    "Slide",
    "SlidingPlane",
    "Spring",
    "Surface",
    "apply_conditions",
    "checked_conditions",
]
