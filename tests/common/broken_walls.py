# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Broken meshes and cases, each of which has to end in one error on all processes."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from mpi4py import MPI

import numpy as np
from wall_files import EXAMPLE, ROOT

from dolfinx_feti.meshes.files import write_msh
from dolfinx_feti.wall import read_wall, write_wall
from dolfinx_feti.wall.wall_arrays import WallArrays
from dolfinx_feti.wall.wallfile import read_wall_arrays

CASE = (ROOT / "demos/wall.toml").read_text(encoding="utf-8")


@dataclass(frozen=True)
class BrokenFile:
    """A file that is refused.

    Attributes:
        name: Its name.
        match: Pattern of the error.
        write: Writes the file to a path.
    """

    name: str
    match: str
    write: Callable[[Path], object]

    def write_into(self, folder: Path) -> Path:
        """Write the file into a folder; return its path."""
        self.write(folder / self.name)
        return folder / self.name


def text(name: str, content: bytes | str, match: str) -> BrokenFile:
    """Return a file with the given content."""
    data = content if isinstance(content, bytes) else content.encode()
    return BrokenFile(name, match, lambda path: path.write_bytes(data))


def changed(name: str, match: str, **arrays: Callable[[WallArrays], np.ndarray]) -> BrokenFile:
    """Return the example with changed arrays: each is computed from the example's arrays."""

    def write(path: Path) -> None:
        mesh = read_wall_arrays(EXAMPLE)
        write_msh(path, replace(mesh, **{k: f(mesh) for k, f in arrays.items()}))

    return BrokenFile(name, match, write)


def with_rows(rows: np.ndarray, at: object, values: object) -> np.ndarray:
    """Return an array with the rows ``at`` replaced by values."""
    other = np.array(rows)
    other[at] = values
    return other


# -- text

MSH = EXAMPLE.read_bytes()
NOISE = np.random.default_rng(71).bytes(4000)
HEAD = b"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n"

TEXT_FILES = [
    text("empty.msh", b"", "empty.msh"),
    text("nonsense.msh", "no mesh at all\n", "nonsense.msh"),
    text("noise.msh", NOISE, "noise.msh"),
    text("head_alone.msh", HEAD, "has no "),
    text("noise_behind_the_head.msh", HEAD + b"$Nodes\n" + NOISE, "noise_behind_the_head.msh"),
    text("binary_where_text_is_expected.msh", MSH[:600] + NOISE + MSH[4600:], "binary_where_text"),
    text("cut_in_the_nodes.msh", MSH[:3000], "cut_in_the_nodes.msh"),
    text("cut_in_the_elements.msh", MSH[:15000], "cut_in_the_elements.msh"),
    text("other_version.msh", MSH.replace(b"2.2 0 8", b"9.7 0 8", 1), "other_version.msh"),
    text(
        "no_groups.msh", MSH.replace(b"$PhysicalNames", b"$Comments", 1), "no_groups.msh|no named"
    ),
    text(
        "one_name_twice.msh", MSH.replace(b"adventitia", b"media"), "no name for some cells|called"
    ),
    text("empty.vtu", b"", "cannot read .*empty.vtu"),
    text("noise.vtu", NOISE, "cannot read .*noise.vtu"),
    text("noise.xdmf", NOISE, "cannot read .*noise.xdmf"),
    text("noise.mesh", NOISE, "noise.mesh"),
    text("unknown.dat0", "3 4 5\n", "cannot read .*unknown.dat0"),
]

# -- meshes

CHANGED_MESHES = [
    changed(
        "nan.msh",
        "coordinates that are not finite|cannot read",
        points=lambda m: with_rows(m.points, 5, np.nan),
    ),
    changed(
        "infinite.msh",
        "coordinates that are not finite|cannot read",
        points=lambda m: with_rows(m.points, 5, [1e999, 0, 0]),
    ),
    changed("plane.msh", "have no volume", points=lambda m: m.points * [1, 1, 0]),
    changed(
        "inverted.msh",
        "3 tetrahedra of .* are inverted",
        cells=lambda m: with_rows(m.cells, slice(3), m.cells[:3, [1, 0, 2, 3]]),
    ),
    changed(
        "folded.msh",
        "are inverted|no volume",
        points=lambda m: with_rows(m.points, m.cells[0, 0], 3.0 * m.points[m.cells[0, 0]] + 1.0),
    ),
    changed(
        "cell_twice.msh",
        "1 tetrahedra of .* occur twice",
        cells=lambda m: np.vstack([m.cells, m.cells[:1]]),
        cell_tags=lambda m: np.append(m.cell_tags, 3 - m.cell_tags[0]),
    ),
    changed(
        "non_manifold.msh",
        "faces of more than two tetrahedra|inverted",
        points=lambda m: np.vstack([m.points, [[9.0, 9, 9], [9, 9, 10]]]),
        cells=lambda m: np.vstack(
            [m.cells, [[*m.cells[0, :3], len(m.points) + k] for k in (0, 1)]]
        ),
        cell_tags=lambda m: np.append(m.cell_tags, [1, 1]),
    ),
    changed(
        "lost_points.msh",
        "points that are not in the file|cannot read",
        cells=lambda m: with_rows(m.cells, 7, m.cells[7] + len(m.points)),
    ),
    changed(
        "facet_twice.msh",
        "triangles of .* have two tags",
        facets=lambda m: np.vstack([m.facets, m.facets[:2]]),
        facet_tags=lambda m: np.append(m.facet_tags, [12, 12]),
    ),
    changed(
        "cells_without_group.msh",
        "5 cells of .* are in no physical volume",
        cell_tags=lambda m: np.where(np.arange(len(m.cells)) < 5, 0, m.cell_tags),
    ),
    changed(
        "layer_without_name.msh",
        "no name for some cells.*nameless = 777",
        cell_tags=lambda m: np.where(np.arange(len(m.cells)) < 5, 777, m.cell_tags),
    ),
    changed(
        "flat_cell.msh",
        "1 tetrahedra of .* have no volume",
        cells=lambda m: np.vstack([m.cells, m.cells[:1, [0, 1, 2, 2]]]),
        cell_tags=lambda m: np.append(m.cell_tags, 1),
    ),
    changed(
        "stray_facet.msh",
        "1 tagged triangles of .* are not faces",
        facets=lambda m: np.vstack([m.facets, [[0, 1, len(m.points) - 1]]]),
        facet_tags=lambda m: np.append(m.facet_tags, 3),
    ),
    changed(
        "surfaces_alone.msh",
        "no named layer",
        cells=lambda m: m.cells[:0],
        cell_tags=lambda m: m.cell_tags[:0],
    ),
    changed(
        "no_surface.msh",
        "no named surface",
        facets=lambda m: m.facets[:0],
        facet_tags=lambda m: m.facet_tags[:0],
    ),
]


def box(
    name: str, match: str, *groups: tuple[int, str], dim: int = 3, **options: float
) -> BrokenFile:
    """Return a box, or a square, meshed by Gmsh.

    Args:
        name: Name of the file; if it begins with ``cut``, half of the file is cut off.
        match: Pattern of the error.
        groups: Dimension and name of each physical group.
        dim: 3 for a box, 2 for a square.
        options: Gmsh's options ``Mesh.…``.
    """

    def write(path: Path) -> None:
        import gmsh

        gmsh.initialize(readConfigFiles=False, interruptible=False)
        try:
            for option, value in {"MeshSizeMax": 0.5, **options}.items():
                gmsh.option.setNumber(f"Mesh.{option}", value)
            gmsh.option.setNumber("General.Terminal", 0)
            make = gmsh.model.occ.addBox if dim == 3 else gmsh.model.occ.addRectangle
            make(0, 0, 0, 1, 1, *[1] * (dim - 2))
            gmsh.model.occ.synchronize()
            for of, group in groups:
                gmsh.model.addPhysicalGroup(of, [1], name=group)
            gmsh.model.mesh.generate(dim)
            gmsh.write(str(path))
        finally:
            gmsh.finalize()
        if name.startswith("cut"):
            os.truncate(path, path.stat().st_size // 2)

    return BrokenFile(name, match, write)


MEDIA = (3, "media")
LUMEN = (2, "lumen")
GMSH_BOXES = [
    box(
        "two_groups.msh",
        "Volume 1 of .* is in two physical groups, 'media' and 'tissue'",
        MEDIA,
        (3, "tissue"),
        LUMEN,
    ),
    box(
        "surface_in_two_groups.msh",
        "Surface 1 of .* is in two physical groups",
        MEDIA,
        LUMEN,
        (2, "outer"),
    ),
    box("square.msh", "no named layer", (2, "media"), (1, "lumen"), dim=2),
    box("cut_binary.msh", "gmsh cannot read .*cut_binary.msh", MEDIA, LUMEN, Binary=1),
    box("third_order.msh", "elements of type Tetrahedron 20", MEDIA, LUMEN, ElementOrder=3),
]

MISSING_FILES = [
    BrokenFile("nowhere.msh", "There is no file", lambda path: None),
    BrokenFile("nowhere.toml", "no file .*: name a TOML file", lambda path: None),
]


def damaged(
    name: str, change: Callable[[Path], object], match: str = "cannot be read"
) -> BrokenFile:
    """Return a file of ``write_wall`` that ``change`` damages."""

    def write(path: Path) -> None:
        write_wall(path, read_wall(EXAMPLE, MPI.COMM_SELF))
        change(path)

    return BrokenFile(name, match, write)


def table(key: str, change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Path], None]:
    """Return a function that changes a table of the HDF5 file that belongs to a path."""

    def work(path: Path) -> None:
        import h5py

        with h5py.File(path.with_suffix(".h5"), "a") as file:
            other = change(file[key][...])
            del file[key]
            file[key] = other

    return work


SURFACES = "MeshTags/surfaces/topology"
DAMAGED_XDMF_FILES = [
    damaged("no_data.xdmf", lambda p: p.with_suffix(".h5").unlink()),
    damaged("noise_for_data.xdmf", lambda p: p.with_suffix(".h5").write_bytes(NOISE)),
    damaged("cut_data.xdmf", lambda p: os.truncate(p.with_suffix(".h5"), 5000)),
    damaged(
        "no_names.xdmf", lambda p: p.write_text(p.read_text().replace("surfaces&quot;", "&quot;"))
    ),
    damaged("nan.xdmf", table("Mesh/mesh/geometry", lambda x: x * np.nan), "not finite"),
    damaged(
        "lost_points.xdmf", table("Mesh/mesh/topology", lambda t: t + 10**6), "not in the file"
    ),
    damaged("one_point.xdmf", table("Mesh/mesh/topology", lambda t: 0 * t), "occur twice"),
    damaged("cell_twice.xdmf", table("Mesh/mesh/topology", lambda t: np.vstack([t[-1:], t[1:]]))),
    damaged("plane.xdmf", table("Mesh/mesh/geometry", lambda x: x * [1, 1, 0]), "have no volume"),
    damaged(
        "lost_layers.xdmf", table("MeshTags/layers/topology", lambda t: t + 10**6), "not in the"
    ),
    damaged(
        "minus_layers.xdmf", table("MeshTags/layers/topology", lambda t: 0 * t - 9), "not in the"
    ),
    damaged(
        "one_layer.xdmf",
        table("MeshTags/layers/topology", lambda t: 0 * t),
        "layers have no name, or are not in its mesh",
    ),
    damaged("narrow.xdmf", table("MeshTags/layers/topology", lambda t: t[:, :3])),
    damaged("few_tags.xdmf", table("MeshTags/layers/Values", lambda v: v[:5])),
    damaged("few_layers.xdmf", table("MeshTags/layers/topology", lambda t: t[:5])),
    damaged("lost_facets.xdmf", table(SURFACES, lambda t: 0 * t - 1), "not in the"),
    damaged(
        "stray_facets.xdmf",
        table(SURFACES, lambda t: 0 * t),
        "surfaces have no name, or are not in its mesh",
    ),
    damaged(
        "nameless.xdmf",
        table("MeshTags/layers/Values", lambda t: 777 + 0 * t),
        "layers have no name, or are not in its mesh",
    ),
    damaged(
        "bare.xdmf",
        table("MeshTags/surfaces/Values", lambda t: 777 + 0 * t),
        "surfaces have no name, or are not in its mesh",
    ),
    damaged("list.xdmf", lambda p: p.write_text(re.sub("{&quot;media.*?}", "[]", p.read_text()))),
    damaged(
        "no_tag.xdmf",
        lambda p: p.write_text(p.read_text().replace("media&quot;: 1", "media&quot;: []")),
    ),
]


def with_tags(name: str, tag: float) -> BrokenFile:
    """Return the example in a format of meshio, with this tag of its first cell."""

    def write(path: Path) -> None:
        import meshio

        mesh = read_wall_arrays(EXAMPLE)
        layers = with_rows(mesh.cell_tags.astype(float), 0, tag)
        blocks = [("tetra", mesh.cells), ("triangle", mesh.facets)]
        data = {"tag": [layers, mesh.facet_tags.astype(float)]}
        meshio.Mesh(mesh.points, blocks, cell_data=data).write(path)

    return BrokenFile(name, "not one integer of 32 bits for each tetra", write)


FILES_WITH_WRONG_TAGS = [
    with_tags("huge_tag.vtu", 2.0**32 + 1.0),
    with_tags("infinite_tag.vtu", np.inf),
    with_tags("nan_tag.vtu", np.nan),
]


def alone(name: str, kind: str, nodes: int, match: str, *data: str) -> BrokenFile:
    """Return a file of one cell, in a format of meshio or in Gmsh's.

    Args:
        name: Name of the file.
        kind: meshio's name of the cell.
        nodes: Its number of nodes.
        match: Pattern of the error.
        data: Names of cell data, which have the value 1.
    """

    def write(path: Path) -> None:
        import meshio

        points = np.random.default_rng(9134).random((nodes, 3))
        cells = np.arange(nodes)[None]
        ones = {key: [np.ones(1, dtype=np.int32)] for key in data}
        how = {"file_format": "gmsh22", "binary": False} if path.suffix == ".msh" else {}
        meshio.Mesh(points, [(kind, cells)], cell_data=ones).write(path, **how)

    return BrokenFile(name, match, write)


GMSH = ("gmsh:physical", "gmsh:geometrical")
SINGLE_CELLS = [
    alone("layer_alone.vtu", "tetra", 4, "no named surface. Found: .*none", "layer"),
    alone("colour.vtu", "tetra", 4, "no cell data layer or .*: colour", "colour"),
    alone("hexahedron.vtu", "hexahedron", 8, "a wall has tetra", "layer"),
    alone("tetra10.vtu", "tetra10", 10, "a wall has tetra", "layer"),
    alone("wedge.msh", "wedge", 6, "a wall has tetra", *GMSH),
    alone("hexahedron20.msh", "hexahedron20", 20, "a wall has tetra", *GMSH),
]

# -- cases

BROKEN_CASES = [
    text("empty.toml", b"", "mesh is missing"),
    text("noise.toml", NOISE, "is no TOML file"),
    text("cut.toml", CASE[: CASE.index("= 3.0") + 1], "is no TOML file"),
    text("deep.toml", "a = " + "[" * 5000, "is no TOML file"),
    text("tables.toml", CASE.replace("[layers.media]", "[[layers.media]]"), "give a table"),
    text("nan.toml", CASE.replace("c = 3.0", "c = nan"), "c = nan: give a positive"),
    text("huge.toml", CASE.replace("c = 3.0", f"c = 1{'0' * 400}"), "give a positive"),
    text("utf16.toml", CASE.encode("utf-16"), "is no TOML file"),
    text(
        "unit_twice.toml", CASE.replace("3.0", '"3 kPa kPa"', 1), "c = '3 kPa kPa': give a positive"
    ),
    text("inline.toml", CASE.replace("c = 3.0", "c = {kPa = 3}"), "give a positive number in kPa"),
    text(
        "tiny.toml", CASE.replace("c = 3.0", 'c = "1e-306 Pa"'), "c = '1e-306 Pa': give a positive"
    ),
    text("date.toml", CASE.replace("c = 3.0", "c = 2026-11-26"), "give a positive"),
    text(
        "no_dashpot.toml", re.sub("\ndashpot.*", "", CASE), "rate = 100.0: has no effect without a"
    ),
]

#: All of them by their names.
BROKEN: dict[str, BrokenFile] = {
    file.name: file
    for file in (
        *TEXT_FILES,
        *CHANGED_MESHES,
        *GMSH_BOXES,
        *MISSING_FILES,
        *DAMAGED_XDMF_FILES,
        *FILES_WITH_WRONG_TAGS,
        *SINGLE_CELLS,
        *BROKEN_CASES,
    )
}
