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

The background is transparent, and the frame ends where the panels end. At the end of a cell of a
notebook, the picture is shown there. ``panel.mesh()`` is a PyVista mesh, for scenes of any kind.
"""

from __future__ import annotations

import ctypes.util
import importlib
import importlib.util
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import scipy.spatial

import dolfinx
import ufl
from ufl.core.expr import Expr

from dolfinx_feti.fem.decomposition import Decomposition
from dolfinx_feti.output.surfaces import Surface, gather_surface
from dolfinx_feti.problems.torn_problem import TornProblem
from dolfinx_feti.runtime.arrays import Array, Integers, Mask
from dolfinx_feti.runtime.collective import on_root
from dolfinx_feti.wall.wall import Wall

__all__ = ["Panel", "Picture", "draw", "fibres", "field", "require_pyvista", "subdomains"]

#: Direction from a body to the viewer: from the right, in front and above.
VIEWER = np.array([0.40, -0.85, 0.34])

#: Longest over second longest extent of a body from which on it is turned to lie on its side.
ELONGATED = 1.3

#: Cosine of the angle to a coordinate axis below which a body is drawn along this axis: 20 degrees.
ALONG_AXIS = 0.94

#: Angle between facets above which the surface has an edge [degrees]; below, it is shaded smoothly.
EDGE_ANGLE = 40.0

#: Size of the window in which a panel is rendered, in pixels. The picture is scaled down to
#: WIDTH × DPI, so that edges are smooth.
WINDOW = (2400, 1800)

#: Largest width and height of a picture in inches, and pixels per inch: 1200 pixels wide, with text
#: that is legible at half of that.
WIDTH = 6.0
HEIGHT = 4.5
DPI = 200

#: Sizes of texts in points, and of the parts of a figure in inches.
FONT = 11.0
TITLE = 0.34
BAR = 0.62
MIN_BAR = 2.4
GAP = 0.12

#: Percentiles of a field at the ends of its colours: corners with singular stresses are cut off.
PERCENTILES = (1.0, 99.0)

#: Colours of subdomains: light ones, so that shading shows the shape.
SUBDOMAINS = (
    "#8dd3c7",
    "#ffffb3",
    "#bebada",
    "#fb8072",
    "#80b1d3",
    "#fdb462",
    "#b3de69",
    "#fccde5",
    "#d9d9d9",
    "#bc80bd",
    "#ccebc5",
    "#ffed6f",
)

#: Colours of the families of fibres, and of the surface below them.
FIBRES = ("#16325c", "#b5443a", "#2f7d4f")
TISSUE = "#f3e3d3"

#: Length, distance and radius of fibres over the extent of the body, and the points of a fibre.
FIBRE_LENGTH = 0.1
FIBRE_DISTANCE = 0.055
FIBRE_RADIUS = 0.0035
FIBRE_POINTS = 17

#: Distance from the nearest point of the surface, over the edge of a triangle, from which on a line
#: has left the surface. In the middle of an equilateral triangle it is 0.58.
RIM = 0.8


@dataclass(frozen=True, slots=True)
class Panel:
    """A body to be drawn.

    Attributes:
        comm: The processes that have created it.
        surface: Its surface on the first process; None on others.
        title: Text above it.
        label: Text of the colour bar; panels with the same one share it. Empty without a bar.
        lines: Points of the fibres of each family, (n, points, 3).
    """

    comm: MPI.Comm
    surface: Surface | None
    title: str = ""
    label: str = ""
    lines: tuple[Array, ...] = ()

    def mesh(self) -> Any:
        """Return the surface as ``pyvista.PolyData`` on the first process; None on others.

        Its points have the data ``values``, its cells the data ``part``.
        """
        if self.surface is None:
            return None
        pyvista = _pyvista()
        mesh = pyvista.PolyData.from_regular_faces(self.surface.points, self.surface.triangles)
        mesh.point_data["values"] = self.surface.values
        mesh.cell_data["part"] = self.surface.part
        return mesh


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture in a file, which notebooks show.

    Attributes:
        path: The file.
    """

    path: Path

    def _repr_png_(self) -> bytes:
        """Return the file's content, for notebooks."""
        return self.path.read_bytes()


def field(
    expression: Expr,
    label: str,
    *,
    displacement: Expr | None = None,
    title: str = "",
    cells: Integers | None = None,
    is_continuous: bool = True,
) -> Panel:
    """Return a panel with a body coloured by a field. Collective.

    Args:
        expression: A Function or UFL expression: a scalar, or a vector, of which the length counts.
        label: Name and unit for the colour bar.
        displacement: Displacement of the points, such as u or 10 * u; None for the body at rest.
        title: Text above the body.
        cells: Local numbers of the cells to be drawn, such as those of a layer,
            ``wall.cell_tags.find(wall.layers["media"])``; all if None.
        is_continuous: Whether the field is drawn without jumps between cells, by mean values.

    Raises:
        ImportError: PyVista is not installed.
        ValueError: The expression is a number, which lives on no mesh.
    """
    require_pyvista()
    mesh = _mesh_of(expression)
    if expression.ufl_shape:
        expression = ufl.sqrt(ufl.inner(expression, expression))
    mask = None if cells is None else _mask(mesh, cells)
    surface = gather_surface(mesh, expression, displacement, mask=mask, is_continuous=is_continuous)
    return Panel(mesh.comm, surface, title, label)


def subdomains(
    problem: TornProblem, *, displacement: Expr | None = None, apart: float = 0.12, title: str = ""
) -> Panel:
    """Return a panel with the subdomains of a problem, pulled apart. Collective.

    Args:
        problem: The problem.
        displacement: Displacement of the points; None for the body at rest.
        apart: How far the centre of each subdomain moves away from the middle of the body, as a
            share of their distance.
        title: Text above the body.

    Raises:
        ImportError: PyVista is not installed.
    """
    require_pyvista()
    decomposition: Decomposition = problem.decomposition
    mesh = decomposition.mesh
    part = decomposition.first + decomposition.subdomain
    surface = gather_surface(mesh, None, displacement, part=part)
    if surface is not None:
        surface = _pulled_apart(surface, apart)
    return Panel(mesh.comm, surface, title)


def fibres(wall: Wall, families: Sequence[Expr], layer: str, *, title: str = "") -> Panel:
    """Return a panel with the fibres on the surface of a layer at rest. Collective.

    Args:
        wall: The wall.
        families: Direction of each family of fibres, as ``fibre_families`` returns them.
        layer: Name of the layer.
        title: Text above the layer.

    Raises:
        ImportError: PyVista is not installed.
        ValueError: The wall has no such layer.
    """
    require_pyvista()
    if layer not in wall.layers:
        raise ValueError(f"The wall has no layer {layer!r}; it has {', '.join(wall.layers)}.")
    mesh = wall.mesh
    mask = _mask(mesh, wall.cell_tags.find(wall.layers[layer]))
    lines = []
    surface = None
    for direction in families:
        surface = gather_surface(mesh, direction, None, mask=mask)
        if surface is not None:
            lines.append(_fibre_lines(surface))
    return Panel(mesh.comm, surface, title, lines=tuple(lines))


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
        viewer: Direction from the body to the viewer; from the right, in front and above if None.
        limits: Values at the ends of the colours; the percentiles 1 and 99 of a field if None.
        colours: Name of a colour map of matplotlib.
        dark: Whether texts are light, for a dark background.

    Returns:
        The picture, which a notebook shows at the end of a cell.

    Raises:
        ValueError: There is no panel.
        RuntimeError: This machine has neither a display nor a library for drawing without one.
        OSError: The file cannot be written. All errors are raised on all processes.
    """
    if not panels:
        raise ValueError("There is nothing to draw: give a panel, such as field(u, 'u [mm]').")
    path = Path(path)

    def work() -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        view = _view([_surface(panel) for panel in panels], viewer)
        ranges = _colour_ranges(panels, limits)
        images = _rendered(panels, view, ranges, colours)
        _compose(path, panels, images, ranges, colours, dark=dark)

    on_root(work, panels[0].comm)
    return Picture(path)


# ---- bodies ------------------------------------------------------------------------------------


def require_pyvista() -> None:
    """Raise an ImportError if PyVista is not installed."""
    if importlib.util.find_spec("pyvista") is None:
        raise ImportError(
            'Pictures need PyVista: pip install "pyvista>=0.46" matplotlib, or '
            "conda install -c conda-forge pyvista matplotlib."
        )


def _pyvista() -> Any:
    """Return the module ``pyvista``, which takes a second to import: on the first process alone."""
    return importlib.import_module("pyvista")


def _mesh_of(expression: Expr) -> dolfinx.mesh.Mesh:
    """Return the mesh of an expression.

    Raises:
        ValueError: It has none.
    """
    domain = ufl.domain.extract_unique_domain(expression)
    if domain is None:
        raise ValueError(f"The expression {expression} lives on no mesh: it is a number.")
    return dolfinx.mesh.Mesh(domain.ufl_cargo(), domain)


def _mask(mesh: dolfinx.mesh.Mesh, cells: Integers) -> Mask:
    """Return a mask of the owned cells among cells, (n_cells,)."""
    mask = np.zeros(mesh.topology.index_map(mesh.topology.dim).size_local, dtype=bool)
    mask[cells[cells < len(mask)]] = True
    return mask


def _surface(panel: Panel) -> Surface:
    """Return the surface of a panel on the first process."""
    assert panel.surface is not None
    return panel.surface


def _pulled_apart(surface: Surface, apart: float) -> Surface:
    """Return the surface with each part moved away from the middle of all."""
    middle = surface.points[surface.triangles].mean(axis=1)  # (t, 3)
    count = np.maximum(np.bincount(surface.part), 1)
    sums = [np.bincount(surface.part, column) for column in middle.T]
    centres = np.stack(sums, axis=1) / count[:, None]
    part_of_point = np.zeros(len(surface.points), dtype=np.int64)
    part_of_point[surface.triangles.ravel()] = np.repeat(surface.part, 3)
    shift = apart * (centres - surface.points.mean(axis=0))
    return replace(surface, points=surface.points + shift[part_of_point])


def _fibre_lines(surface: Surface) -> Array:
    """Return lines along a vector field on a surface, (n, points, 3).

    They start at points of the surface in the middle of the line, one in each cube of a grid, and
    take steps along the vector of the nearest point, in the tangential plane of the surface there.
    Lines that leave the surface at a rim are left out.
    """
    extent = float(np.ptp(surface.points, axis=0).max())
    normals = _point_normals(surface)
    grid = np.floor(surface.points / (FIBRE_DISTANCE * extent)).astype(np.int64)
    shuffled = np.random.default_rng(0).permutation(len(grid))
    _, first = np.unique(grid[shuffled], axis=0, return_index=True)
    start = surface.points[shuffled[first]]
    tree = scipy.spatial.cKDTree(surface.points)
    step = FIBRE_LENGTH * extent / (FIBRE_POINTS - 1)
    corners = surface.points[surface.triangles]
    edge = float(np.median(np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)))
    is_inside = np.ones(len(start), dtype=bool)
    halves = []
    for sign in (-1.0, 1.0):
        x = start
        half = [x]
        for _ in range(FIBRE_POINTS // 2):
            _, nearest = tree.query(x)
            n = normals[nearest]
            x = x + sign * step * surface.values[nearest]
            height = np.einsum("ij,ij->i", x - surface.points[nearest], n)
            x = x - height[:, None] * n
            is_inside &= tree.query(x)[0] < RIM * edge
            half.append(x)
        halves.append(half)
    backward, forward = halves
    lines = np.stack([*backward[:0:-1], *forward], axis=1)
    return np.asarray(lines[is_inside])


def _point_normals(surface: Surface) -> Array:
    """Return the unit normal of the surface at each point, (n, 3)."""
    x = surface.points[surface.triangles]
    normal = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    sums = np.zeros_like(surface.points)
    for corner in surface.triangles.T:
        np.add.at(sums, corner, normal)
    length = np.linalg.norm(sums, axis=1, keepdims=True)
    return sums / np.maximum(length, np.finfo(float).tiny)


# ---- view and colours --------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _View:
    """Where the viewer stands.

    Attributes:
        viewer: Direction from the body to the viewer, (3,).
        up: Direction that is upwards in the picture, (3,).
        height: Half the height of the window, in the unit of length.
    """

    viewer: Array
    up: Array
    height: float


def _view(surfaces: Sequence[Surface], viewer: Sequence[float] | None) -> _View:
    """Return the view of all panels, so that the largest body fits into the window."""
    radius = max(float(np.linalg.norm(np.ptp(s.points, axis=0))) / 2.0 for s in surfaces)
    if surfaces[0].is_plane:
        return _View(np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0]), radius)
    axes = _axes(surfaces[0].points)
    direction = VIEWER @ axes if viewer is None else np.asarray(viewer, dtype=np.float64)
    return _View(direction / np.linalg.norm(direction), axes[2], radius)


def _axes(points: Array) -> Array:
    """Return the directions to the right, to the back and upwards, (3, 3).

    A body that is longer than it is wide lies on its side. Otherwise z is upwards.
    """
    x = points - points.mean(axis=0)
    _, lengths, directions = np.linalg.svd(x, full_matrices=False)
    right = directions[0]
    right = right * np.sign(right[np.argmax(np.abs(right))])
    if lengths[0] < ELONGATED * lengths[1]:
        return np.eye(3)
    axis = int(np.argmax(np.abs(right)))
    if abs(right[axis]) > ALONG_AXIS:
        right = np.eye(3)[axis]
    up = directions[1]
    if lengths[1] < ELONGATED * lengths[2]:  # the second axis is arbitrary
        up = np.eye(3)[2 if axis != 2 else 0]
    up = up - (up @ right) * right
    up = up * np.sign(up[np.argmax(np.abs(up))]) / np.linalg.norm(up)
    return np.array([right, np.cross(up, right), up])


def _colour_ranges(
    panels: Sequence[Panel], limits: tuple[float, float] | None
) -> dict[str, tuple[float, float]]:
    """Return the values at the ends of the colours for each label."""
    ranges = {}
    for label in dict.fromkeys(panel.label for panel in panels if panel.label):
        if limits is not None:
            ranges[label] = limits
            continue
        values = [_surface(panel).values for panel in panels if panel.label == label]
        low, high = np.percentile(np.concatenate(values), PERCENTILES)
        ranges[label] = (float(low), float(high))
    return ranges


# ---- rendering ---------------------------------------------------------------------------------


@contextmanager
def _without_window() -> Iterator[None]:
    """Set VTK's window to EGL or OSMesa if there is no display: VTK would try X first and warn.

    Raises:
        RuntimeError: This machine has no library for it.
    """
    name = "VTK_DEFAULT_OPENGL_WINDOW"
    if os.environ.get("DISPLAY") or os.name == "nt" or name in os.environ:
        yield
        return
    if ctypes.util.find_library("EGL"):
        window = "vtkEGLRenderWindow"
    elif ctypes.util.find_library("OSMesa"):
        window = "vtkOSOpenGLRenderWindow"
    else:
        raise RuntimeError(
            "There is no display, and no library to draw without one: apt install libegl1 "
            "libegl-mesa0 libgl1-mesa-dri, or conda install -c conda-forge mesalib."
        )
    os.environ[name] = window
    try:
        yield
    finally:
        del os.environ[name]


def _rendered(
    panels: Sequence[Panel], view: _View, ranges: dict[str, tuple[float, float]], colours: str
) -> list[Any]:
    """Return the image of each panel, cropped, (height, width, 4) with values up to 255."""
    pyvista = _pyvista()
    images = []
    with _without_window():
        for panel in panels:
            plotter = pyvista.Plotter(off_screen=True, window_size=list(WINDOW))
            _add(plotter, panel, ranges, colours)
            points = _surface(panel).points
            middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
            plotter.camera_position = [middle + 10.0 * view.height * view.viewer, middle, view.up]
            plotter.enable_parallel_projection()
            plotter.camera.parallel_scale = view.height
            plotter.reset_camera_clipping_range()
            images.append(_cropped(plotter.screenshot(transparent_background=True)))
            plotter.close()
    return images


def _add(plotter: Any, panel: Panel, ranges: dict[str, tuple[float, float]], colours: str) -> None:
    """Add the surface and the lines of a panel to a scene of PyVista."""
    surface = _surface(panel)
    mesh = panel.mesh()
    shading: dict[str, Any] = {"lighting": False}
    if not surface.is_plane:
        mesh = mesh.compute_normals(
            cell_normals=False,
            split_vertices=True,
            feature_angle=EDGE_ANGLE,
            consistent_normals=False,
        )
        shading = {"smooth_shading": True, "ambient": 0.4, "diffuse": 0.65, "specular": 0.1}
    if panel.label:
        plotter.add_mesh(
            mesh,
            scalars="values",
            clim=ranges[panel.label],
            cmap=colours,
            show_scalar_bar=False,
            **shading,
        )
    elif panel.lines:
        plotter.add_mesh(mesh, color=TISSUE, **shading)
    else:
        pyvista = _pyvista()
        palette = np.array([pyvista.Color(colour).int_rgb for colour in SUBDOMAINS], dtype=np.uint8)
        mesh.cell_data["colour"] = palette[mesh.cell_data["part"] % len(palette)]
        plotter.add_mesh(mesh, scalars="colour", rgb=True, **shading)
    radius = FIBRE_RADIUS * float(np.ptp(surface.points, axis=0).max())
    for lines, colour in zip(panel.lines, FIBRES, strict=False):
        tubes = _polylines(lines).tube(radius=radius, n_sides=8)
        plotter.add_mesh(tubes, color=colour, smooth_shading=True)


def _polylines(lines: Array) -> Any:
    """Return lines, (n, points, 3), as ``pyvista.PolyData``."""
    pyvista = _pyvista()
    n, size, _ = lines.shape
    numbers = np.arange(n * size).reshape(n, size)
    with_sizes = np.column_stack([np.full(n, size), numbers])
    return pyvista.PolyData(lines.reshape(-1, 3), lines=with_sizes.ravel())


def _cropped(image: Any) -> Any:
    """Return the part of an image, (height, width, 4), that is not transparent."""
    opaque = image[:, :, 3] > 0
    rows = np.flatnonzero(opaque.any(axis=1))
    columns = np.flatnonzero(opaque.any(axis=0))
    if len(rows) == 0:
        return image
    return image[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]


def _compose(
    path: Path,
    panels: Sequence[Panel],
    images: Sequence[Any],
    ranges: dict[str, tuple[float, float]],
    colours: str,
    *,
    dark: bool,
) -> None:
    """Write titles, images and colour bars side by side to a file.

    Each title is above its image, and each colour bar below the images that share it.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator, ScalarFormatter

    ink = "#f0f0f0" if dark else "#202020"
    top = TITLE if any(panel.title for panel in panels) else 0.0
    bottom = BAR if ranges else 0.0
    pixels_wide = sum(image.shape[1] for image in images)
    pixels_high = max(image.shape[0] for image in images)
    gaps = GAP * (len(panels) + 1)
    scale = min((WIDTH - gaps) / pixels_wide, (HEIGHT - top - bottom) / pixels_high)
    width = max(scale * pixels_wide + gaps, WIDTH / 2.0)
    height = scale * pixels_high + top + bottom
    figure = Figure(figsize=(width, height), dpi=DPI)
    figure.patch.set_alpha(0.0)
    left = (width - scale * pixels_wide - GAP * (len(panels) - 1)) / 2.0
    spans: dict[str, tuple[float, float]] = {}  # from left to right, of each label
    for panel, image in zip(panels, images, strict=True):
        wide = scale * image.shape[1]
        high = scale * image.shape[0]
        below = bottom + (height - top - bottom - high) / 2.0
        axes = figure.add_axes((left / width, below / height, wide / width, high / height))
        axes.imshow(image, interpolation="antialiased", aspect="auto")
        axes.set_axis_off()
        figure.text(
            (left + wide / 2.0) / width,
            1.0 - 0.45 * TITLE / height,
            panel.title,
            color=ink,
            fontsize=FONT,
            ha="center",
            va="center",
        )
        if panel.label:
            spans[panel.label] = (spans.get(panel.label, (left, left))[0], left + wide)
        left += wide + GAP
    for label, (start, end) in spans.items():
        length = min(max(0.84 * (end - start), MIN_BAR), width - 4.0 * GAP)
        start = (start + end - length) / 2.0
        start = min(max(start, 2.0 * GAP), width - 2.0 * GAP - length)
        axes = figure.add_axes((start / width, 0.72 * BAR / height, length / width, 0.13 / height))
        mappable = ScalarMappable(Normalize(*ranges[label]), colours)
        bar = figure.colorbar(mappable, cax=axes, orientation="horizontal", extend="both")
        bar.locator = MaxNLocator(4)
        formatter = ScalarFormatter(useMathText=True)
        formatter.set_powerlimits((-2, 4))
        bar.formatter = formatter
        bar.update_ticks()
        bar.ax.xaxis.offsetText.set(color=ink, fontsize=FONT - 2)
        bar.set_label(label, fontsize=FONT, color=ink, labelpad=1)
        bar.ax.tick_params(labelsize=FONT - 2, colors=ink)
        outline: Any = bar.outline
        outline.set_edgecolor(ink)
    figure.savefig(path, transparent=True)
