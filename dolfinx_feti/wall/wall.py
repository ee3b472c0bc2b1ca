# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A wall: a mesh whose layers and surfaces have names.

Usual names are the layers `media` and `adventitia`, and the surfaces `lumen` (under pressure),
`outer`, `opening_1`, `opening_2`, … (where the vessel was cut), and `symmetry_x` and `symmetry_y`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from mpi4py import MPI

import numpy as np

import dolfinx
import ufl

from dolfinx_feti.runtime.arrays import Array, Indices
from dolfinx_feti.runtime.collective import bounding_box, on_all
from dolfinx_feti.runtime.values import require_finite, require_type
from dolfinx_feti.wall.names import Group, Groups, checked_groups, with_default_names

__all__ = ["Wall", "area", "by_layer", "create_wall", "facets", "openings", "surface_measure"]

#: Names of the axes; an axis number is an index in this text.
AXES = "xyz"

#: First part of the names of openings; a number follows.
OPENING_PREFIX = "opening_"

#: Thickness of a plane surface over the extent of the wall, up to which it is plane. Coordinates
#: that were written in single precision have relative errors of 6e-8.
PLANE_RTOL = 1e-7


@dataclass(frozen=True, slots=True)
class Wall:
    """A wall in millimetres, from ``read_wall``, or from ``create_wall`` of a mesh and its tags."""

    mesh: dolfinx.mesh.Mesh  #: Tetrahedra or hexahedra, distributed
    cell_tags: dolfinx.mesh.MeshTags  #: The layer of each cell
    facet_tags: dolfinx.mesh.MeshTags  #: The surface of each tagged facet
    layers: dict[str, int]  #: The names of the layers and their tags
    surfaces: dict[str, int]  #: The names of the surfaces and their tags

    def __post_init__(self) -> None:
        """Check mesh and tags."""
        require_type(dolfinx.mesh.Mesh, mesh=self.mesh)
        require_type(dolfinx.mesh.MeshTags, cell_tags=self.cell_tags, facet_tags=self.facet_tags)
        cell = self.mesh.topology.cell_name()
        dim = self.mesh.geometry.dim
        if cell not in ("tetrahedron", "hexahedron") or dim != 3:
            raise ValueError(
                f"mesh has cells of type {cell} in {dim} dimensions, but a wall has tetrahedra or "
                "hexahedra in space: elsewhere take the forms of dolfinx_feti.loads and .supports "
                "with a measure of your own."
            )
        tags = {"cell_tags": self.cell_tags, "facet_tags": self.facet_tags}
        for name, given in tags.items():
            if given.topology != self.mesh._cpp_object.topology:
                raise ValueError(f"{name} belong to another mesh: give those of this one.")
        if (self.cell_tags.dim, self.facet_tags.dim) != (3, 2):
            raise ValueError(
                f"cell_tags are of dimension {self.cell_tags.dim} and facet_tags of "
                f"{self.facet_tags.dim}: give those of the cells (3), then of the facets (2)."
            )

    @property
    def names(self) -> dict[str, int]:
        """The tags of all layers and surfaces; a layer precedes a surface of the same name."""
        return self.surfaces | self.layers


def create_wall(
    mesh: dolfinx.mesh.Mesh,
    cell_tags: dolfinx.mesh.MeshTags | None,
    facet_tags: dolfinx.mesh.MeshTags,
    names: Groups | None = None,
) -> Wall:
    """Create a wall from a mesh and its tags. Collective.

    Args:
        mesh: Tetrahedra or hexahedra [mm].
        cell_tags: The layer of each cell; None for one layer, called ``wall``.
        facet_tags: The surface of each tagged facet.
        names: Dimension and tag of each name, such as ``{"lumen": (2, 3), "media": (3, 1)}``. The
            first process that has names decides for all. Other tags are called ``layer_7`` and
            ``surface_7``; the tag 0 marks nothing unless it has a name.

    Raises:
        TypeError: An argument has another type.
        ValueError: Tags are of another dimension or mesh, a cell has none, or no facet has one. On
            all processes.
    """
    require_type(dolfinx.mesh.Mesh, mesh=mesh)
    cells = _one_layer(mesh) if cell_tags is None else cell_tags
    wall = Wall(mesh, cells, facet_tags, layers={}, surfaces={})  # checks mesh and tags
    for dim in (0, 3):  # to find the nodes of facets, and the facets of the boundary
        mesh.topology.create_connectivity(2, dim)
    groups_of_all = mesh.comm.allgather(on_all(lambda: checked_groups(names or {}), mesh.comm))
    groups: list[Group] = next((groups for groups in groups_of_all if groups), [])
    if cell_tags is None:
        groups = [("wall", 3, 1), *(group for group in groups if group[1] != 3)]
    layers = _named(groups, cells, mesh.comm)
    surfaces = _named(groups, facet_tags, mesh.comm)
    n = mesh.topology.index_map(3).size_local
    owned = cells.values[cells.indices < n]
    missing = mesh.comm.allreduce(n - int(np.isin(owned, list(layers.values())).sum()))
    if missing:
        raise ValueError(f"cell_tags leave {missing} cells without a layer: tag all of them.")
    if not surfaces:
        raise ValueError("facet_tags mark no surface: tag the facets that loads and supports need.")
    return replace(wall, layers=layers, surfaces=surfaces)


def _one_layer(mesh: dolfinx.mesh.Mesh) -> dolfinx.mesh.MeshTags:
    """Tag all cells with 1."""
    cells = mesh.topology.index_map(mesh.topology.dim)
    everywhere = np.arange(cells.size_local + cells.num_ghosts, dtype=np.int32)
    return dolfinx.mesh.meshtags(mesh, mesh.topology.dim, everywhere, np.ones_like(everywhere))


def _named(groups: list[Group], tags: dolfinx.mesh.MeshTags, comm: MPI.Comm) -> dict[str, int]:
    """Return the names of all tags that occur on any process. Collective.

    Args:
        groups: Names with dimension and tag.
        tags: The tags.
        comm: Communicator of the mesh.
    """
    present = {int(tag) for part in comm.allgather(np.unique(tags.values)) for tag in part}
    return with_default_names(
        {name: tag for name, dim, tag in groups if dim == tags.dim}, present, tags.dim
    )


def require_surface(wall: Wall, name: str) -> None:
    """Raise a ValueError if a wall has no surface of a name."""
    if name not in wall.surfaces:
        raise ValueError(f"The wall has no surface {name!r}; it has {', '.join(wall.surfaces)}")


def facets(wall: Wall, name: str) -> Indices:
    """Return the facets of a surface on this process, ghosts included, (n,).

    Raises:
        ValueError: The wall has no surface of this name.
    """
    require_surface(wall, name)
    return np.asarray(wall.facet_tags.find(wall.surfaces[name]))


def openings(wall: Wall) -> list[str]:
    """Return the names of the openings, `opening_2` before `opening_10`."""
    return sorted(
        (name for name in wall.surfaces if name.startswith(OPENING_PREFIX)), key=_opening_order
    )


def _opening_order(name: str) -> tuple[float, str]:
    """Return a key that sorts openings by their number; those without a number are last."""
    number = name.removeprefix(OPENING_PREFIX)
    return (int(number) if number.isdecimal() else math.inf), name


def area(wall: Wall, name: str) -> float:
    """Return the area of a surface [mm²]. Collective."""
    require_surface(wall, name)
    one = dolfinx.fem.Constant(wall.mesh, np.float64(1.0))
    ds = surface_measure(wall)(wall.surfaces[name])
    form = on_all(lambda: dolfinx.fem.form(one * ds), wall.mesh.comm)
    return wall.mesh.comm.allreduce(float(dolfinx.fem.assemble_scalar(form)))


def extent(mesh: dolfinx.mesh.Mesh) -> tuple[Array, Array]:
    """Return the lower and upper corner of the box around a mesh [mm], (3,) each. Collective."""
    return bounding_box(mesh.geometry.x, mesh.comm)


def plane(wall: Wall, name: str) -> tuple[int, float]:
    """Return axis and coordinate of the plane in which a surface slides, normal to x, y or z.

    Args:
        wall: The wall.
        name: The surface.

    Returns:
        The number of the axis normal to the plane, 0 to 2, and the coordinate of the plane on it
        [mm].

    Raises:
        ValueError: The wall has no such surface, or it lies in no plane normal to x, y or z.

    Note:
        Collective.
    """
    lower, upper = extent(wall.mesh)
    entities = facets(wall, name)
    x: Array = np.zeros((0, 3))
    if len(entities):  # dolfinx 0.9 divides by their number
        nodes = dolfinx.mesh.entities_to_geometry(wall.mesh, 2, entities)
        x = np.asarray(wall.mesh.geometry.x[nodes.ravel()], dtype=np.float64)
    lower_of_surface, upper_of_surface = bounding_box(x, wall.mesh.comm)
    extents = upper_of_surface - lower_of_surface
    axis = int(np.argmin(extents))
    if not 0.0 <= extents[axis] <= PLANE_RTOL * np.linalg.norm(upper - lower):
        sizes = " × ".join(f"{size:.3g}" for size in extents)
        raise ValueError(
            f"The surface {name!r} lies in no plane normal to x, y or z (it extends over {sizes} "
            "mm), as it has to where it slides: turn the mesh, or give the surface stiff springs "
            "along its normal"
        )
    return axis, float((lower_of_surface[axis] + upper_of_surface[axis]) / 2.0)


def surface_measure(wall: Wall) -> ufl.Measure:
    """Return `ds` with the tags of the wall, for `ds(wall.surfaces["lumen"])`."""
    return ufl.Measure("ds", wall.mesh, subdomain_data=wall.facet_tags)


def by_layer(wall: Wall, values: Mapping[str, float]) -> dolfinx.fem.Function:
    """Return a piecewise constant function with one value in each layer.

    Raises:
        ValueError: A layer has no value, a value names no layer, or it is not finite.
    """
    require_finite(**values)
    if set(values) != set(wall.layers):
        raise ValueError(
            f"values are given for {', '.join(values) or 'nothing'}, but the wall has the layers "
            f"{', '.join(wall.layers)}: give a value for each of them"
        )
    V = dolfinx.fem.functionspace(wall.mesh, ("DG", 0))
    f = dolfinx.fem.Function(V)
    for name, value in values.items():
        f.x.array[V.dofmap.list[wall.cell_tags.find(wall.layers[name]), 0]] = value
    f.x.scatter_forward()
    return f
