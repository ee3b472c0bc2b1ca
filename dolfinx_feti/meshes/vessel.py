# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The wall of a real vessel, grown on the surface of Gmsh's own example.

The lumen is `aneurysm_data.stl`, a cerebral artery with a sac and three openings, in millimetres.
It comes with Debian's package gmsh-doc and with the Python wheel of gmsh, and is read from there.

    python3 -m dolfinx_feti.meshes.vessel vessel.xdmf --size 1.2 --thickness 1.0

Another lumen with open ends is read from an STL file, and ``--layers`` names the layers:

    python3 -m dolfinx_feti.meshes.vessel wall.msh --surface lumen.stl --layers wall --thickness 1.0

1. remesh the surface to triangles of one size (:mod:`dolfinx_feti.meshes.remesh`),
2. grow columns outwards along averaged normals, by default with two layers, the media (two
   thirds) and the adventitia (one third),
3. move the tops of the columns that degenerate (:mod:`dolfinx_feti.meshes.bad_columns`),
4. cut the columns into tetrahedra (:mod:`dolfinx_feti.meshes.layers`) and tag: the first sheet is
   the lumen, the last one the outer wall, and the faces above the rims are the openings, the
   longest rim first.
"""

from __future__ import annotations

import argparse
import importlib.util
import logging
import site
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import scipy.sparse
import scipy.sparse.csgraph

from dolfinx_feti.meshes.arguments import count, exit_on_errors, layer_share, positive
from dolfinx_feti.meshes.bad_columns import improve_tops
from dolfinx_feti.meshes.files import check_ending, write_wall_arrays
from dolfinx_feti.meshes.layers import Rim, create_sheets, grow_wall
from dolfinx_feti.meshes.quality import MeshQuality, measure_quality
from dolfinx_feti.meshes.remesh import remesh
from dolfinx_feti.meshes.surface import edge_lengths, find_edges, read_stl, unit, vertex_normals
from dolfinx_feti.meshes.tags import SURFACE_TAGS
from dolfinx_feti.runtime.arrays import Array, Numbers

__all__ = ["find_surface", "write_vessel"]

#: File of Gmsh's example.
EXAMPLE_FILE = "aneurysm_data.stl"

#: Folders with it, below the root of an installation: those of the wheel and of Debian's package.
EXAMPLE_FOLDERS = ("share/doc/gmsh/examples/api", "share/doc/gmsh-doc/doc/gmsh/examples/api")

#: Lowest quality (minSICN) of a tetrahedron in a wall that is written: walls of the default size
#: have 0.24 and more (meshes/README.md); flatter tetrahedra degrade the stresses first.
MIN_QUALITY = 0.1

#: Layers of an artery and their shares of the thickness.
ARTERY_LAYERS = {"media": 2 / 3, "adventitia": 1 / 3}

log = logging.getLogger(__name__)


def write_vessel(
    path: Path | str,
    *,
    size: float = 1.2,
    thickness: float = 1.0,
    layers: Mapping[str, float] = ARTERY_LAYERS,
    through: Sequence[int] | None = None,
    surface: Path | str | None = None,
    scale: float = 1.0,
) -> MeshQuality:
    """Write the wall of a vessel with named layers and surfaces. Serial.

    Args:
        path: The file, `*.msh` for Gmsh's format, `*.xdmf` for one that all processes can read.
        size: Length of the triangles' edges on the lumen [mm]; 1.2 gives 40 000 tetrahedra.
        thickness: Thickness of the wall [mm].
        layers: The names of the layers from the inside out, and their shares of the thickness.
        through: Elements through each layer; None for one.
        surface: An STL file of a lumen with open ends; None for Gmsh's example.
        scale: Millimetres in the unit of length of the STL file.

    Returns:
        Size and quality of the mesh.

    Raises:
        FileNotFoundError: There is no surface.
        ValueError: The surface is closed or damaged, an argument is out of its range, the quality
            of an element is below 0.1, or the path has another ending.
    """
    through = [1] * len(layers) if through is None else list(through)
    _check(layers, through, size=size, thickness=thickness, scale=scale)
    check_ending(Path(path))
    source = find_surface() if surface is None else Path(surface)
    log.info("remeshing %s with edges of %g mm", source, size)
    corners, triangles = read_stl(source)
    x, t = remesh(*_face_outwards(scale * corners, triangles), size=size)
    rim = _tagged_rim(x, t)
    log.info("growing a wall of %g mm on %d triangles", thickness, len(t))
    sheets = create_sheets(layers, through)
    y = x + thickness * _growth_directions(x, t, rim)
    y = improve_tops(x, y, t, heights=sheets.heights)
    arrays = grow_wall(x, y, t, sheets=sheets, rim=rim)
    quality = measure_quality(arrays.points, arrays.cells)
    log.info("%s", quality)
    if quality.minimum < MIN_QUALITY:
        raise ValueError(
            f"With size={size:g} and thickness={thickness:g} the worst of {quality.cells} "
            f"tetrahedra has a quality of {quality.minimum:.3f}, less than {MIN_QUALITY}: take a "
            "size of one to two times the thickness, or a thinner wall"
        )
    write_wall_arrays(Path(path), arrays)
    return quality


def find_surface(folders: Sequence[Path] | None = None) -> Path:
    """Return the path of Gmsh's example surface.

    Args:
        folders: Folders to search; None for those of Debian's gmsh-doc and of the gmsh wheel.

    Raises:
        FileNotFoundError: It is in none of them.
    """
    if folders is None:
        spec = importlib.util.find_spec("gmsh")
        above = list(Path(spec.origin).resolve().parents)[:5] if spec and spec.origin else []
        bases = [sys.prefix, sys.base_prefix, site.getuserbase(), "/usr", "/usr/local"]
        roots = [*above, *(Path(base) for base in bases)]
        folders = [root / folder for root in roots for folder in EXAMPLE_FOLDERS]
    for folder in folders:
        for name in (EXAMPLE_FILE, EXAMPLE_FILE + ".gz"):
            if (folder / name).is_file():
                return folder / name
    raise FileNotFoundError(
        f"Gmsh's example surface {EXAMPLE_FILE} is not on this machine. Install it with "
        "`apt install gmsh-doc` (Debian, Ubuntu) or `pip install gmsh`, or name an STL file of "
        "your own with surface= (--surface)."
    )


def _check(layers: Mapping[str, float], through: Sequence[int], **lengths: float) -> None:
    """Check the arguments of :func:`write_vessel`.

    Raises:
        ValueError: One is out of its range.
    """
    for name, value in lengths.items():
        if not (np.isfinite(value) and value > 0):
            raise ValueError(f"{name}={value} is not a positive number of millimetres")
    for name, value in layers.items():
        if not (np.isfinite(value) and value > 0):
            raise ValueError(f"layers: the share {value} of {name!r} is not a positive number")
        if not name or '"' in name or name in SURFACE_TAGS:
            raise ValueError(f"layers: {name!r} is the name of a surface or none: take another one")
    if not layers:
        raise ValueError("layers is empty: name a layer, as in {'wall': 1.0}")
    if len(through) != len(layers) or min(through) < 1:
        raise ValueError(
            f"through={tuple(through)}: each of the {len(layers)} layers needs an element or more"
        )


def _face_outwards(x: Array, t: Numbers) -> tuple[Array, Numbers]:
    """Return a surface whose triangles face outwards: all are turned if they face inwards.

    They do if the volume inside, with each rim closed by a cone, is negative.

    Args:
        x: Points, (n, 3).
        t: Triangles, (m, 3).

    Raises:
        ValueError: The surface is closed, or two triangles at an edge face different sides.
    """
    # sides of the triangles, with their direction; a side (a, b) has the key a n + b
    sides = t[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    keys = sides @ [len(x), 1]
    reversed_keys = sides[:, ::-1] @ [len(x), 1]  # of the triangle on the other side
    if len(np.unique(keys)) < len(keys):
        raise ValueError("The triangles of the surface do not face one way: repair the surface")
    rim = sides[~np.isin(keys, reversed_keys)]
    if not len(rim):
        raise ValueError("The surface is closed: a vessel needs open ends")
    loop = _loops(rim, len(x))
    sums = np.column_stack([np.bincount(loop, x[rim[:, 0], k]) for k in range(3)])
    centres = sums / np.bincount(loop)[:, None]  # of the rims: tips of the cones
    a, b, c = np.moveaxis(x[t], 1, 0)
    inside_surface = np.sum(a * np.cross(b, c))
    inside_cones = np.sum(x[rim[:, 1]] * np.cross(x[rim[:, 0]], centres[loop]))
    six_volumes = inside_surface + inside_cones
    return (x, t) if six_volumes > 0 else (x, t[:, ::-1])


def _loops(rim: Numbers, n: int) -> Numbers:
    """Return the number of the loop on which each edge lies, (k,).

    Args:
        rim: Ends of the edges of all rims, (k, 2).
        n: Number of vertices.
    """
    graph = scipy.sparse.coo_matrix((np.ones(len(rim)), tuple(rim.T)), shape=(n, n))
    _, label = scipy.sparse.csgraph.connected_components(graph, directed=False)
    return np.asarray(np.unique(label[rim[:, 0]], return_inverse=True)[1])


def _tagged_rim(x: Array, t: Numbers) -> Rim:
    """Return the rim of a surface, with the tags of its openings, the longest one first."""
    edges = find_edges(t).rim
    loop = _loops(edges, len(x))
    length = np.bincount(loop, edge_lengths(x, edges))
    rank = np.argsort(np.argsort(-length))
    return Rim(edges, SURFACE_TAGS["opening_1"] + rank[loop])


def _growth_directions(x: Array, t: Numbers, rim: Rim) -> Array:
    """Return the directions in which the wall grows, unit vectors, (n, 3).

    They are the normals at the vertices. On a rim they lie in its plane, so the cut faces are flat.
    """
    direction = vertex_normals(x, t)
    for tag in np.unique(rim.tags):
        loop = np.unique(rim.edges[rim.tags == tag])
        _, _, axes = np.linalg.svd(x[loop] - x[loop].mean(axis=0), full_matrices=False)
        axis = axes[2]  # normal of the plane that fits the rim best
        in_plane = direction[loop] - (direction[loop] @ axis)[:, None] * axis
        direction[loop] = unit(in_plane)
    return direction


def main() -> None:
    """Write a vessel from the command line."""
    parser = argparse.ArgumentParser(
        "python3 -m dolfinx_feti.meshes.vessel", description="A vessel's wall."
    )
    parser.add_argument("file", type=Path, help="the file to write, *.msh or *.xdmf")
    parser.add_argument("--size", type=positive, default=1.2, help="edges on the lumen [mm]")
    parser.add_argument("--thickness", type=positive, default=1.0, help="thickness [mm]")
    parser.add_argument(
        "--layers",
        type=layer_share,
        nargs="+",
        metavar="NAME=SHARE",
        default=list(ARTERY_LAYERS.items()),
        help="layers from the inside out, and their shares of the thickness (media=2 adventitia=1)",
    )
    parser.add_argument("--through", type=count, nargs="+", help="elements through each layer (1)")
    parser.add_argument("--surface", type=Path, help="an STL file of a lumen with open ends")
    parser.add_argument(
        "--scale", type=positive, default=1.0, help="mm in the unit of the STL file (1)"
    )
    options = vars(parser.parse_args())
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    with exit_on_errors(parser):
        write_vessel(options.pop("file"), **options | {"layers": dict(options["layers"])})


if __name__ == "__main__":
    main()
