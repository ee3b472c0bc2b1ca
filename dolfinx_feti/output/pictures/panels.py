# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Panels: the surface of a body with a field, with subdomains, or with fibres."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import dolfinx
import ufl
from ufl.core.expr import Expr

from dolfinx_feti.fem.decomposition import Decomposition
from dolfinx_feti.output.evaluation import mesh_of
from dolfinx_feti.output.pictures.colours import FIBRES, TISSUE, ColourScale, subdomain_colours
from dolfinx_feti.output.pictures.fibre_lines import fibre_lines
from dolfinx_feti.output.pictures.pyvista_import import import_pyvista, require_pyvista
from dolfinx_feti.output.surfaces import BodySurface, gather_surface
from dolfinx_feti.problems.torn_problem import TornProblem
from dolfinx_feti.runtime.arrays import Array, Integers, Mask
from dolfinx_feti.wall.wall import Wall

__all__ = ["FibrePanel", "FieldPanel", "Panel", "SubdomainPanel", "fibres", "field", "subdomains"]

#: Angle between facets above which the surface has an edge [degrees]; below, it is shaded smoothly.
EDGE_ANGLE = 40.0

#: Radius of the tubes that show fibres, over the extent of the body.
FIBRE_RADIUS = 0.0035

#: Sides of the tubes in a scene. With the 8 sides and all 17 points of a picture, the fibres of a
#: tube of 3 mm make a file of 30 MB.
SCENE_SIDES = 3

#: Every fourth point of a fibre is used in a scene, for the same reason.
SCENE_STRIDE = 4


@dataclass(frozen=True, slots=True)
class Panel(ABC):
    """A body to be drawn.

    Attributes:
        comm: The processes that have created it.
        surface: Its surface on the first process; None on others.
        title: Text above it.
        label: Text of its colour bar, which panels with the same text share; empty without a bar.
    """

    comm: MPI.Comm
    surface: BodySurface | None
    title: str
    label: str

    def mesh(self) -> Any:
        """Return the surface as ``pyvista.PolyData`` on the first process; None on others.

        Its points have the data ``values``, its cells the data ``part``.
        """
        if self.surface is None:
            return None
        pyvista = import_pyvista()
        mesh = pyvista.PolyData.from_regular_faces(self.surface.points, self.surface.triangles)
        mesh.point_data["values"] = self.surface.values
        mesh.cell_data["part"] = self.surface.part
        return mesh

    @abstractmethod
    def add_to(self, plotter: Any, scale: ColourScale) -> None:
        """Add the body to a scene of PyVista, on the first process.

        Args:
            plotter: The scene, ``pyvista.Plotter``.
            scale: The colours of fields.
        """

    @abstractmethod
    def coloured_meshes(self, scale: ColourScale) -> list[Any]:
        """Return the triangles of a scene in a browser, on the first process.

        Args:
            scale: The colours of fields.

        Returns:
            ``pyvista.PolyData``, each with ``colour``, (n, 3), red, green and blue up to 255, and,
            if the body is not plane, ``Normals``, (n, 3), at its points.
        """

    def surface_here(self) -> BodySurface:
        """Return the surface on the first process.

        Raises:
            RuntimeError: This is another process.
        """
        if self.surface is None:
            raise RuntimeError("A panel has its surface on the first process only.")
        return self.surface

    def _shaded_mesh(self) -> Any:
        """Return the mesh, with normals for shading if the body is not plane."""
        mesh = self.mesh()
        if self.surface_here().is_plane:
            return mesh
        return mesh.compute_normals(
            cell_normals=False,
            split_vertices=True,
            feature_angle=EDGE_ANGLE,
            consistent_normals=False,
        )

    def _shading(self) -> dict[str, Any]:
        """Return the options of ``Plotter.add_mesh`` for light and shade."""
        if self.surface_here().is_plane:
            return {"lighting": False}
        return {"smooth_shading": True, "ambient": 0.4, "diffuse": 0.65, "specular": 0.1}


@dataclass(frozen=True, slots=True)
class FieldPanel(Panel):
    """A body coloured by a field."""

    def add_to(self, plotter: Any, scale: ColourScale) -> None:
        """Add the body in the colours of the field."""
        plotter.add_mesh(
            self._shaded_mesh(),
            scalars="values",
            clim=scale.ranges[self.label],
            cmap=scale.name,
            show_scalar_bar=False,
            **self._shading(),
        )

    def coloured_meshes(self, scale: ColourScale) -> list[Any]:
        """Return the body in the colours of the field."""
        mesh = self._shaded_mesh()
        mesh.point_data["colour"] = scale.colours_of(mesh.point_data["values"], self.label)
        return [mesh]


@dataclass(frozen=True, slots=True)
class SubdomainPanel(Panel):
    """The subdomains of a body."""

    def add_to(self, plotter: Any, scale: ColourScale) -> None:
        """Add the subdomains, each in a different colour."""
        mesh = self._shaded_mesh()
        mesh.cell_data["colour"] = subdomain_colours(mesh.cell_data["part"])
        plotter.add_mesh(mesh, scalars="colour", rgb=True, **self._shading())

    def coloured_meshes(self, scale: ColourScale) -> list[Any]:
        """Return the subdomains, each in a different colour; they share no points."""
        mesh = self._shaded_mesh()
        part_of_point = np.zeros(mesh.n_points, dtype=np.int64)
        part_of_point[mesh.regular_faces.ravel()] = np.repeat(mesh.cell_data["part"], 3)
        mesh.point_data["colour"] = subdomain_colours(part_of_point)
        return [mesh]


@dataclass(frozen=True, slots=True)
class FibrePanel(Panel):
    """Fibres on the surface of a body.

    Attributes:
        lines: Points of the fibres of each family, (n, points, 3), on the first process.
    """

    lines: tuple[Array, ...]

    def add_to(self, plotter: Any, scale: ColourScale) -> None:
        """Add the surface, and the fibres as tubes."""
        plotter.add_mesh(self._shaded_mesh(), color=TISSUE, **self._shading())
        for family, lines in enumerate(self.lines):
            tubes = _polylines(lines).tube(radius=self._radius(), n_sides=8)
            plotter.add_mesh(tubes, color=FIBRES[family % len(FIBRES)], smooth_shading=True)

    def coloured_meshes(self, scale: ColourScale) -> list[Any]:
        """Return the surface, and the fibres of each family as tubes of few triangles."""
        surface = self._shaded_mesh()
        surface.point_data["colour"] = _one_colour(TISSUE, surface.n_points)
        meshes = [surface]
        for family, lines in enumerate(self.lines):
            axes = _polylines(lines[:, ::SCENE_STRIDE])
            tubes = axes.tube(radius=self._radius(), n_sides=SCENE_SIDES).triangulate()
            tubes.point_data["Normals"] = tubes.point_data["TubeNormals"]
            tubes.point_data["colour"] = _one_colour(FIBRES[family % len(FIBRES)], tubes.n_points)
            meshes.append(tubes)
        return meshes

    def _radius(self) -> float:
        """Return the radius of the tubes."""
        extent = float(np.ptp(self.surface_here().points, axis=0).max())
        return FIBRE_RADIUS * extent


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
        expression: A Function or UFL expression. The norm of a vector or tensor is drawn.
        label: Name and unit for the colour bar.
        displacement: Displacement of the points, such as u or 10 * u; None for the body at rest.
        title: Text above the body.
        cells: Local numbers of the cells that are drawn, such as those of a layer,
            ``wall.cell_tags.find(wall.layers["media"])``; by default all.
        is_continuous: Whether the field is averaged over adjacent cells; if not, its jumps are
            visible.

    Raises:
        ImportError: PyVista is not installed.
        ValueError: The expression is a number, which lives on no mesh.
    """
    require_pyvista()
    mesh = mesh_of(expression)
    if expression.ufl_shape:
        expression = ufl.sqrt(ufl.inner(expression, expression))
    mask = None if cells is None else _mask(mesh, cells)
    surface = gather_surface(mesh, expression, displacement, mask=mask, is_continuous=is_continuous)
    return FieldPanel(mesh.comm, surface, title, label)


def subdomains(
    problem: TornProblem, *, displacement: Expr | None = None, apart: float = 0.12, title: str = ""
) -> Panel:
    """Return a panel with the subdomains of a problem, pulled apart. Collective.

    Args:
        problem: The problem.
        displacement: Displacement of the points; None for the body at rest.
        apart: Shift of each subdomain away from the middle of the body, over the distance of its
            centre from there.
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
    return SubdomainPanel(mesh.comm, surface, title, label="")


def fibres(wall: Wall, families: Sequence[Expr], layer: str, *, title: str = "") -> Panel:
    """Return a panel with the fibres on the surface of a layer at rest. Collective.

    Args:
        wall: The wall.
        families: Directions of the families of fibres, one at least, as ``fibre_families`` returns
            them.
        layer: Name of the layer.
        title: Text above the layer.

    Raises:
        ImportError: PyVista is not installed.
        ValueError: The wall has no such layer, or ``families`` is empty.
    """
    require_pyvista()
    if not families:
        raise ValueError("families is empty: give one direction at least.")
    if layer not in wall.layers:
        raise ValueError(f"The wall has no layer {layer!r}; it has {', '.join(wall.layers)}.")
    mesh = wall.mesh
    mask = _mask(mesh, wall.cell_tags.find(wall.layers[layer]))
    lines = []
    surface = None
    for direction in families:
        surface = gather_surface(mesh, direction, None, mask=mask)
        if surface is not None:
            lines.append(fibre_lines(surface))
    return FibrePanel(mesh.comm, surface, title, label="", lines=tuple(lines))


def _mask(mesh: dolfinx.mesh.Mesh, cells: Integers) -> Mask:
    """Return a mask of the owned cells among cells, (n_cells,)."""
    mask = np.zeros(mesh.topology.index_map(mesh.topology.dim).size_local, dtype=bool)
    mask[cells[cells < len(mask)]] = True
    return mask


def _pulled_apart(surface: BodySurface, apart: float) -> BodySurface:
    """Return the surface with each part moved away from the middle of all."""
    middle = surface.points[surface.triangles].mean(axis=1)  # (t, 3)
    count = np.maximum(np.bincount(surface.part), 1)
    sums = [np.bincount(surface.part, column) for column in middle.T]
    centres = np.stack(sums, axis=1) / count[:, None]
    part_of_point = np.zeros(len(surface.points), dtype=np.int64)
    part_of_point[surface.triangles.ravel()] = np.repeat(surface.part, 3)
    shift = apart * (centres - surface.points.mean(axis=0))
    return replace(surface, points=surface.points + shift[part_of_point])


def _polylines(lines: Array) -> Any:
    """Return lines, (n, points, 3), as ``pyvista.PolyData``."""
    pyvista = import_pyvista()
    n, size, _ = lines.shape
    numbers = np.arange(n * size).reshape(n, size)
    with_sizes = np.column_stack([np.full(n, size), numbers])
    return pyvista.PolyData(lines.reshape(-1, 3), lines=with_sizes.ravel())


def _one_colour(colour: str, n: int) -> npt.NDArray[np.uint8]:
    """Return a colour, written as #rrggbb, for n points, (n, 3)."""
    rgb = np.frombuffer(bytes.fromhex(colour.removeprefix("#")), dtype=np.uint8)
    return np.tile(rgb, (n, 1))
