# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Colours: a scale for fields, and fixed ones for subdomains, tissue and fibres."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dolfinx_feti.runtime.arrays import Array, Numbers

__all__ = ["FIBRES", "TISSUE", "ColourScale", "subdomain_colours"]

#: Colour map of matplotlib for subdomains: twelve light colours, so that shading shows the shape.
SUBDOMAIN_MAP = "Set3"

#: Colours of the families of fibres; a fourth family has the first colour again.
FIBRES = ("#16325c", "#b5443a", "#2f7d4f")

#: Colour of the surface below fibres.
TISSUE = "#f3e3d3"


@dataclass(frozen=True, slots=True)
class ColourScale:
    """The colours of all fields of a picture.

    Attributes:
        name: Name of a colour map of matplotlib.
        ranges: Values at the ends of the colour scale for each label.
    """

    name: str
    ranges: Mapping[str, tuple[float, float]]

    def colours_of(self, values: Array, label: str) -> npt.NDArray[np.uint8]:
        """Return the colours of the values of a field as red, green and blue up to 255, (n, 3).

        Args:
            values: Values of the field, (n,).
            label: Its label.
        """
        from matplotlib import colormaps

        low, high = self.ranges[label]
        if high > low:
            shares = np.clip((values - low) / (high - low), 0.0, 1.0)
        else:
            shares = np.full_like(values, 0.5)
        return np.asarray(colormaps[self.name](shares, bytes=True), dtype=np.uint8)[:, :3]


def subdomain_colours(numbers: Numbers) -> npt.NDArray[np.uint8]:
    """Return the colour of each subdomain as red, green and blue up to 255, (n, 3).

    Args:
        numbers: Numbers of subdomains, (n,).
    """
    from matplotlib import colormaps

    palette = colormaps[SUBDOMAIN_MAP]
    colours = palette(numbers % palette.N, bytes=True)
    return np.asarray(colours, dtype=np.uint8)[:, :3]
