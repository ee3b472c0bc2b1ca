# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Scenes: HTML files with a body that is turned with the mouse. They need no network.

A scene shows a panel of :mod:`~dolfinx_feti.output.pictures`::

    from dolfinx_feti.output import pictures, scenes

    scenes.write_scene("wall.html", pictures.field(stress, "stress [kPa]", displacement=u))

Any browser with WebGL 2 opens the file. A notebook shows the scene if it is the last value of a
cell. The template is ``scene.html``.
"""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from dolfinx_feti.output.pictures.colours import ColourScale
from dolfinx_feti.output.pictures.drawing import colour_ranges, require_path_and_panels
from dolfinx_feti.output.pictures.panels import Panel
from dolfinx_feti.output.pictures.view import view_of
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_root

__all__ = ["Scene", "write_scene"]

#: Height of a scene in a notebook, in pixels: all of it is visible on a small screen.
HEIGHT = 480

#: Number of colours in the bar; more would be indistinguishable.
BAR_COLOURS = 16


@dataclass(frozen=True, slots=True)
class Scene:
    """A scene in a file. Notebooks show it.

    Attributes:
        path: The file.
    """

    path: Path

    def _repr_html_(self) -> str:
        """Return a frame with the file's content, for notebooks."""
        page = html.escape(self.path.read_text(encoding="utf-8"))
        style = f"border: 0; height: {HEIGHT}px; width: 100%"
        return f'<iframe title="View of a body" srcdoc="{page}" style="{style}"></iframe>'


def write_scene(
    path: Path | str,
    panel: Panel,
    *,
    viewer: Sequence[float] | None = None,
    limits: tuple[float, float] | None = None,
    colours: str = "viridis",
) -> Scene:
    """Write a panel as an HTML file in which the body is turned with the mouse. Collective.

    Example::

        from dolfinx_feti.output import pictures

        write_scene("bent.html", pictures.field(u, "displacement [mm]", displacement=u))

    Args:
        path: The file; its folder is created.
        panel: The panel.
        viewer: Initial direction from the body to the viewer; by default from the right, in front
            and above.
        limits: Values at the ends of the colour scale; by default the percentiles 1 and 99 of the
            field.
        colours: Name of a colour map of matplotlib.

    Returns:
        The scene, which a notebook shows at the end of a cell.

    Raises:
        TypeError: ``path`` is no path, or ``panel`` no panel.
        ValueError: ``viewer`` is zero or not finite; plane bodies are seen from above, whatever it
            is. On all processes.
        OSError: The file cannot be written. On all processes.
    """
    require_path_and_panels(path, [panel])
    path = Path(path)

    def write_here() -> None:
        data = _scene_data(panel, viewer, ColourScale(colours, colour_ranges([panel], limits)))
        text = resources.files(__package__).joinpath("scene.html").read_text(encoding="utf-8")
        # "<\/" is the same as "</" in JSON, and cannot end the script element of the page
        text = text.replace("{{data}}", json.dumps(data).replace("</", "<\\/"))
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")

    on_root(write_here, panel.comm)
    return Scene(path)


def _scene_data(
    panel: Panel, viewer: Sequence[float] | None, scale: ColourScale
) -> dict[str, object]:
    """Return the data that the template reads, on the first process."""
    surface = panel.surface_here()
    view = view_of([surface], viewer)
    right = np.cross(view.up, view.viewer)
    right = right / np.linalg.norm(right)
    up = np.cross(view.viewer, right)
    middle = (surface.points.min(axis=0) + surface.points.max(axis=0)) / 2.0
    data: dict[str, object] = {
        "title": panel.title,
        "label": panel.label,
        "plane": surface.is_plane,
        "view": np.array([right, up, view.viewer]).tolist(),
    }
    if panel.label:
        low, high = scale.ranges[panel.label]
        bar = scale.colours_of(np.linspace(low, high, BAR_COLOURS, dtype=np.float64), panel.label)
        data["low"] = f"{low:.3g}"
        data["high"] = f"{high:.3g}"
        data["colours"] = ["#" + rgb.tobytes().hex() for rgb in bar]
    meshes = panel.coloured_meshes(scale)
    data["bodies"] = [_body(mesh, middle, view.half_height) for mesh in meshes]
    return data


def _body(mesh: Any, middle: Array, unit: float) -> dict[str, str]:
    """Return the arrays of a mesh, encoded for the template.

    Args:
        mesh: Triangles, as ``Panel.coloured_meshes`` returns them.
        middle: Middle of the window, (3,).
        unit: Unit of length of the arrays.
    """
    points = (np.asarray(mesh.points, dtype=np.float64) - middle) / unit
    normals = np.zeros_like(points)
    if "Normals" in mesh.point_data:
        normals = np.asarray(mesh.point_data["Normals"])
    return {
        "points": _encoded(points.astype("<f4")),
        "normals": _encoded(np.rint(127.0 * normals).astype(np.int8)),
        "colours": _encoded(mesh.point_data["colour"]),
        "triangles": _encoded(mesh.regular_faces.astype("<u4")),
    }


def _encoded(values: Any) -> str:
    """Return the bytes of an array as base64 text."""
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode("ascii")
