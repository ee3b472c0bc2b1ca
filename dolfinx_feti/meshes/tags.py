# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Names and tags of the layers and surfaces of generated walls."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from dolfinx_feti.runtime.arrays import Numbers

__all__ = ["LAYER_TAGS", "SURFACE_TAGS", "layer_tags", "tags_of"]

#: Tags of the layers of an artery.
LAYER_TAGS = {"media": 1, "adventitia": 2}

#: Tags of surfaces; opening k has 10 + k. There are names for 89 openings; vessels have a few.
SURFACE_TAGS = {"lumen": 3, "outer": 4, "symmetry_x": 5, "symmetry_y": 6}
SURFACE_TAGS |= {f"opening_{k}": 10 + k for k in range(1, 90)}

#: Tag of the innermost layer if its name is not in LAYER_TAGS. For a layer further out, the number
#: of layers inside it is added.
FIRST_OTHER_LAYER = 101


def layer_tags(names: Iterable[str]) -> dict[str, int]:
    """Return the tags of layers, listed from the inside out, by name."""
    return {name: LAYER_TAGS.get(name, FIRST_OTHER_LAYER + i) for i, name in enumerate(names)}


def tags_of(parts: Mapping[str, Numbers], tags: Mapping[str, int]) -> Numbers:
    """Return the tag of each row of all parts, one part after the other.

    Args:
        parts: Cells or facets by the name of their layer or surface, (n_part, vertices).
        tags: Tags by name.
    """
    return np.concatenate([np.full(len(part), tags[name]) for name, part in parts.items()])
