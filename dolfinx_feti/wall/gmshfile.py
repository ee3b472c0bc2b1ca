# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Walls in Gmsh's files: tetrahedra or hexahedra of order 1 or 2, named by physical groups.

The files are not read by ``dolfinx.io.gmsh``, which in dolfinx 0.9 to 0.11 fails with a bare
AssertionError if node numbers have gaps, and ignores cells without a group or in two of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import dolfinx

from dolfinx_feti.runtime.arrays import Numbers
from dolfinx_feti.wall.checks import CELLS
from dolfinx_feti.wall.names import names_in_use, with_default_names
from dolfinx_feti.wall.reading import NAMING_HELP, import_reader
from dolfinx_feti.wall.wall_arrays import WallArrays

__all__ = ["read_gmsh"]

#: Shape of a facet by its number of nodes.
FACETS = {3: "triangle", 6: "triangle", 4: "quadrilateral", 9: "quadrilateral"}


@dataclass(frozen=True, slots=True)
class TaggedElements:
    """The elements of all physical groups of one dimension.

    Attributes:
        nodes: Nodes of the elements in dolfinx's order, by Gmsh's numbers, (n, nodes).
        tags: Tag of the group of each element, (n,).
        names: Tags by name.
    """

    nodes: Numbers
    tags: Numbers
    names: dict[str, int]


def read_gmsh(path: Path) -> WallArrays:
    """Read the physical groups of a Gmsh file. Serial.

    Args:
        path: The file.

    Raises:
        ModuleNotFoundError: The Python package gmsh is not installed.
        ValueError: Gmsh cannot read the file, two groups have the same name, an entity is in two
            groups, a cell is in none, or elements are of a type that walls do not have.
    """
    with _opened(path) as file:
        numbers, coordinates, _ = file.gmsh.model.mesh.getNodes()
        cells = file.tagged_elements(3)
        facets = file.tagged_elements(2)
        n_cells = file.n_elements(3)
    if n_cells > len(cells.nodes):
        raise ValueError(
            f"{n_cells - len(cells.nodes)} cells of {path} are in no physical volume; {NAMING_HELP}"
        )
    last = max(int(some.max(initial=0)) for some in (numbers, cells.nodes, facets.nodes))
    # index of each node by Gmsh's number; −1 for a missing node, which check_connectivity detects
    index = np.full(last + 1, -1)
    index[numbers] = np.arange(len(numbers))
    return WallArrays(
        points=coordinates.reshape(-1, 3),
        cells=index[cells.nodes],
        cell_tags=cells.tags,
        facets=index[facets.nodes],
        facet_tags=facets.tags,
        layer_names=cells.names,
        surface_names=facets.names,
    )


@contextmanager
def _opened(path: Path) -> Iterator[_GmshFile]:
    """Open a file in a new model of Gmsh, and restore the state of Gmsh afterwards."""
    gmsh = import_reader("gmsh", path)
    is_running = bool(gmsh.isInitialized())
    if not is_running:
        # neither the user's options for Gmsh, nor Gmsh's own handler of Ctrl-C
        gmsh.initialize(readConfigFiles=False, interruptible=False)
        gmsh.option.setNumber("General.Terminal", 0)
    gmsh.model.add(str(path))
    try:
        try:
            gmsh.merge(str(path))
        except Exception as error:  # gmsh raises no other class
            raise ValueError(f"gmsh cannot read {path}: {error}") from error
        yield _GmshFile(gmsh, path)
    finally:
        gmsh.model.remove()
        if not is_running:
            gmsh.finalize()


@dataclass(frozen=True, slots=True)
class _GmshFile:
    """A file that is Gmsh's current model.

    Attributes:
        gmsh: The module gmsh.
        path: The file, for messages.
    """

    gmsh: Any
    path: Path

    def n_elements(self, dim: int) -> int:
        """Return the number of elements of a dimension, in groups or not."""
        return sum(len(elements) for elements in self.gmsh.model.mesh.getElements(dim)[1])

    def tagged_elements(self, dim: int) -> TaggedElements:
        """Return the elements of all physical groups of a dimension, 3 for cells, 2 for facets.

        Raises:
            ValueError: Two groups have the same name, an entity is in two groups, or elements are
                of a type that walls do not have.
        """
        names = self._group_names(dim)
        elements: list[Numbers] = []
        tags: list[Numbers] = [np.zeros(0, dtype=np.int64)]
        for entity, tag in self._tags_of_entities(dim).items():
            types, _, nodes_of_type = self.gmsh.model.mesh.getElements(dim, entity)
            for element_type, nodes in zip(types, nodes_of_type, strict=True):
                rows = self._in_order_of_dolfinx(dim, element_type, nodes)
                if elements and rows.shape[1] != elements[0].shape[1]:
                    raise self._unsupported(element_type)
                elements.append(rows)
                tags.append(np.full(len(rows), tag))
        all_elements = np.concatenate(elements or [np.zeros((0, dim + 1), dtype=np.int64)])
        all_tags = np.concatenate(tags)
        if names:
            return TaggedElements(all_elements, all_tags, names_in_use(names, all_tags))
        return TaggedElements(all_elements, all_tags, with_default_names({}, all_tags, dim))

    def _group_names(self, dim: int) -> dict[str, int]:
        """Return the names of the physical groups of a dimension, with their tags.

        Raises:
            ValueError: Two groups have the same name.
        """
        names: dict[str, int] = {}
        for _, tag in self.gmsh.model.getPhysicalGroups(dim):
            name = self.gmsh.model.getPhysicalName(dim, tag)
            if name and name in names:
                raise ValueError(
                    f"{self.path} has two physical groups of dimension {dim} that are called "
                    f"{name!r}: join them, or give each a name of its own"
                )
            if name:
                names[name] = tag
        return names

    def _tags_of_entities(self, dim: int) -> dict[int, int]:
        """Return the tag of the physical group of each entity of a dimension.

        Raises:
            ValueError: An entity is in two groups.
        """
        model = self.gmsh.model
        tag_of: dict[int, int] = {}
        for _, tag in model.getPhysicalGroups(dim):
            for entity in model.getEntitiesForPhysicalGroup(dim, tag):
                if entity in tag_of:
                    first, second = (
                        model.getPhysicalName(dim, each) or str(each)
                        for each in (tag_of[entity], tag)
                    )
                    entity_name = "Volume" if dim == 3 else "Surface"
                    raise ValueError(
                        f"{entity_name} {entity} of {self.path} is in two physical groups, "
                        f"{first!r} and {second!r}: leave it in one of them"
                    )
                tag_of[entity] = tag
        return tag_of

    def _in_order_of_dolfinx(self, dim: int, element_type: int, nodes: Numbers) -> Numbers:
        """Return the nodes of elements of one type in dolfinx's order, (n, nodes).

        Args:
            dim: Dimension of the elements.
            element_type: Gmsh's number of the type.
            nodes: Nodes of all elements, one element after the other, in Gmsh's order.

        Raises:
            ValueError: Walls do not have elements of this type.
        """
        n_nodes = self.gmsh.model.mesh.getElementProperties(element_type)[3]
        shapes = FACETS if dim == 2 else {n: cell.shape for n, cell in CELLS.items()}
        if n_nodes not in shapes:
            raise self._unsupported(element_type)
        order = dolfinx.cpp.io.perm_gmsh(dolfinx.mesh.to_type(shapes[n_nodes]), n_nodes)
        return np.asarray(nodes.astype(np.int64).reshape(-1, n_nodes)[:, order])

    def _unsupported(self, element_type: int) -> ValueError:
        """Create the error about elements of a type that walls do not have, or of a second type."""
        name = self.gmsh.model.mesh.getElementProperties(element_type)[0]
        return ValueError(
            f"{self.path} has elements of type {name}; a wall has tetrahedra and triangles, or "
            "hexahedra and quadrilaterals, of one order, 1 or 2"
        )
