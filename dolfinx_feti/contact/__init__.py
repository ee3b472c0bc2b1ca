# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Contact with rigid tools, frictionless: a balloon, a stent, a clamp, a plate, the spine.

A new shape is a function in ``tools``, like ``sphere``, and its name here and in docs/contact.md.

What the law needs:

- ``tools`` has the signed distances, and ``points`` the element of values at quadrature points.
- ``law`` has the forms in u, λ and ε: energy, virtual work and tangent.

What measures and updates a contact:

- ``surface`` has the quadrature points of a surface, and compiles expressions there.
- ``nodes`` exchanges values at nodes; ``stiffness`` and ``traces`` relate points to nodes.
- ``evaluation`` has gap, pressure, normals and force, ``rounding`` the errors of the forces.
- ``state`` updates λ and ε; ``crossing`` detects a surface that has passed through a tool.
- ``surface_fields`` has functions on a mesh of the surface.
- ``contact`` joins the parts for a problem, and has the results for the user.

In the order of the data: tools, points, law, surface, nodes, stiffness, traces, evaluation,
rounding, state, crossing, surface_fields, contact.
"""

from dolfinx_feti.contact.contact import Contact
from dolfinx_feti.contact.tools import cylinder, half_space, sphere, torus, union

__all__ = ["Contact", "cylinder", "half_space", "sphere", "torus", "union"]
