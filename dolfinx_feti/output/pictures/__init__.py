# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Pictures of bodies by PyVista, without a window: fields, subdomains and fibres on the surface.

A *panel* shows one body. It is created by all processes and drawn by the first one::

    from dolfinx_feti.output import pictures

    pictures.draw(
        "wall.png",
        pictures.subdomains(problem, title="64 subdomains"),
        pictures.field(stress, "stress [kPa]", displacement=u),
    )

The background is transparent, and margins are cropped. A notebook shows the picture if it is the
last value of a cell. ``panel.mesh()`` is a PyVista mesh, for scenes of any kind.

VTK draws an image of each panel (``panels``, ``view``, ``rendering``), and matplotlib puts these
side by side, with titles and colour bars (``composition``). A new kind of panel is a subclass of
``Panel`` with ``add_to``, for pictures, and ``coloured_meshes``, for scenes, and a function like
``fibres`` that creates it.

In the order of the data: pyvista_import, fibre_lines, colours, panels, view, rendering,
composition, drawing.
"""

from dolfinx_feti.output.pictures.drawing import Picture, draw
from dolfinx_feti.output.pictures.panels import Panel, fibres, field, subdomains
from dolfinx_feti.output.pictures.pyvista_import import require_pyvista

__all__ = ["Panel", "Picture", "draw", "fibres", "field", "require_pyvista", "subdomains"]
