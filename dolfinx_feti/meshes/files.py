# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Files of generated walls: XDMF, or Gmsh's format 2.2 for tetrahedra."""

from __future__ import annotations

import os
from pathlib import Path

from mpi4py import MPI

import numpy as np

from dolfinx_feti.runtime.arrays import Numbers
from dolfinx_feti.wall.names import names_in_use
from dolfinx_feti.wall.wall_arrays import WallArrays, distribute
from dolfinx_feti.wall.xdmf import write_wall

__all__ = ["write_msh", "write_wall_arrays"]

#: Gmsh's number of the triangle with three nodes.
GMSH_TRIANGLE = 2

#: Gmsh's number of the tetrahedron with four nodes.
GMSH_TETRAHEDRON = 4


def write_wall_arrays(path: Path, arrays: WallArrays) -> None:
    """Write an XDMF file, which all processes can read, or a Gmsh file. Serial.

    Args:
        path: The file, `*.xdmf`, or `*.msh` for Gmsh's format; its folder is created.
        arrays: The wall.

    Raises:
        ValueError: The path has another ending.
    """
    check_ending(path)
    if path.suffix == ".xdmf":
        write_wall(path, distribute(arrays, MPI.COMM_SELF))
    else:
        write_msh(path, arrays)


def check_ending(path: Path) -> None:
    """Raise a ValueError if no file of this name can be written.

    Args:
        path: The file; generators check it before they make a wall.
    """
    if path.suffix not in (".xdmf", ".msh"):
        raise ValueError(f"path={str(path)!r}: give a name that ends in .xdmf or .msh")


def write_msh(path: Path, arrays: WallArrays) -> None:
    """Write a Gmsh file, version 2.2, with layers and surfaces as named physical groups. Serial.

    It is written under a temporary name and renamed at the end, so no incomplete file remains.

    Args:
        path: The file, `*.msh`; its folder is created.
        arrays: A wall of straight tetrahedra. Names without a cell or facet are left out.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.stem}-{os.getpid()}{path.suffix}")
    surface_names = names_in_use(arrays.surface_names, arrays.facet_tags)
    layer_names = names_in_use(arrays.layer_names, arrays.cell_tags)
    groups = [f'2 {tag} "{name}"' for name, tag in surface_names.items()]
    groups += [f'3 {tag} "{name}"' for name, tag in layer_names.items()]
    node_numbers = np.arange(1, len(arrays.points) + 1)
    n_facets = len(arrays.facets)
    triangles = _elements(1, GMSH_TRIANGLE, arrays.facets, arrays.facet_tags)
    tetrahedra = _elements(1 + n_facets, GMSH_TETRAHEDRON, arrays.cells, arrays.cell_tags)
    head = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$PhysicalNames", str(len(groups))]
    head += [*groups, "$EndPhysicalNames", "$Nodes", str(len(node_numbers)), ""]
    nodes = np.column_stack([node_numbers, arrays.points])
    try:
        with temporary.open("wb") as file:
            file.write("\n".join(head).encode())
            np.savetxt(file, nodes, fmt="%d %.12g %.12g %.12g")
            n_elements = len(triangles) + len(tetrahedra)
            file.write(f"$EndNodes\n$Elements\n{n_elements}\n".encode())
            np.savetxt(file, triangles, fmt="%d")
            np.savetxt(file, tetrahedra, fmt="%d")
            file.write(b"$EndElements\n")
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def _elements(first: int, gmsh_type: int, corners: Numbers, tags: Numbers) -> Numbers:
    """Return the lines of Gmsh's elements, (n, 5 + corners).

    A line has the number of the element, its type, the number of its tags, two tags (of the
    physical group and of the entity, equal here), and its nodes, which are numbered from 1.

    Args:
        first: Number of the first element.
        gmsh_type: Gmsh's number of the type.
        corners: Corners of the elements, (n, corners).
        tags: Tags of the elements, (n,).
    """
    n = len(tags)
    numbers = first + np.arange(n)
    types = np.full(n, gmsh_type)
    tag_counts = np.full(n, 2)
    return np.column_stack([numbers, types, tag_counts, tags, tags, corners + 1])
