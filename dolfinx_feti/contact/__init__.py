# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Contact with rigid tools, frictionless: a balloon, a stent, a clamp, a plate, the spine.

In the order of the data: tools, points, surface, contact.
"""

from dolfinx_feti.contact.contact import Contact
from dolfinx_feti.contact.tools import cylinder, half_space, sphere, torus, union

__all__ = ["Contact", "cylinder", "half_space", "sphere", "torus", "union"]
