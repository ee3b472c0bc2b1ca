# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""``draw``: from panels to a PNG file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dolfinx_feti.output.pictures.colours import ColourScale
from dolfinx_feti.output.pictures.composition import write_picture
from dolfinx_feti.output.pictures.panels import Panel
from dolfinx_feti.output.pictures.rendering import render
from dolfinx_feti.output.pictures.view import view_of
from dolfinx_feti.runtime.collective import on_root

__all__ = ["Picture", "colour_ranges", "draw", "require_path_and_panels"]

#: Percentiles of a field at the ends of the colour scale: singular stresses at corners are cut off.
PERCENTILES = (1.0, 99.0)


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture in a file. Notebooks show it.

    Attributes:
        path: The file.
    """

    path: Path

    def _repr_png_(self) -> bytes:
        """Return the file's content, for notebooks."""
        return self.path.read_bytes()


def draw(
    path: Path | str,
    *panels: Panel,
    viewer: Sequence[float] | None = None,
    limits: tuple[float, float] | None = None,
    colours: str = "viridis",
    dark: bool = False,
) -> Picture:
    """Draw panels side by side, all at the same scale, and write a PNG file. Collective.

    Args:
        path: The file; its folder is created.
        panels: The panels.
        viewer: Direction from the body to the viewer; by default from the right, in front and
            above.
        limits: Values at the ends of the colour scale; by default the percentiles 1 and 99 of a
            field.
        colours: Name of a colour map of matplotlib.
        dark: Whether texts are light, for a dark background.

    Returns:
        The picture, which a notebook shows at the end of a cell.

    Raises:
        TypeError: ``path`` is no path, or one of ``panels`` no panel.
        ValueError: There is no panel, or ``viewer`` is zero or not finite; plane bodies are seen
            from above, whatever it is.
        RuntimeError: This machine has neither a display nor a library for drawing without one.
        OSError: The file cannot be written.

    Note:
        All errors are raised on all processes.
    """
    require_path_and_panels(path, panels)
    path = Path(path)

    def draw_here() -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        view = view_of([panel.surface_here() for panel in panels], viewer)
        scale = ColourScale(colours, colour_ranges(panels, limits))
        images = render(panels, view, scale)
        write_picture(path, panels, images, scale, dark=dark)

    on_root(draw_here, panels[0].comm)
    return Picture(path)


def require_path_and_panels(path: object, panels: Sequence[object]) -> None:
    """Check the first arguments of ``draw`` and ``write_scene``.

    Raises:
        TypeError: ``path`` is no path, or one of ``panels`` no panel.
        ValueError: There is no panel.
    """
    if not isinstance(path, (str, Path)):
        raise TypeError(
            f"path is {path!r:.80}: give the name of the file first, and the panels after it."
        )
    for panel in panels:
        if not isinstance(panel, Panel):
            raise TypeError(
                f"{panel!r:.80} is no panel: give the result of field, subdomains or fibres, such "
                "as field(u, 'u [mm]')."
            )
    if not panels:
        raise ValueError("There is nothing to draw: give a panel, such as field(u, 'u [mm]').")


def colour_ranges(
    panels: Sequence[Panel], limits: tuple[float, float] | None
) -> dict[str, tuple[float, float]]:
    """Return the values at the ends of the colours for each label, on the first process.

    Args:
        panels: The panels; those with one label have the same range.
        limits: The values for all labels; by default the percentiles 1 and 99 of each label.
    """
    ranges = {}
    for label in dict.fromkeys(panel.label for panel in panels if panel.label):
        if limits is not None:
            ranges[label] = limits
            continue
        values = [panel.surface_here().values for panel in panels if panel.label == label]
        low, high = np.percentile(np.concatenate(values), PERCENTILES)
        ranges[label] = (float(low), float(high))
    return ranges
