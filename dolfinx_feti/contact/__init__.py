# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Contact with rigid tools, frictionless: a balloon, a stent, a clamp, a plate, the spine.

A new shape is a function in ``tools``, like ``sphere``, and its name here and in docs/contact.md.

- ``tools`` has the signed distances.
- ``points`` has the element, and ``surface`` the values, at the quadrature points of a surface.
- ``evaluation`` has gap, pressure, normals and force of a contact.
- ``crossing`` detects a surface that has passed through a tool.
- ``contact`` has the energy, the updates of λ, and the results for the user.

In the order of the data: tools, points, surface, evaluation, crossing, contact.
"""

from dolfinx_feti.contact.contact import Contact
from dolfinx_feti.contact.tools import cylinder, half_space, sphere, torus, union

__all__ = ["Contact", "cylinder", "half_space", "sphere", "torus", "union"]
