# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Images of panels, drawn by VTK on the first process."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from dolfinx_feti.output.pictures.colours import ColourScale
from dolfinx_feti.output.pictures.panels import Panel
from dolfinx_feti.output.pictures.pyvista_import import import_pyvista, without_window
from dolfinx_feti.output.pictures.view import View

__all__ = ["Image", "render"]

#: Red, green, blue and opacity of the pixels, up to 255, (height, width, 4).
Image: TypeAlias = npt.NDArray[np.uint8]

#: Size of the window in which a panel is rendered, in pixels. The picture is scaled down to a half
#: of it or less, so that edges are smooth.
WINDOW = (2400, 1800)

#: Distance of the camera from the middle of a body, over half the height of the window: outside of
#: any body. In a parallel projection it does not change the image.
CAMERA_DISTANCE = 10.0


def render(panels: Sequence[Panel], view: View, scale: ColourScale) -> list[Image]:
    """Return the image of each panel, without its transparent margins.

    Args:
        panels: The panels.
        view: The projection of all of them.
        scale: The colours of fields.

    Raises:
        RuntimeError: This machine has neither a display nor a library for drawing without one.
    """
    pyvista = import_pyvista()
    images = []
    with without_window():
        for panel in panels:
            plotter = pyvista.Plotter(off_screen=True, window_size=list(WINDOW))
            panel.add_to(plotter, scale)
            points = panel.surface_here().points
            middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
            camera = middle + CAMERA_DISTANCE * view.half_height * view.viewer
            plotter.camera_position = [camera, middle, view.up]
            plotter.enable_parallel_projection()
            plotter.camera.parallel_scale = view.half_height
            plotter.reset_camera_clipping_range()
            images.append(_cropped(plotter.screenshot(transparent_background=True)))
            plotter.close()
    return images


def _cropped(image: Image) -> Image:
    """Return the part of an image that is not transparent."""
    opaque = image[:, :, 3] > 0
    rows = np.flatnonzero(opaque.any(axis=1))
    columns = np.flatnonzero(opaque.any(axis=0))
    if len(rows) == 0:
        return image
    return image[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
